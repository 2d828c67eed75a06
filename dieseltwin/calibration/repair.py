"""Which terms the points call for: joint refit with each candidate, kept where the likelihood pays for it.

The score of a model is the log-likelihood of its residuals at the measured states (Student's t with 4 degrees of
freedom, one scale a submodel), divided by the number of points that err alike, less half a logarithm of their effective
number per coefficient. The held-out third is scored with coefficients and scales of the other two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from dieseltwin.calibration.calibrate import Calibration, Fit, fit_of
from dieseltwin.calibration.coefficients import (
    COOLER_DROP,
    TERMS,
    WORK,
    Coefficient,
    SteadyTerm,
    engine_coefficients,
    with_scalars,
)
from dieseltwin.calibration.likelihood import Estimate, estimate
from dieseltwin.calibration.steady_model import ROWS, WORK_ROW, SteadyModel
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.recordings.steady_points import SteadyPoints

Array = NDArray[np.float64]

WORTH = 3.0  # least gain of a term in the penalised log-likelihood (odds of 20)
ALIKE = 4.5  # terms whose gains differ by less can't be told apart (2 delta log-likelihood < 9)
MOST_TERMS = 5
DEGREES = 4.0  # of Student's t
FLOORS: Mapping[str, float] = {
    "cylinder_flow": 0.008, "turbine_flow": 0.01, "turbo_power": 0.025, "compressor_flow": 0.02, "egr_flow": 0.02,
    "exhaust_temperature": 0.02, WORK_ROW: 0.04,
}  # fmt: skip
"""Least error believed of each submodel's form [-]: what mean-value maps reach at best (Wahlström & Eriksson 2011,
Table of model errors: 2 to 7 %)."""


@dataclass(frozen=True)
class Candidate:
    """One term as it was tried.

    Attributes:
        term: the term.
        gain: penalised log-likelihood over the model without it [-].
        held_out_gain: log-likelihood per held-out point over the model without it [-]; None where not the best.
        magnitude, std: of its first parameter [unit].
        round: when it was tried, from 1.
        chosen: whether it was taken.
    """

    term: SteadyTerm
    gain: float
    held_out_gain: float | None
    magnitude: float
    std: float
    round: int
    chosen: bool


@dataclass(frozen=True)
class Repair:
    """The engine with the terms that its points call for, and the fuller model that answers for what wasn't measured.

    Attributes:
        calibration: where it came from.
        chosen: terms found, strongest first.
        equivalent: chosen name -> names that the points can't tell from it.
        candidates: all that were tried.
        model, estimate: with the chosen terms.
        full_model, full_estimate: with all terms that physics says are there (priors decide where the points don't).
        nll_before, nll_after: negative log-likelihood per held-out point.
        fits_before, fits_after: per submodel.
        chi2_before, chi2_after: mean squared residual over the scale of the repaired model.
        p_value: of no gain, from the likelihood ratio of all chosen terms.
    """

    calibration: Calibration
    chosen: tuple[Candidate, ...]
    equivalent: Mapping[str, tuple[str, ...]]
    candidates: tuple[Candidate, ...]
    model: SteadyModel
    estimate: Estimate
    full_model: SteadyModel
    full_estimate: Estimate
    nll_before: float
    nll_after: float
    fits_before: Mapping[str, Fit]
    fits_after: Mapping[str, Fit]
    chi2_before: float
    chi2_after: float
    p_value: float

    def engine(self) -> EngineParameters:
        """Engine parameters of the full model (without its terms)."""
        return with_scalars(self.full_model.engine, self.full_estimate.values())

    def values(self) -> dict[str, float]:
        """Every coefficient of the full model."""
        return {**self.calibration.start, **self.full_estimate.values()}


def available(points: SteadyPoints) -> tuple[SteadyTerm, ...]:
    """Terms whose columns the points have, and vary."""
    return tuple(
        term for term in TERMS.values()
        if all(name in points and np.nanstd(points[name]) > 1.0 for name in term.needs)
    )  # fmt: skip


@dataclass(frozen=True)
class _Fitted:
    model: SteadyModel
    values: Mapping[str, float]
    found: Estimate
    log_likelihood: float
    parameters: int


def repair(calibration: Calibration, *, noise: Mapping[str, float] | None = None) -> Repair:
    """Find the terms that the points call for.

    Args:
        calibration: of the engine without terms.
        noise: relative standard deviation of each reading [-].
    """
    points, mask = calibration.points, calibration.held_out
    free = [c for c in engine_coefficients(calibration.base, calibration.model.engine)
            if c.name in {i.name for i in calibration.coefficients}]
    plain = calibration.model
    inflation = max(calibration.estimate.inflation, 1.0)
    current = _fitted(plain, points, free, calibration.start, noise, iterations=8)
    first = current
    nll_before, trained_before = _held_out(current, points, mask, free, noise)
    nll, trained = nll_before, trained_before
    chosen: list[Candidate] = []
    tried: list[Candidate] = []
    equivalent: dict[str, tuple[str, ...]] = {}
    for attempt in range(1, MOST_TERMS + 1):
        if attempt > 1:  # the same effort as its rivals get, or they would win by it
            current = _fitted(current.model, points, _coefficients(free, current.model), current.values, noise)
        left = [t for t in available(points) if t.name not in current.model.active]
        trials: list[tuple[Candidate, _Fitted]] = []
        for term in left:
            model = SteadyModel(plain.engine, current.model.active | {term.name}, plain.extra)
            fitted = _fitted(model, points, _coefficients(free, model), current.values, noise)
            effective = points.size * len(ROWS) / inflation
            gain = (fitted.log_likelihood - current.log_likelihood) / inflation - 0.5 * len(term.parameters) * np.log(
                effective)
            head = term.parameters[0].name
            trials.append((Candidate(term, float(gain), None, fitted.found.values()[head], fitted.found.std()[head],
                                     attempt, False), fitted))
        if not trials:
            break
        trials.sort(key=lambda pair: -pair[0].gain)
        best, fitted = trials[0]
        nll_best, trained_best = _held_out(fitted, points, mask, free, noise)
        best = Candidate(**{**vars(best), "held_out_gain": nll - nll_best})
        trials[0] = (best, fitted)
        take = best.gain > WORTH and nll_best < nll
        tried += [Candidate(**{**vars(c), "chosen": take and c is best}) for c, _ in trials]
        if not take:
            break
        chosen.append(Candidate(**{**vars(best), "chosen": True}))
        equivalent[best.term.name] = tuple(c.term.name for c, _ in trials[1:] if best.gain - c.gain < ALIKE)
        current, nll, trained = fitted, nll_best, trained_best
    full_model = SteadyModel(plain.engine, frozenset(t.name for t in available(points)) | {WORK_ROW}, plain.extra)
    full_free = [*_coefficients(free, full_model), COOLER_DROP, *WORK]
    full_start = {**{c.name: c.mean for c in full_free}, **calibration.start, **current.values}
    full = estimate(full_model, points, full_free, full_start, noise=noise, iterations=8, inflate=True, floors=FLOORS,
                    rows=_rows(full_model, free))
    before = _all_fits(plain, points, mask, trained_before)
    after = _all_fits(current.model, points, mask, trained)
    scale = _scales(current.model, points, current.values)
    chi = [_chi2(m, points, v, scale) for m, v in ((plain, first.values), (current.model, current.values))]
    gain = 2.0 * max(current.log_likelihood - first.log_likelihood, 0.0) / inflation
    from scipy.stats import chi2

    p_value = float(chi2.sf(gain, max(current.parameters - first.parameters, 1)))
    return Repair(calibration, tuple(chosen), equivalent, tuple(tried), current.model, current.found, full_model, full,
                  nll_before, nll, before, after, chi[0], chi[1], p_value)


def _rows(model: SteadyModel, free: Sequence[Coefficient]) -> tuple[str, ...]:
    return tuple(row for row in model.rows if row not in ROWS or any(c.submodel == row for c in free))


def _coefficients(free: Sequence[Coefficient], model: SteadyModel) -> list[Coefficient]:
    return [*free, *(c for name in TERMS if name in model.active for c in TERMS[name].parameters)]


def _train(model: SteadyModel, points: SteadyPoints, mask: NDArray[np.bool_], free: Sequence[Coefficient],
           start: Mapping[str, float], noise: Mapping[str, float] | None) -> dict[str, float]:  # fmt: skip
    begin = {**{c.name: c.mean for c in free}, **start}
    found = estimate(model, points.take(~mask), free, begin, noise=noise, iterations=3, rows=_rows(model, free))
    return {**begin, **found.values()}


def _fitted(model: SteadyModel, points: SteadyPoints, free: Sequence[Coefficient],
            start: Mapping[str, float],
            noise: Mapping[str, float] | None, iterations: int = 3) -> _Fitted:  # fmt: skip
    begin = {**{c.name: c.mean for c in free}, **start}
    rows = _rows(model, free)
    found = estimate(model, points, free, begin, noise=noise, iterations=iterations, rows=rows)
    values = {**begin, **found.values()}
    total = _log_density(model, points, values, _scales(model, points, values))
    return _Fitted(model, values, found, float(total.sum()), len(free))


def _held_out(fitted: _Fitted, points: SteadyPoints, mask: NDArray[np.bool_], free: Sequence[Coefficient],
              noise: Mapping[str, float] | None) -> tuple[float, dict[str, float]]:  # fmt: skip
    """Negative log-likelihood per held-out point with coefficients and scales of the others, and those coefficients."""
    trained = _train(fitted.model, points, mask, _coefficients(free, fitted.model), fitted.values, noise)
    scale = _scales(fitted.model, points.take(~mask), trained)
    return float(-_log_density(fitted.model, points.take(mask), trained, scale).mean()), trained


def _scales(model: SteadyModel, points: SteadyPoints, values: Mapping[str, Any]) -> Array:
    """Scale of Student's t of each submodel's residual, (6,): maximum likelihood by fixed point."""
    r = model.relations(points, points.states(), values).residual[0][:, : len(ROWS)]
    s2 = np.nanmedian(r**2, axis=0) + 1e-6
    for _ in range(20):
        weight = (DEGREES + 1.0) / (DEGREES + r**2 / s2)
        s2 = np.nanmean(weight * r**2, axis=0) + 1e-6
    return np.sqrt(s2)


def _log_density(model: SteadyModel, points: SteadyPoints, values: Mapping[str, Any], scale: Array) -> Array:
    """Log-density of the residuals of each point, (n,)."""
    r = model.relations(points, points.states(), values).residual[0][:, : len(ROWS)]
    constant = gammaln((DEGREES + 1) / 2) - gammaln(DEGREES / 2) - 0.5 * np.log(DEGREES * np.pi)
    density = constant - np.log(scale) - 0.5 * (DEGREES + 1) * np.log1p((r / scale) ** 2 / DEGREES)
    return np.nansum(density, axis=1)


def _chi2(model: SteadyModel, points: SteadyPoints, values: Mapping[str, Any], scale: Array) -> float:
    r = model.relations(points, points.states(), values).residual[0][:, : len(ROWS)]
    return float(np.nanmean(np.minimum((r / scale) ** 2, 1e4)))


def _all_fits(model: SteadyModel, points: SteadyPoints, mask: NDArray[np.bool_],
              values: Mapping[str, float]) -> dict[str, Fit]:  # fmt: skip
    relations = model.relations(points, points.states(), values)
    scale = _scales(model, points, values)
    return {
        row: fit_of(relations.residual[0, :, i], relations.measured[row][0], relations.predicted[row][0], mask,
                    float(scale[i]))
        for i, row in enumerate(ROWS)
    }  # fmt: skip
