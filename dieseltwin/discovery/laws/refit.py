"""Refit of laws by simulation: coefficient, parameters and initial states together, with one linearisation's slopes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dieseltwin.discovery.laws.ranking import Ranked
from dieseltwin.discovery.laws.twin import LawTwin, Placed, before, trajectories
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, prior_precision, within_limits
from dieseltwin.discovery.likelihood.nuisance import signal_responses
from dieseltwin.discovery.likelihood.refit import scatter
from dieseltwin.discovery.likelihood.windows import bounded
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, repeated

_ROUNDS = 12
_DONE = 0.3  # predicted decrease of the objective that counts as none
_SLOWED = 0.35  # step after a failed one
_STEP = 0.005  # of a point's scale, for responses to signals
_LARGEST = 1e30  # of a slope
_SHAPE_STEP = 0.02  # relative, for slopes of times and widths
_SHARE_OF_FORMS = 0.025  # of the gain: bumps over another argument than the true one stay 5 % behind


@dataclass(frozen=True)
class Refit:
    """A law refitted.

    Attributes:
        ranked: the candidate.
        twin: with the law at its estimate.
        fit: of that twin.
        gain: decrease of -2 log likelihood.
    """

    ranked: Ranked
    twin: LawTwin
    fit: Fit
    gain: float

    @property
    def score(self) -> float:
        """Gain less charge."""
        return self.gain - self.ranked.charge


def spread_over_forms(
    best: LawTwin, fit: Fit, others: Sequence[tuple[float, Refit]], variables: Mapping[str, Array]
) -> float:
    """Deviation of the size of a law over the forms that explain as much, relative to its own [-].

    A form's own interval says how well its coefficient is known if the form is right. Which form is right the recording
    says by their scores alone: each counts by its probability. The size is the rms of what enters the point.

    Args:
        best: the law with its fit.
        others: probability over the law's own, and refit, of any point; those of its own point count.
        variables: along the trajectory of the best.
    """
    point = best.laws[0].form.point
    here = [(weight, r) for weight, r in others if r.twin.laws[0].form.point == point]
    laws = [(best, fit), *((r.twin, r.fit) for _, r in here)]
    if any(placed.form.fixed is not None for law, _ in laws for placed in law.laws):
        return 0.0  # an operator moves the quantity itself: its time is no size beside another form's
    at = before(variables, point)
    sizes, weights = [], np.array([1.0, *(weight for weight, _ in here)])
    for law, own in laws:
        terms = zip(law.laws, law.values(own.parameters), strict=True)
        total = sum(np.asarray(c * placed.form.value(at, shape)) for placed, (c, shape) in terms)
        sizes.append(float(np.sqrt(np.mean(np.square(total)))))
    if not (np.isfinite(sizes).all() and sizes[0] > 0.0):
        return 0.0
    return float(np.sqrt(np.sum(weights * (np.array(sizes) / sizes[0] - 1.0) ** 2) / weights.sum()))


def disagreement(best: Refit, refits: Sequence[Refit], count: int) -> Array:
    """Standard deviation (count,) of the twin's parameters over laws that may be the true one: other forms at the
    point of the best, and the best of every other point.

    A law is the nearest form that the grammar has. The right point with a form that is a little wrong can so be behind
    another point by far more than chance; by which share of the gain is measured (docs/discovery.md).
    """
    point = best.twin.laws[0].form.point
    forms, leaders = [], dict[str, Refit]()
    for refit in sorted(refits, key=lambda r: -r.score):
        here = refit.twin.laws[0].form.point
        if here == point:
            forms.append(refit)
        else:
            leaders.setdefault(here, refit)
    return np.hypot(_scatter(best, forms, count), _scatter(best, [best, *leaders.values()], count))


def _scatter(best: Refit, refits: Sequence[Refit], count: int) -> Array:
    behind = np.array([max(best.score - r.score, 0.0) for r in refits]) / max(1.0, _SHARE_OF_FORMS * best.gain)
    return scatter(np.array([r.fit.parameters[:count] for r in refits]), best.fit.parameters[:count], behind)


def start_of(at: Linearisation, law: LawTwin) -> Fit:
    """The linearisation's fit with the law's first values."""
    extra = np.array([p.value for p in law.parameters[len(law.base.parameters) :]])
    known = len(law.base.parameters)
    values = np.concatenate([at.fit.parameters[:known], extra])
    return Fit(at.fit.candidate, values, at.fit.magnitudes, at.fit.local, np.inf, False)


def refit_all_laws(
    twin: Twin, at: Linearisation, before: float, items: Sequence[Ranked], variables: Mapping[str, Array]
) -> list[Refit]:
    """Refits of candidates; all lanes at once where the laws become signals.

    Args:
        twin: without laws.
        at: linearisation that gives metric and slopes.
        before: objective without a law, from which gains count.
        items: what to refit.
        variables: along the trajectory of `at`.
    """
    if not items:
        return []
    if hasattr(twin, "simulate_with_laws"):
        return [_refit_inside(twin, at, before, item) for item in items]
    return _refit_as_signals(twin, at, before, items, variables)


class _Slopes:
    """Columns of one candidate in the metric, and its Newton step.

    Args:
        at: linearisation that gives metric and slopes of the parameters.
        own: responses (m, n, C) to the candidate's terms, and projected: (m, rows) in the metric.
        precision, nominal: (P + m,) of the priors of parameters and terms.
    """

    def __init__(
        self, at: Linearisation, own: Array, projected: Array, precision: Array, nominal: Array
    ) -> None:
        known = len(precision) - len(own)
        self.precision, self.nominal = precision, nominal
        self.columns = np.concatenate([at.jacobian[:known], own])
        self.projected = np.concatenate([at.projected[:known], projected])
        self._invert()

    def _invert(self) -> None:
        self.covariance = np.linalg.pinv(self.projected @ self.projected.T + np.diag(self.precision))

    def objective(self, vector: Array, values: Array) -> float:
        return float(vector @ vector + np.sum(self.precision * (values - self.nominal) ** 2))

    def step(self, vector: Array, values: Array) -> tuple[Array, float]:
        gradient = self.projected @ vector + self.precision * (self.nominal - values)
        step = self.covariance @ gradient
        return step, float(gradient @ step)

    def learn(self, change: Array, before: Array, after: Array) -> None:
        """Slopes that say what a step did, as close to those of before as can be (Broyden 1965, in the metric).

        Far from the fit without a law its slopes lead astray: of 1,658 that a back pressure explains, steps along them
        found 1,609.
        """
        missed = after - before + change @ self.projected
        weight = (self.projected @ self.projected.T + np.diag(self.precision)) @ change
        length = float(weight @ change)
        if length > 0.0 and np.isfinite(missed).all():
            self.projected = self.projected - np.outer(weight / length, missed)
            self._invert()

    def rest(self, residual: Array, change: Array) -> Array:
        """What a change (P + m,) leaves of a residual (n, C)."""
        return residual - np.tensordot(change, self.columns, 1)


def _refit_inside(twin: Twin, at: Linearisation, before: float, item: Ranked) -> Refit:
    """Chord fit with the law evaluated inside the simulation."""
    law = LawTwin(twin, item.placed)
    known, extra = len(twin.parameters), len(law.parameters) - len(twin.parameters)
    fit = start_of(at, law)
    lanes = fit.lanes()
    steps = np.array([1e-3 * p.scale for p in law.parameters[known:]])
    tried = repeated(lanes, 1 + extra)
    moved = tried.parameters.copy()
    moved[np.arange(1, 1 + extra), known + np.arange(extra)] += steps
    simulated = law.simulate(replace(tried, parameters=moved))
    if not np.all(np.isfinite(simulated)):
        return Refit(item, law, fit, -np.inf)
    own = (simulated[1:] - simulated[0]) / steps[:, None, None]
    nominal = np.array([p.value for p in law.parameters])
    own = np.clip(own, -_LARGEST, _LARGEST)  # a candidate that diverges takes no step
    slopes = _Slopes(at, own, at.metric.project(np.nan_to_num(own)), prior_precision(law, 0), nominal)
    lowest = np.where(nominal > 0, 0.05 * nominal, -np.inf)
    residual = np.nan_to_num(twin.measured - simulated[0])
    vector = at.metric.project(residual[None])[0]
    best = replace(fit, objective=slopes.objective(vector, fit.parameters))
    shrink = 1.0
    for _ in range(_ROUNDS):
        step, predicted = slopes.step(vector, best.parameters)
        if predicted < _DONE:
            break
        values = np.maximum(best.parameters + shrink * step, lowest)
        rest = slopes.rest(residual, (values - best.parameters) / shrink)
        local = bounded(twin, best.local + shrink * at.metric.local_steps_beside_nuisances(rest[None])[0])
        trial = replace(best, parameters=values, local=local)
        new = np.nan_to_num(twin.measured - law.simulate(trial.lanes())[0], nan=0.0, posinf=1e6, neginf=-1e6)
        new_vector = at.metric.project(new[None])[0]
        value = slopes.objective(new_vector, values)
        gain = best.objective - value
        if np.isfinite(value) and gain > 0:
            best, residual, vector = replace(trial, objective=value), new, new_vector
            shrink = min(1.0, 2.0 * shrink)
            if gain < _DONE:
                break
        else:
            shrink *= _SLOWED
            if shrink < 0.03:
                break
    return Refit(item, law, best, before - best.objective)


def _term(placed: Placed, variables: Mapping[str, Array], amount: float, n: int) -> Array:
    """Signal of one term: `amount` is its coefficient, or its shape where the coefficient is fixed."""
    at = before(variables, placed.form.point)
    if placed.form.fixed is None:
        return np.asarray(amount * np.broadcast_to(placed.form.value(at), (n,)))
    return np.asarray(placed.form.fixed * np.broadcast_to(placed.form.value(at, amount), (n,)))


@dataclass
class _Lane:
    """One candidate on its way."""

    item: Ranked
    slopes: _Slopes
    values: Array  # parameters, then amounts of the terms
    local: Array
    variables: Mapping[str, Array]
    trial: tuple[Array, Array]
    objective: float = np.inf
    residual: Array | None = None
    vector: Array | None = None
    shrink: float = 1.0
    active: bool = True
    moved: bool = False  # the law has not been evaluated along the trajectory that it led to
    again: bool = False  # the trial is the same values with the law along their own trajectory


def _refit_as_signals(
    twin: Twin, at: Linearisation, before: float, items: Sequence[Ranked], variables: Mapping[str, Array]
) -> list[Refit]:
    """Chord fits of all candidates in step: a round is one simulation of all, whose variables make the next signals."""
    known, n = len(twin.parameters), len(twin.time_s)
    base_lanes = at.fit.lanes()
    firsts = [np.array([_amount(p) for p in item.placed]) for item in items]
    signals, points, sizes = [], [], []
    for item, first in zip(items, firsts, strict=True):
        for placed, amount in zip(item.placed, first, strict=True):
            scale = _STEP * twin.points[item.index].scale
            if placed.form.fixed is None:
                slope = _term(placed, variables, 1.0, n)
            else:
                step = _SHAPE_STEP * amount
                slope = (_term(placed, variables, amount + step, n) - _term(placed, variables, amount, n)) / step
            size = scale / max(float(np.max(np.abs(slope))), 1e-300)
            signals.append(np.nan_to_num(slope * size, posinf=0.0, neginf=0.0))  # a quotient by what there is none of
            points.append(item.index)
            sizes.append(size)
    responses = signal_responses(at.twin, base_lanes, at.simulated, points, np.stack(signals))
    responses = np.clip(responses / np.array(sizes)[:, None, None], -_LARGEST, _LARGEST)  # as `_refit_inside`
    projected = at.metric.project(np.nan_to_num(responses))
    precision, nominal = prior_precision(twin, 0), np.array([p.value for p in twin.parameters])
    lanes, used = [], 0
    for item, first in zip(items, firsts, strict=True):
        own = slice(used, used + len(first))
        used += len(first)
        padded = np.append(precision, np.zeros(len(first))), np.append(nominal, first)
        values = np.append(at.fit.parameters[:known], first)
        slopes = _Slopes(at, responses[own], projected[own], *padded)
        lanes.append(_Lane(item, slopes, values, at.fit.local, variables, (values, at.fit.local)))
    for _ in range(_ROUNDS):
        active = [lane for lane in lanes if lane.active]
        if not active:
            break
        _advance(twin, at, base_lanes, active, known, n)
    return [_finished(twin, at, before, lane, known) for lane in lanes]


def _amount(placed: Placed) -> float:
    return placed.coefficient if placed.form.fixed is None else placed.form.factors[0].shape


def _advance(twin: Twin, at: Linearisation, base: Lanes, active: Sequence[_Lane], known: int, n: int) -> None:
    """One round: simulate all trials, keep what is better, propose the next."""
    entered = np.zeros((len(active), n))
    for k, lane in enumerate(active):
        for placed, amount in zip(lane.item.placed, lane.trial[0][known:], strict=True):
            entered[k] += np.nan_to_num(_term(placed, lane.variables, float(amount), n))
    count = len(active)
    lanes = Lanes(
        np.stack([lane.trial[0][:known] for lane in active]), np.stack([lane.trial[1] for lane in active]),
        {name: np.repeat(value, count) for name, value in base.magnitudes.items()}, base.schedules, base.signals,
        np.array([lane.item.index for lane in active]), entered,
    )  # fmt: skip
    readings, variables = trajectories(twin, lanes, {})
    residuals = np.nan_to_num(twin.measured[None] - readings, nan=0.0, posinf=1e6, neginf=-1e6)
    vectors = at.metric.project(residuals)
    stepping: list[tuple[_Lane, Array, Array]] = []
    for k, lane in enumerate(active):
        value = lane.slopes.objective(vectors[k], lane.trial[0])
        gain = lane.objective - value
        if lane.vector is not None and not lane.again and np.isfinite(value):
            lane.slopes.learn(lane.trial[0] - lane.values, lane.vector, vectors[k])
        if np.isfinite(value) and (gain > 0 or lane.again):
            lane.values, lane.local = lane.trial
            lane.objective, lane.residual, lane.vector = value, residuals[k], vectors[k]
            lane.variables = {**variables[k], "time_s": twin.time_s}
            if lane.again:
                lane.again, lane.moved = False, abs(gain) > _DONE
            else:
                lane.shrink, lane.moved = min(1.0, 2.0 * lane.shrink), True
                lane.active = gain > _DONE
        elif lane.moved:  # no step leads down from an objective that a law of elsewhere has
            lane.again, lane.trial = True, (lane.values, lane.local)
            continue
        else:
            lane.shrink *= _SLOWED
            lane.active = lane.shrink > 0.03
        if lane.vector is None or lane.residual is None:
            lane.trial = (0.5 * (lane.trial[0] + _null(lane, at, known)), lane.local)
            continue
        step, predicted = lane.slopes.step(lane.vector, lane.values)
        lane.active = lane.active and predicted > _DONE
        values = lane.values + lane.shrink * step
        values[:known] = within_limits(twin, values[:known], (), np.zeros(0))[0]
        for j, placed in enumerate(lane.item.placed):
            if placed.form.fixed is not None:
                values[known + j] = max(values[known + j], 0.1 * lane.values[known + j])
        stepping.append((lane, values, lane.slopes.rest(lane.residual, (values - lane.values) / lane.shrink)))
    if stepping:
        steps = at.metric.local_steps_beside_nuisances(np.stack([rest for _, _, rest in stepping]))
        for (lane, values, _), step in zip(stepping, steps, strict=True):
            lane.trial = values, bounded(twin, lane.local + lane.shrink * step)


def _null(lane: _Lane, at: Linearisation, known: int) -> Array:
    """The null fit's parameters and no law: where a candidate that can't be simulated shrinks to."""
    return np.append(at.fit.parameters[:known], np.zeros(len(lane.values) - known))


def _finished(twin: Twin, at: Linearisation, before: float, lane: _Lane, known: int) -> Refit:
    placed: list[Placed] = []
    for p, amount in zip(lane.item.placed, lane.values[known:], strict=True):
        changed: Any
        if p.form.fixed is None:
            changed = replace(p, coefficient=float(amount) or 1e-12)
        else:
            changed = replace(p, form=p.form.with_shape(float(amount)))
        placed.append(changed)
    law = LawTwin(twin, placed)
    start = start_of(at, law)
    values = np.append(lane.values[:known], [p.value for p in law.parameters[known:]])
    fit = replace(start, parameters=values, local=lane.local, objective=lane.objective)
    return Refit(lane.item, law, fit, before - lane.objective)
