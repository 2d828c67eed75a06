"""What differs from settled point to settled point with nothing that was recorded: where it sits, and how large.

An unrecorded valve, brake or leak moves one quantity by its own amount at each point. At a place whose quantity moves
every balance i by a_i per unit, the residuals r then have covariance C + tau^2 a a', and the likelihood of tau says how
well that place explains what no coefficient, effect or law does. Balances alone are places too: a map that is rough
moves no other balance, a pressure behind the turbine moves the turbine's flow and its power together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from dieseltwin.arrays import Array
from dieseltwin.calibration.likelihood import log_student, reading_covariance, reading_noise
from dieseltwin.calibration.steady_model import ROWS, SteadyModel
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.settings.search import SubmodelErrors

NEIGHBOURS: Mapping[str, str] = {"p_es": "turbine_flow", "p_bc": "compressor_flow", "T_im": "cylinder_flow"}
"""Quantity of a place that nobody measured -> the balance that it moves most."""

_STEP = 1e-3  # relative change of a quantity, for its slopes
_LOG_TAU = (-9.0, 0.0)  # sought range of ln tau
_CLOSE = 0.7  # of the best place's gain: the points hardly tell two such places apart


@dataclass(frozen=True)
class Scatter:
    """One balance that is off by another amount at each point.

    Attributes:
        site: the balance.
        std: standard deviation from point to point, of the balance [-].
        gain: 2 log-likelihood ratio against none.
        beside: quantity of the neighbouring place (`NEIGHBOURS`) that explains about as much, or None.
        beside_std: its relative standard deviation from point to point [-].
    """

    site: str
    std: float
    gain: float
    beside: str | None = None
    beside_std: float | None = None


def scatter_of(
    model: SteadyModel, points: SteadyPoints, values: Mapping[str, float], beliefs: SubmodelErrors
) -> Scatter | None:
    """The balance that scatters most from point to point beyond what is believed of submodels and sensors.

    Args:
        model, values: with all that was found.
        points: n points with all states measured.
        beliefs: errors of the submodels.

    Returns:
        None where no balance scatters more than is believed.
    """
    x = points.states()
    sigma = reading_noise(x)
    rows = len(ROWS)
    C = reading_covariance(model, points, x, values, sigma)[:, :rows, :rows]
    C = C + np.diag([beliefs.error(row) ** 2 for row in ROWS])
    r = model.relations(points, x, values).residual[0][:, :rows]
    seen = np.isfinite(r).all(axis=1)
    if not seen.any():
        return None
    inverse = np.linalg.inv(C[seen])

    def explained(a: Array) -> tuple[float, float]:
        """Gain and tau of a place that moves the balances by `a`, (n, R) or (R,)."""
        a = np.broadcast_to(a, r.shape)[seen]
        own = np.einsum("ni,nij,nj->n", a, inverse, a)
        with_r = np.einsum("ni,nij,nj->n", a, inverse, r[seen])

        told = own > 0.0
        size = np.abs(with_r[told]) / np.sqrt(own[told])  # in standard deviations of what the readings allow

        def likelihood(tau: float) -> float:
            """Of Student's t: a valve that is nearly shut must not outvote all other points."""
            wide = np.sqrt(1.0 + tau**2 * own[told])
            return float(np.sum(log_student(size / wide) - np.log(wide)))

        best = minimize_scalar(lambda log_tau: -likelihood(np.exp(log_tau)), bounds=_LOG_TAU, method="bounded")
        return 2.0 * (-float(best.fun) - likelihood(0.0)), float(np.exp(best.x))

    balances = {row: explained(np.eye(rows)[k]) for k, row in enumerate(ROWS)}
    site = max(balances, key=lambda row: balances[row][0])
    gain, std = balances[site]
    if gain <= 0.0:
        return None
    for place in (p for p, row in NEIGHBOURS.items() if row == site):
        moved = replace(model, signals={**model.signals, place: np.full(points.size, _STEP)})
        slopes = (moved.relations(points, x, values).residual[0][:, :rows] - r) / _STEP
        beside, spread = explained(np.nan_to_num(slopes))
        if beside >= _CLOSE * gain:
            return Scatter(site, std, gain, place, spread)
    return Scatter(site, std, gain)


__all__ = ["NEIGHBOURS", "Scatter", "scatter_of"]
