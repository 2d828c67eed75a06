"""Where the balances are off and by how much there: what the points leave, as a smooth random function of the inputs.

A map that is wrong is wrong by alike amounts at alike points, so that what a fit leaves at the points foretells what it
leaves at others (kriging; Kennedy and O'Hagan, Bayesian calibration of computer models, 2001). Each balance has its own
size and length of such errors, by the likelihood of its residuals. A coefficient that is off moves the residuals at the
points as well: the foretold error moves along, and only what it can't follow stays in an interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from dieseltwin.arrays import Array
from dieseltwin.calibration.likelihood import reading_covariance, reading_noise
from dieseltwin.calibration.steady_model import MAP_MODE, SENSOR_ERROR, SteadyModel
from dieseltwin.recordings.steady_points import SteadyPoints

MOST_POINTS = 200  # that are kept: more tell little of a smooth function, and cost their third power
FAR, CLIP = 1.0, 0.5  # residuals beyond the first are left out, beyond the second cut
LENGTH, LENGTH_SPREAD = 1.2, 0.5  # belief of the length in standard deviations of the inputs, and of its logarithm
_LEAST, _OWN_LEAST = 1e-4, 3e-3  # of the sizes [-]
_LENGTHS = (0.3, 4.0)


@dataclass(frozen=True)
class Smoothness:
    """Of the errors of one balance.

    Attributes:
        level: standard deviation of the smooth part [-].
        length: over which it is alike, in standard deviations of the inputs.
        own: standard deviation of what differs from point to point [-].
    """

    level: float
    length: float
    own: float


@dataclass(frozen=True)
class Foretold:
    """Errors of the balances at m asked points.

    Attributes:
        weights: (R, m, n) of the residuals at the n points.
        variance: (m, R) of the smooth part, beside what the points tell.
        own: (R,) standard deviation from point to point.
        errors: from whose points they are foretold.
    """

    weights: Array
    variance: Array
    own: Array
    errors: LocalErrors

    def residual(self, values: Mapping[str, float | Array]) -> Array:
        """What the balances leave at the asked points with these coefficients, (lanes, m, R) [-]."""
        return np.einsum("rmn,lnr->lmr", self.weights, self.errors.residual(values))


@dataclass(frozen=True)
class LocalErrors:
    """Errors of the balances of one formulation, as its points tell them.

    Attributes:
        model: of the formulation; points: n settled ones, without lasting errors of maps as columns.
        centre, spread: (4,) of the inputs.
        smoothness: balance -> its errors.
        seen: (n, R) which residuals count; reading: (n, R) variance that the readings' noise gives them.
    """

    model: SteadyModel
    points: SteadyPoints
    centre: Array
    spread: Array
    smoothness: Mapping[str, Smoothness]
    seen: NDArray[np.bool_]
    reading: Array

    def residual(self, values: Mapping[str, float | Array]) -> Array:
        """At the n points, (lanes, n, R) [-]; 0 where it doesn't count."""
        r = self.model.relations(self.points, self.points.states_filled(), values).residual
        return np.where(self.seen, np.clip(np.nan_to_num(r), -CLIP, CLIP), 0.0)

    def at(self, points: SteadyPoints) -> Foretold:
        """What the n points foretell at m others."""
        here, there = self._places(self.points), self._places(points)
        rows = self.model.rows
        weights = np.zeros((len(rows), points.size, self.points.size))
        variance = np.zeros((points.size, len(rows)))
        for j, row in enumerate(rows):
            s, own = self.smoothness[row], self.seen[:, j]
            variance[:, j] = s.level**2
            if not own.any():
                continue
            K = _covariance(here[own], here[own], s) + np.diag(self.reading[own, j] + s.own**2)
            k = _covariance(there, here[own], s)
            told = np.linalg.solve(K, k.T).T
            weights[j][:, own] = told
            variance[:, j] = np.maximum(s.level**2 - np.einsum("mn,mn->m", told, k), 0.0)
        return Foretold(weights, variance, np.array([self.smoothness[row].own for row in rows]), self)

    def _places(self, points: SteadyPoints) -> Array:
        return (points.inputs() - self.centre) / self.spread


def thinned(points: SteadyPoints) -> SteadyPoints:
    """At most `MOST_POINTS` of the judged points, evenly over their rows, with the columns that any points have."""
    judged = points.judged
    chosen = np.unique(np.linspace(0, judged.size - 1, min(judged.size, MOST_POINTS)).round().astype(int))
    taken = judged.take(chosen)
    fitted = (MAP_MODE, SENSOR_ERROR)
    return SteadyPoints({k: v for k, v in taken.columns.items() if not k.startswith(fitted)}, taken.row)


def local_errors(
    model: SteadyModel, points: SteadyPoints, values: Mapping[str, float], places: tuple[Array, Array],
    smoothness: Mapping[str, Smoothness] | None = None,
) -> LocalErrors:  # fmt: skip
    """The errors that n points tell.

    Args:
        model, values: with all that was found.
        points: as `thinned` gives them.
        places: centre and spread (4,) of the inputs.
        smoothness: from a file; None: by the likelihood of the residuals.
    """
    model = replace(model, extra=())
    x = points.states_filled()
    r = model.relations(points, x, values).residual[0]
    measured = np.isfinite(points.states()).all(axis=1)
    seen = np.isfinite(r) & (np.abs(np.nan_to_num(r)) < FAR) & measured[:, None]
    sigma = reading_noise(x)
    reading = np.einsum("nii->ni", reading_covariance(model, points, x, values, sigma))
    found = LocalErrors(model, points, *places, smoothness or {}, seen, reading)
    if smoothness is None:
        at, left = found._places(points), found.residual(values)[0]
        smoothness = {row: _smoothness(at[own], left[own, j], reading[own, j])
                      for j, row in enumerate(model.rows) for own in (seen[:, j],)}  # fmt: skip
    return LocalErrors(model, points, *places, smoothness, seen, reading)


def _smoothness(at: Array, r: Array, reading: Array) -> Smoothness:
    """The most likely one of residuals (n,) at places (n, 4), `reading` (n,) being the variance of the readings."""
    scale = max(float(np.std(r)), _OWN_LEAST) if r.size else _OWN_LEAST
    first = np.log([scale, LENGTH, 0.5 * scale])

    def cost(logs: Array) -> float:
        s = Smoothness(*np.exp(logs))
        L = np.linalg.cholesky(_covariance(at, at, s) + np.diag(reading + s.own**2))
        white = np.linalg.solve(L, r)
        belief = 0.5 * ((logs[1] - first[1]) / LENGTH_SPREAD) ** 2
        return float(0.5 * white @ white + np.sum(np.log(np.diag(L))) + belief)

    bounds = [np.log(b) for b in ((_LEAST, 1.0), _LENGTHS, (_OWN_LEAST, 1.0))]
    best = minimize(cost, np.clip(first, *np.transpose(bounds)), method="L-BFGS-B", bounds=bounds)
    return Smoothness(*(float(v) for v in np.exp(best.x)))


def _covariance(a: Array, b: Array, s: Smoothness) -> Array:
    """Of the smooth part between places (m, 4) and (n, 4), (m, n): Matern's, once differentiable, as maps are."""
    distance = np.sqrt(3.0 * np.sum((a[:, None] - b[None]) ** 2, axis=-1)) / s.length
    return np.asarray(s.level**2 * (1.0 + distance) * np.exp(-distance))
