"""Fits of a twin with any set of effects: linearisations and damped Gauss-Newton over parameters and initial states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from dieseltwin.discovery.likelihood.metric import Metric, WhitenedNuisances, Whitening, covariance_of, std_of
from dieseltwin.discovery.likelihood.windows import bounded, settled_windows
from dieseltwin.discovery.time_limit import check_time
from dieseltwin.discovery.twins.interface import Array, Lanes, Strained, Twin, repeated, single

_DIFFERENCE = 1e-4  # of a scale, for sensitivities
_TOLERANCE_DIFFERENCE = 0.02  # of an effect's tolerance: small against what matters, large against rounding
_STEP_LIMIT = 2.0  # parameter scales in one step
_SHORTER_STEPS = 5
_SHORTENED = 0.35  # a step after one that led uphill
_CONVERGED = 0.05  # predicted decrease of the objective that counts as none
_NULL_ROUNDS = 12
PROMISED = 4.0
"""Times what a linear step predicts: what a fit may still gain at most."""


@dataclass(frozen=True)
class Candidate:
    """A set of effects, each with a factor of its magnitude over time where it isn't constant."""

    names: tuple[str, ...] = ()
    schedules: Mapping[str, Array] = field(default_factory=dict)

    def __str__(self) -> str:
        return " + ".join(self.names) or "health only"


@dataclass(frozen=True)
class Fit:
    """A fitted candidate.

    Attributes:
        candidate: what was fitted.
        parameters: (P,) free parameters [unit].
        magnitudes: (m,) of the candidate's effects [unit].
        local: (W, S) initial states.
        objective: -2 log marginal likelihood up to a constant that all fits on one linearisation share.
        converged: the last step predicted no further decrease worth naming.
        covariance: (P + m, P + m) of parameters and magnitudes, None before it is known.
    """

    candidate: Candidate
    parameters: Array
    magnitudes: Array
    local: Array
    objective: float
    converged: bool
    covariance: Array | None = None

    def lanes(self, **more: object) -> Lanes:
        """One lane at the estimate."""
        magnitudes = {name: self.magnitudes[i : i + 1] for i, name in enumerate(self.candidate.names)}
        return single(
            self.parameters, self.local, magnitudes=magnitudes, schedules=self.candidate.schedules, **more
        )

    @property
    def std(self) -> Array:
        """(P + m,) standard deviations, NaN before they are known, infinite where the recording tells nothing."""
        if self.covariance is None:
            return np.full(self.parameters.size + self.magnitudes.size, np.nan)
        return std_of(self.covariance)


def first_fit(twin: Twin, candidate: Candidate | None = None, magnitudes: Sequence[float] = ()) -> Fit:
    """Where every fit starts: parameters' first values, initial states from the readings, given magnitudes."""
    return Fit(
        candidate or Candidate(), np.array([p.first for p in twin.parameters]),
        np.asarray(magnitudes, dtype=np.float64), twin.first_local(), np.inf, False,
    )  # fmt: skip


def _differ(fits: Sequence[Fit]) -> bool:
    seen: dict[str, Array] = {}
    for fit in fits:
        for name in fit.candidate.names:
            schedule = fit.candidate.schedules.get(name)
            if name in seen and not _same(seen[name], schedule):
                return True
            seen[name] = schedule  # type: ignore[assignment]
    return False


