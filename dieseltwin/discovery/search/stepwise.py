"""Discovery on a small rig whose twin lacks several things: name them one by one, then look for a law in what is left.

Made for twins that are far from the noise (`dieseltwin.discovery.likelihood.worth`); the diesel engine has `discover`.
Each step refits all free parameters, magnitudes and initial states by simulation with every remaining hypothesis, takes
the best, and stops when none is worth what it costs. The judge is a part of the recording that no fit has seen, in
free run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from dieseltwin.discovery.laws import search as law_search
from dieseltwin.discovery.laws.twin import LawTwin
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.worth import Worth, independent
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.settings.strict import unknown_name

_ROUNDS = 25
_LOCAL_ROUNDS = 12
_LOCAL_DIFFERENCE = 1e-4  # of a state's scale
_FIRST_SIZE = 3.0  # tolerances: where a smooth effect's magnitude starts
_RIVALS = 9.0  # 2 delta log-likelihood (docs/discovery.md)
_LEAST_WORTH = 6.0  # beyond the charge
_CHECKED = 0.4  # of the windows, the last ones, on which a law must hold that was fitted to the others
_GAIN_OF_LAW = 0.97  # of the error there: a law must lower it, a name must not raise it
_LOSS_OF_NAME = 1.1


@dataclass(frozen=True)
class Step:
    """One effect named.

    Attributes:
        name, site, law, unit: of the hypothesis.
        worth: gain less its charge when it was taken, in units of -2 log likelihood.
        rivals: other names within 9 units at that step.
        weighed: every name that was fitted at that step with its worth, best first.
    """

    name: str
    site: str
    law: str
    unit: str
    worth: float
    rivals: tuple[str, ...]
    weighed: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Story:
    """What was left out.

    Attributes:
        before, after: fits without and with the named effects.
        steps: in the order of their worth.
        law: of what remained, or None.
        magnitudes: effect -> (magnitude, standard deviation scaled to the misfit) [unit].
        unresolved: sites of laws that explain what remained alike, where none of them was kept.
        left: every name that was fitted beside the last step's with its worth, best first; none was taken.
        withheld: names that were not to be used.
    """

    before: Fit
    after: Fit
    steps: tuple[Step, ...]
    law: law_search.Law | None
    magnitudes: dict[str, tuple[float, float]]
    unresolved: tuple[str, ...] = ()
    left: tuple[tuple[str, float], ...] = ()
    withheld: tuple[str, ...] = ()

    def explain(self, name: str) -> list[str]:
        """Why a name was or wasn't taken.

        Raises:
            InputError: a name that was neither weighed nor withheld.
        """
        if name in self.withheld:
            return [f"{name}: withheld from the catalogue"]
        lines: list[str] = []
        for number, step in enumerate(self.steps, 1):
            worth = dict(step.weighed).get(name)
            if worth is None:
                continue
            told = f"step {number}: worth {worth:.0f} beyond its charge"
            if name == step.name:
                return [*lines, f"{told}, the best of {len(step.weighed)}: taken"]
            alike = f"; within {_RIVALS:g} units they can't be told apart" if name in step.rivals else ""
            lines.append(f"{told}, {step.worth - worth:.0f} behind {step.name}{alike}")
        if (worth := dict(self.left).get(name)) is not None:
            why = f"{_LEAST_WORTH:g} is needed" if worth < _LEAST_WORTH else "it does not hold on the last windows"
            lines.append(f"beside what was named: worth {worth:.0f} beyond its charge, where {why}")
        if not lines:
            known = sorted({n for step in self.steps for n, _ in step.weighed} | {n for n, _ in self.left})
            raise unknown_name("effect", name, known)
        return [*lines, f"{name}: not taken"]

    def to_json(self) -> dict[str, Any]:
        """The story as JSON types: parameters before and after, effects with sizes, the law, what was weighed."""
        return {
            "parameters_before": self.before.parameters.tolist(), "parameters_after": self.after.parameters.tolist(),
            "effects": [
                {"name": s.name, "site": s.site, "law": s.law, "unit": s.unit, "worth": s.worth,
                 "magnitude": self.magnitudes[s.name][0], "std": self.magnitudes[s.name][1],
                 "equivalent_names": list(s.rivals), "weighed": dict(s.weighed)}
                for s in self.steps
            ],
            "law": None if self.law is None else {"site": self.law.site, "text": self.law.text},
            "unresolved": list(self.unresolved), "left": dict(self.left), "withheld": list(self.withheld),
            "sentences": self.sentences(),
        }  # fmt: skip

    def sentences(self) -> list[str]:
        """For people."""
        out = []
        for step in self.steps:
            value, std = self.magnitudes[step.name]
            apart = f"; not to be told from {', '.join(step.rivals)}" if step.rivals else ""
            size = f"{value:.4g} +- {std:.2g} {step.unit}"
            out.append(f"{step.name} at {step.site}: {step.law}; {size}; worth {step.worth:.0f}{apart}")
        if self.law is not None:
            out.append(f"none of the catalogue, at {self.law.site}: {self.law.text}")
        if self.unresolved:
            places = " or ".join(self.unresolved)
            out.append(f"something more, at {places}: laws were found, but none that this recording bears out")
        return out or ["nothing that a name or a law explains on this recording"]


def metric_of(twin: Twin, floor: float | None = None) -> Whitening:
    """Noise of the recording from differences, with a smallest sigma (quantisation) [unit of the channels]."""
    limits = None if floor is None else np.full(len(twin.channels), floor)
    return Whitening.of(twin.measured, estimate_noise(twin.measured, np.array([], dtype=int), limits), twin.starts)


def discover_stepwise(
    twin: Twin,
    most: int = 4,
    withhold: Sequence[str] = (),
    law: bool = True,
    floor: float | None = None,
    options: law_search.Options | None = None,
    judged_window_s: float | None = None,
) -> Story:
    """Names of what a twin left out, one by one, and a law for the rest.

    Args:
        twin: bound to the part of a recording that may be fitted.
        most: number of effects at most.
        withhold: names that must not be used.
        law: search a law in what is left (only if fewer than `most` effects were named). It is kept only where the
            recording tells its site, and where it lowers the error on windows that it wasn't fitted to.
        floor: smallest noise of a reading.
        options: of the law search; by default everywhere but at sensors, where any misfit can be explained.
        judged_window_s: length of the runs that a law must hold in [s]; None for one run over all of it. Twins that
            integrate without a restoring force drift in long runs, whatever the law.
    """
    whitening = metric_of(twin, floor)
    here = law_search.null_fit(twin, whitening)
    before = here.fit
    steps: list[Step] = []
    names = [name for name in twin.hypotheses if name not in withhold]
    left: tuple[tuple[str, float], ...] = ()
    while len(steps) < most:
        readings = independent(here.residual, twin.starts, len(twin.states))
        worth = Worth(here.fit.objective, readings)
        charge = np.log(readings) + 2.0 * np.log(max(len(names), 1))
        trials = []
        for name in names:
            if name not in here.fit.candidate.names:
                fitted = _with(twin, whitening, here, name)
                if fitted is None:
                    continue
                trials.append((worth(here.fit.objective - fitted.fit.objective) - charge, name, fitted))
        trials.sort(key=lambda trial: -trial[0])
        left = tuple((name, float(value)) for value, name, _ in trials)
        if not trials or trials[0][0] < _LEAST_WORTH:
            break
        if not _holds(twin, whitening, twin, here.fit, twin, trials[0][2].fit, _LOSS_OF_NAME):
            break
        value, name, here = trials[0]
        rivals = tuple(other for other_value, other, _ in trials[1:] if value - other_value < _RIVALS)
        hypothesis = twin.hypotheses[name]
        steps.append(Step(name, hypothesis.site, hypothesis.law, hypothesis.unit, value, rivals, left))
        left = ()
    kept: law_search.Law | None = None
    sites: tuple[str, ...] = ()
    if law and len(steps) < most:
        inside = tuple(p.name for p in twin.points if not p.site.startswith("sensor:"))
        chosen = options or law_search.Options(points=inside, unknown_misfit=True)
        found = law_search.search(twin, here, None, chosen).law
        if found is not None:
            sites = tuple(dict.fromkeys([found.site, *(rival.site for rival in found.rivals)]))
        # Laws at several sites aren't resolved: they have no meaning beyond what they were fitted to.
        if found is not None and len(sites) == 1:
            extended = cast(Twin, LawTwin(twin, found.placed))
            extra = [p.value for p in extended.parameters[len(twin.parameters) :]]
            fit = replace(here.fit, parameters=np.append(found.parameters, extra), local=found.local)
            if _holds(twin, whitening, twin, here.fit, extended, fit, _GAIN_OF_LAW, judged_window_s):
                kept = found
    scale = np.sqrt(max(here.fit.objective / independent(here.residual, twin.starts, len(twin.states)), 1.0))
    stds = here.fit.std[len(twin.parameters) :]
    magnitudes = {
        name: (float(value), float(scale * std))
        for name, value, std in zip(here.fit.candidate.names, here.fit.magnitudes, stds, strict=True)
    }
    unresolved = () if kept is not None else sites
    return Story(before, here.fit, tuple(steps), kept, magnitudes, unresolved, left, tuple(withhold))


def metric_like(whitening: Whitening, from_row: int) -> Whitening:
    """The whitening of the later rows."""
    return Whitening(whitening.present[from_row:], whitening.previous[from_row:], whitening.scale[from_row:])


def _with(twin: Twin, whitening: Whitening, here: Linearisation, name: str) -> Linearisation | None:
    """Best fit with one more effect, begun at each of its sizes and on either side; None where nothing shows it."""
    hypothesis = twin.hypotheses[name]
    sizes: Sequence[float] = hypothesis.sizes or (_FIRST_SIZE * hypothesis.tolerance,)
    if hypothesis.limits[0] < 0.0:
        sizes = (*sizes, *(-size for size in sizes))
    best: Linearisation | None = None
    for size in sizes:
        candidate = Candidate((*here.fit.candidate.names, name))
        magnitudes = np.append(here.fit.magnitudes, np.clip(size, *hypothesis.limits))
        start = Fit(candidate, here.fit.parameters, magnitudes, here.fit.local, np.inf, False)
        try:
            fitted = fit_fully(twin, whitening, start, rounds=_ROUNDS)
        except np.linalg.LinAlgError:
            continue
        if best is None or fitted.fit.objective < best.fit.objective:
            best = fitted
    return best


def _holds(
    twin: Twin, whitening: Whitening, plain: Twin, without: Fit, extended: Twin, fit: Fit, allowed: float,
    judged_window_s: float | None = None,
) -> bool:  # fmt: skip
    """Fitted to the first windows only, the addition doesn't raise the error in the last ones beyond `allowed`."""
    windows = len(twin.starts)
    first = round((1.0 - _CHECKED) * windows)
    if first < 1 or first >= windows:
        return True
    from_row = int(twin.starts[first])
    weights = np.asarray(whitening.scale).copy()
    weights[from_row:] = 0.0
    early = replace(whitening, scale=weights)
    later, rest = twin, whitening
    if allowed < 1.0 and hasattr(twin, "windowed"):  # long runs: many short ones forgive too much
        later = twin.windowed(judged_window_s, slice(from_row, None))
        rest = metric_like(whitening, from_row)
        from_row = 0
    errors = []
    for which, start in ((plain, without), (extended, fit)):
        try:
            fitted = fit_fully(which, early, start, rounds=_ROUNDS).fit
        except np.linalg.LinAlgError:
            return False
        if later is not twin:
            which = LawTwin(later, which.laws) if isinstance(which, LawTwin) else later
            fitted = replace(fitted, local=later.first_local())
        residual = np.subtract(later.measured, free_run(which, fitted, rest))[from_row:]
        errors.append(float(np.sqrt(np.nanmean((residual * rest.scale[from_row:]) ** 2))))
    return bool(errors[1] <= allowed * errors[0])


