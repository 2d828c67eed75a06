"""An effect bin by bin over one variable: what the recording says free of any law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.laws.responses import PointResponse
from dieseltwin.discovery.twins.interface import Array, Point

_BINS = 9
_GRID = 40
_BAND = 1.645  # standard deviations: 90 %


@dataclass(frozen=True)
class Curve:
    """A signal at a point over one variable.

    Attributes:
        point, site, unit: where it enters, [unit] of y.
        argument: name of the variable.
        x, y, low, high: the curve and its 90 % band.
        points_x, points_y, points_std: estimates bin by bin.
        score: gain less what the bins cost.
    """

    point: str
    site: str
    unit: str
    argument: str
    x: Array
    y: Array
    low: Array
    high: Array
    points_x: Array
    points_y: Array
    points_std: Array
    score: float


def _hats(values: Array) -> tuple[Array, Array]:
    """Knots at quantiles (m,), and piecewise-linear shares of the samples (m, n)."""
    knots = np.unique(np.quantile(values, np.linspace(0.01, 0.99, _BINS)))
    if len(knots) < 2:
        return knots, np.ones((1, len(values)))
    return knots, np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def binned(
    point: Point, variables: Mapping[str, Array], argument: str, response: PointResponse, price: float = 0.0
) -> Curve:
    """Piecewise-linear signal over one variable by least squares in the metric.

    Args:
        point: where it enters.
        variables: along the trajectory.
        argument: over which.
        response: of the point.
        price: of each bin in the score.
    """
    knots, hats = _hats(variables[argument])
    at = response.at_knots(hats)
    information = response.products(at, at)
    ridge = 1e-8 * np.trace(information) / len(information)
    covariance = np.linalg.inv(information + ridge * np.eye(len(information)))
    gradient = response.gradients(at)
    y = covariance @ gradient
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    score = float(gradient @ y) - price * len(knots)
    return Curve(
        point.name, point.site, point.unit, argument, knots, y, y - _BAND * std, y + _BAND * std, knots, y, std, score
    )


def law_curve(
    point: Point, variables: Mapping[str, Array], argument: str, signal: Array, spread: float, response: PointResponse
) -> Curve:
    """A law's signal averaged over its argument, with the band of its coefficient, beside the bins."""
    free = binned(point, variables, argument, response)
    values = variables[argument]
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _GRID + 1)))
    bin_of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
    used = np.unique(bin_of)
    x = np.array([values[bin_of == b].mean() for b in used])
    y = np.array([signal[bin_of == b].mean() for b in used])
    half = _BAND * spread * np.abs(y)
    return Curve(
        point.name, point.site, point.unit, argument, x, y, y - half, y + half, free.points_x, free.points_y,
        free.points_std, free.score,
    )  # fmt: skip