def _same(a: Array | None, b: Array | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def lanes_of(fits: Sequence[Fit], own_schedules: bool = False) -> Lanes:
    """A lane per fit. With `own_schedules` an effect may have another schedule in each, else they must agree."""
    names = list(dict.fromkeys(name for fit in fits for name in fit.candidate.names))
    magnitudes = {name: np.zeros(len(fits)) for name in names}
    schedules: dict[str, Array] = {}
    for k, fit in enumerate(fits):
        for name, value in zip(fit.candidate.names, fit.magnitudes, strict=True):
            magnitudes[name][k] = value
        schedules.update(fit.candidate.schedules)
    if own_schedules:
        for name, some in schedules.items():
            own = [fit.candidate.schedules.get(name) for fit in fits if name in fit.candidate.names]
            if not all(_same(own[0], other) for other in own[1:]):
                schedules[name] = np.stack([fit.candidate.schedules.get(name, np.ones_like(some)) for fit in fits])
    return Lanes(
        np.stack([fit.parameters for fit in fits]), np.stack([fit.local for fit in fits]), magnitudes, schedules
    )


def simulate_fits(twin: Twin, fits: Sequence[Fit]) -> Array:
    """Readings of every fit, (len(fits), n, C); as few calls as schedules allow."""
    check_time()
    if twin.own_schedules:
        return twin.simulate(lanes_of(fits, own_schedules=True))
    out = np.empty((len(fits), *twin.measured.shape))
    remaining = list(range(len(fits)))
    while remaining:
        group: list[int] = []
        for index in remaining:
            if not _differ([fits[i] for i in [*group, index]]):
                group.append(index)
        out[group] = twin.simulate(lanes_of([fits[i] for i in group]))
        remaining = [i for i in remaining if i not in group]
    return out


def parameter_lanes(twin: Twin, fit: Fit, local: bool = True) -> tuple[Lanes, Array]:
    """The fit, then a lane per parameter, effect of the candidate and (if `local`) state; and the differences."""
    scales = np.array([p.scale for p in twin.parameters])
    P, m, S = len(scales), len(fit.candidate.names), len(twin.states) if local else 0
    lanes = repeated(lanes_of([fit]), 1 + P + m + S)
    steps = np.empty(P + m + S)
    for j in range(P):
        steps[j] = _DIFFERENCE * scales[j]
        lanes.parameters[1 + j, j] += steps[j]
    for j, name in enumerate(fit.candidate.names):
        steps[P + j] = effect_step(twin, name, fit.magnitudes[j])
        lanes.magnitudes[name][1 + P + j] += steps[P + j]
    for j in range(S):
        steps[P + m + j] = _DIFFERENCE * twin.state_scales[j]
        lanes.local[1 + P + m + j, :, j] += steps[P + m + j]
    return lanes, steps


def effect_step(twin: Twin, name: str, magnitude: float) -> float:
    """Difference for the sensitivity to an effect's magnitude, pointing into its limits [unit]."""
    hypothesis = twin.hypotheses[name]
    step = _TOLERANCE_DIFFERENCE * hypothesis.tolerance if hypothesis.smooth else 0.25 * hypothesis.tolerance
    return -step if magnitude + step > hypothesis.limits[1] else step


class Linearisation:
    """Sensitivities of the readings at one fit, and the metric that they make.

    Attributes:
        fit: the fit they were taken at, its objective in this metric.
        metric: with local states and nuisances of this fit.
        residual: (n, C) readings minus simulation.
        jacobian: (P + m, n, C) responses to parameters and to the fit's own effects [per unit].
        projected: (P + m, rows) the same in the metric.
        pulled_residual: (rows + P + m,) the residual in the metric, and how far the priors pull: what directions
            without the parameters' (`score.without_parameters`) are held against.
        loadings: (K, D) of nuisances that were learned, in the coordinates of the belief; None for others.

    Args:
        frozen: take metric, local and nuisance responses from this linearisation instead of making them anew.
        nuisance_response: (K, n, C) per standard deviation, where not frozen.
        whitened: the same as the metric takes it, where it is known.
    """

    def __init__(
        self, twin: Twin, whitening: Whitening, fit: Fit, frozen: Linearisation | None = None,
        nuisance_response: Array | None = None, loadings: Array | None = None,
        whitened: WhitenedNuisances | None = None,
    ) -> None:
        check_time()
        self.loadings: Array | None = loadings if frozen is None else frozen.loadings
        lanes, steps = parameter_lanes(twin, fit, local=frozen is None)
        simulated = twin.simulate(lanes)
        self.twin, self.whitening = twin, whitening
        self.simulated = simulated[0]
        self.residual = twin.measured - simulated[0]
        differences = (simulated[1:] - simulated[0]) / steps[:, None, None]
        known = len(twin.parameters) + len(fit.candidate.names)
        self.jacobian = differences[:known]
        # at once: what ties the rows of a window together is read once, not for each of them
        rows = whitening.apply(np.concatenate([differences, np.nan_to_num(self.residual)[None]]))
        if frozen is None:
            self.local_response = differences[known:]
            self.nuisance_response = nuisance_response
            whitened = whitened or WhitenedNuisances.of(whitening, nuisance_response)
            self.metric = Metric(
                whitening, twin.starts, self.local_response, twin.state_scales, whitened, rows[known:-1]
            )
        else:  # local states and tolerances act nearly alike everywhere near
            self.local_response = frozen.local_response
            self.nuisance_response = frozen.nuisance_response
            self.metric = frozen.metric
        self._whitened = np.concatenate([rows[:known], rows[-1:]])
        vectors = self.metric.project_whitened(self._whitened)
        self.projected, self.projected_residual = vectors[:-1], vectors[-1]
        self.precision = prior_precision(twin, len(fit.candidate.names))
        pull = 0.0 if isinstance(twin, Strained) and twin.strained else np.sqrt(self.precision) * self._offset(fit)
        self.pulled_residual = np.append(self.projected_residual, np.broadcast_to(pull, self.precision.shape))
        self.covariance = covariance_of(self.projected @ self.projected.T + np.diag(self.precision))
        ran = np.isfinite(self.simulated[whitening.present]).all()  # a run without an end explains nothing
        objective = self.objective(self.projected_residual, fit.parameters) if ran else np.inf
        self.fit = replace(fit, objective=objective, covariance=self.covariance)

    def objective(self, projected: Array, parameters: Array) -> float:
        """-2 log marginal likelihood, up to a constant of this metric."""
        return float(projected @ projected + prior_misfit(self.twin, parameters))

    def step(self) -> tuple[Array, float]:
        """Gauss-Newton step of parameters and magnitudes, and the decrease that it predicts."""
        gradient = self.projected @ self.projected_residual + self.precision * self._offset(self.fit)
        step = self.covariance @ gradient
        return step, float(gradient @ step)

    def joint(self) -> tuple[Array, Array]:
        """Columns (P + m + K, rows) of parameters, effects and nuisances beside initial states, and their information
        with their priors: nuisances are unknowns like the others here."""
        own = self.nuisance_response
        columns = self.metric.without_local(self.jacobian if own is None else np.concatenate([self.jacobian, own]))
        precision = np.append(np.maximum(self.precision, 1e-30), np.ones(len(columns) - len(self.jacobian)))
        return columns, columns @ columns.T + np.diag(precision)

    def _offset(self, fit: Fit) -> Array:
        """(P + m,) from a fit's parameters to the centres of their priors; effects have none."""
        centres = np.array([p.value for p in self.twin.parameters])
        return np.concatenate([centres - fit.parameters, np.zeros(len(fit.candidate.names))])

    def local_step(self, change: Array) -> Array:
        """Change of the initial states that goes with a change of parameters and magnitudes, (W, S)."""
        return self.metric.local_steps_of_whitened((self._whitened[-1] - change @ self._whitened[:-1])[None])[0]

    def without_nuisances(self, residual: Array) -> Array:
        """A residual (n, C) without what tolerances most likely are of it."""
        if self.nuisance_response is None:
            return residual
        taken: Array = np.tensordot(self.metric.nuisance_estimate(residual), self.nuisance_response, 1)
        return residual - taken


def prior_precision(twin: Twin, effects: int) -> Array:
    """(P + m,) inverse variances of the parameters' priors; effects have none."""
    return np.concatenate([[1.0 / p.prior_std**2 for p in twin.parameters], np.zeros(effects)])


def prior_misfit(twin: Twin, parameters: Array) -> float:
    """Squared distance from the priors' centres in their standard deviations."""
    return float(sum(((x - p.value) / p.prior_std) ** 2 for x, p in zip(parameters, twin.parameters, strict=True)))


def within_limits(twin: Twin, parameters: Array, names: Sequence[str], magnitudes: Array) -> tuple[Array, Array]:
    """Parameters kept within reason (positive ones positive), magnitudes inside their limits."""
    values = np.array([p.value for p in twin.parameters])
    spans = np.array([p.prior_std if p.bounded else np.inf for p in twin.parameters])
    limits = np.array([twin.hypotheses[name].limits for name in names]).reshape(-1, 2)
    positive = (values > 0.0) & np.isfinite(spans)
    lowest = np.where(positive, np.maximum(values - 4 * spans, 0.2 * values), values - 4 * spans)
    parameters = np.clip(parameters, lowest, values + 4 * spans)
    return parameters, np.clip(magnitudes, limits[:, 0], limits[:, 1])


def fit_fully(
    twin: Twin, whitening: Whitening, start: Fit, nuisance_response: Array | None = None, rounds: int = _NULL_ROUNDS,
    frozen: Linearisation | None = None, loadings: Array | None = None, ahead: float = np.inf,
) -> Linearisation:  # fmt: skip
    """Damped Gauss-Newton with sensitivities of every round; returns the linearisation at the minimum.

    Or before, where what the steps promise doesn't reach the objective `ahead`.

    `nuisance_response` (K, n, C) is held fixed: tolerances are small, so that their responses hardly move. With
    `frozen` the whole metric of another linearisation is kept, and objectives are comparable to its own.
    """
    whitened = WhitenedNuisances.of(whitening, nuisance_response) if frozen is None else None
    make = partial(
        Linearisation, twin, whitening, frozen=frozen, nuisance_response=nuisance_response, loadings=loadings,
        whitened=whitened,
    )  # fmt: skip
    here = make(start)
    for _ in range(rounds):
        step, predicted = here.step()
        if not np.isfinite(predicted):  # sensitivities of a run without an end lead nowhere
            return _marked(here, False)
        if predicted < _CONVERGED:
            return _marked(here, True)
        if here.fit.objective - PROMISED * predicted > ahead:
            return _marked(here, False)
        there = _downhill(make, here, step, predicted, local=True)
        if there is None and predicted > 20 * _CONVERGED:
            there = _downhill(make, here, step, predicted, local=False)
        if there is None:
            return _marked(here, predicted < 20 * _CONVERGED)
        gained = here.fit.objective - there.fit.objective
        here = there
        if gained < _CONVERGED:
            return _marked(here, True)
    return _marked(here, here.step()[1] < 20 * _CONVERGED)


def _downhill(
    make: Callable[[Fit], Linearisation], here: Linearisation, step: Array, predicted: float, *, local: bool
) -> Linearisation | None:
    """The first of ever shorter steps that lowers the objective, None if none does.

    A step that promises less than counts as converged isn't tried. A simulation, judged by the metric from which the
    step starts, tells whether it is worth sensitivities of its own, as nearly half of the last steps of a fit aren't;
    where the full step isn't, one simulation of all shorter ones.
    `local`: whether initial states move along. They do in general; but one window in which a valve or a stop turns its
    slope round, so that its own step leads uphill, would stop all the others.
    """
    scales = np.array([p.scale if p.bounded else np.inf for p in here.twin.parameters])
    P = len(scales)
    longest = min(1.0, float(np.min(_STEP_LIMIT * scales / np.maximum(np.abs(step[:P]), 1e-300), initial=1.0)))
    shares = [longest * _SHORTENED**k for k in range(_SHORTER_STEPS)]
    shares = [s for k, s in enumerate(shares) if k == 0 or s * (2.0 - s) * predicted >= _CONVERGED]
    for some in (shares[:1], shares[1:]):
        trials = [_trial(here, step, share, local=local) for share in some]
        if not trials:
            break
        simulated = simulate_fits(here.twin, trials)
        projected = here.metric.project(np.nan_to_num(here.twin.measured - simulated))
        ended = np.asarray(np.isfinite(simulated[:, here.whitening.present]).all(axis=1))  # else it would explain all
        for trial, vector, ran in zip(trials, projected, ended, strict=True):
            if ran and here.objective(vector, trial.parameters) < here.fit.objective:
                there = _lower(make, here, trial)
                if there is not None:
                    return there
    return None


def _lower(make: Callable[[Fit], Linearisation], here: Linearisation, trial: Fit) -> Linearisation | None:
    """The linearisation at a trial, where its objective is lower and some way leads on from there."""
    try:
        there = make(trial)
    except np.linalg.LinAlgError:  # the machine runs away there
        return None
    lower = there.fit.objective < here.fit.objective and np.isfinite(there.covariance).all()
    return there if lower else None


def _trial(here: Linearisation, step: Array, share: float, *, local: bool) -> Fit:
    """The fit after a share of a step, kept within its limits."""
    P, fit = len(here.twin.parameters), here.fit
    parameters, magnitudes = within_limits(
        here.twin, fit.parameters + share * step[:P], fit.candidate.names, fit.magnitudes + share * step[P:]
    )
    begun = fit.local
    if local:
        moved = np.concatenate([parameters - fit.parameters, magnitudes - fit.magnitudes])
        begun = bounded(here.twin, begun + share * here.local_step(moved / share))
    return replace(fit, parameters=parameters, magnitudes=magnitudes, local=begun)


def settle_local(at: Linearisation, rounds: int = 3) -> Linearisation:
    """Initial states at their minimum, window by window, at fixed parameters; the linearisation there.

    The metric takes initial states out linearly: without it the objective would promise what no simulation keeps.
    """
    def residual_at(local: Array) -> Array:
        return np.nan_to_num(at.twin.measured - at.twin.simulate(lanes_of([replace(at.fit, local=local)]))[0])

    residual = np.nan_to_num(at.residual)
    elsewhere = residual - at.without_nuisances(residual)
    local, _ = settled_windows(at.twin, at.metric, at.fit.local, residual, elsewhere, residual_at, rounds)
    if local is at.fit.local:
        return at
    fit = replace(at.fit, local=local)
    return _marked(Linearisation(at.twin, at.whitening, fit, None, at.nuisance_response, at.loadings), fit.converged)


def _marked(at: Linearisation, converged: bool) -> Linearisation:
    at.fit = replace(at.fit, converged=converged)
    return at