def repaired(twin: Twin, story: Story, law: bool = True) -> tuple[Twin, Fit]:
    """Twin and estimate of the story on any recording that `twin` is bound to; initial states are its first guess."""
    fit = replace(story.after, local=twin.first_local())
    if law and story.law is not None:
        extended = LawTwin(twin, story.law.placed)
        extra = [p.value for p in extended.parameters[len(twin.parameters) :]]
        return cast(Twin, extended), replace(fit, parameters=np.append(story.law.parameters, extra))
    return twin, fit


def free_run(twin: Twin, fit: Fit, whitening: Whitening, fitted_rows: int | None = None) -> Array:
    """Readings (n, C) with everything fixed but the initial states, which are fitted to the first rows of each window.

    Args:
        twin: bound to the recording.
        fit: parameters, magnitudes and first initial states.
        whitening: weights of the readings.
        fitted_rows: rows of each window that the initial states may see; None for all.
    """
    weights = np.asarray(whitening.scale).copy()
    n = len(twin.time_s)
    if fitted_rows is not None:
        within = np.arange(n) - twin.starts[np.searchsorted(twin.starts, np.arange(n), side="right") - 1]
        weights[within >= fitted_rows] = 0.0
    count, local, ends = len(twin.states), fit.local.copy(), np.append(twin.starts[1:], n)
    shrink = np.ones(len(twin.starts))
    best_cost, best_local = np.full(len(twin.starts), np.inf), local.copy()
    for _ in range(_LOCAL_ROUNDS):
        with np.errstate(over="ignore", invalid="ignore"):  # a long run may diverge; its step is taken back
            simulated = twin.simulate(_local_lanes(twin, fit, local))
        residual = np.nan_to_num((twin.measured - simulated[0]) * weights, nan=0.0, posinf=1e6, neginf=-1e6)
        for w, (start, end) in enumerate(zip(twin.starts, ends, strict=True)):
            rows = slice(int(start), int(end))
            cost = float(np.sum(residual[rows] ** 2))
            if cost < best_cost[w] and np.isfinite(simulated[:, rows]).all():
                best_cost[w], best_local[w], shrink[w] = cost, local[w], min(1.0, 2 * shrink[w])
                columns = [
                    ((simulated[1 + j] - simulated[0])[rows] * weights[rows]).ravel()
                    / (_LOCAL_DIFFERENCE * twin.state_scales[j])
                    for j in range(count)
                ]
                step = np.linalg.lstsq(np.stack(columns, axis=1), residual[rows].ravel(), rcond=1e-8)[0]
                local[w] = best_local[w] + shrink[w] * step
            else:
                shrink[w] *= 0.4
                local[w] = best_local[w] + 0.4 * (local[w] - best_local[w])
    return np.asarray(twin.simulate(_local_lanes(twin, fit, best_local))[0])


def _local_lanes(twin: Twin, fit: Fit, local: Array) -> Lanes:
    count = len(twin.states)
    lanes = replace(fit, local=local).lanes()
    moved = np.repeat(local[None], 1 + count, axis=0)
    for j in range(count):
        moved[1 + j, :, j] += _LOCAL_DIFFERENCE * twin.state_scales[j]
    many: Mapping[str, Any] = {name: np.repeat(value, 1 + count) for name, value in lanes.magnitudes.items()}
    return replace(lanes, parameters=np.repeat(lanes.parameters, 1 + count, axis=0), local=moved, magnitudes=many)
