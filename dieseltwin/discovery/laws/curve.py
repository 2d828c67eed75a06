"""An effect bin by bin over one variable: what the recording says free of any law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.laws.responses import PointResponse
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.least_squares import Z_90

_BINS = 9
_GRID = 40


@dataclass(frozen=True)
class Curve:
    """A signal at a point over one variable.

    Attributes:
        x, y, low, high: the curve and its 90 % band.
        points_x, points_y, points_std: estimates bin by bin.
    """

    x: Array
    y: Array
    low: Array
    high: Array
    points_x: Array
    points_y: Array
    points_std: Array


def _hats(values: Array) -> tuple[Array, Array]:
    """Knots at quantiles (m,), and piecewise-linear shares of the samples (m, n)."""
    knots = np.unique(np.quantile(values, np.linspace(0.01, 0.99, _BINS)))
    if len(knots) < 2:
        return knots, np.ones((1, len(values)))
    return knots, np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def binned(values: Array, response: PointResponse) -> tuple[Array, Array, Array]:
    """Piecewise-linear signal over a variable (n,) by least squares: knots, estimates and their deviations (m,)."""
    knots, hats = _hats(values)
    at = response.at_knots(hats)
    information = response.products(at, at)
    ridge = 1e-8 * np.trace(information) / len(information)
    covariance = np.linalg.inv(information + ridge * np.eye(len(information)))
    return knots, covariance @ response.gradients(at), np.sqrt(np.maximum(np.diag(covariance), 0.0))


def law_curve(values: Array, signal: Array, spread: float, response: PointResponse) -> Curve:
    """A law's signal (n,) averaged over a variable (n,), with the band of its coefficient, beside the bins."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _GRID + 1)))
    bin_of = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
    used = np.unique(bin_of)
    x = np.array([values[bin_of == b].mean() for b in used])
    y = np.array([signal[bin_of == b].mean() for b in used])
    half = Z_90 * spread * np.abs(y)
    return Curve(x, y, y - half, y + half, *binned(values, response))
