"""None of these, at a sensor: a gain, an offset or a lag of a reading, refitted by simulation with all parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.features import FaultKind, Structure
from dieseltwin.discovery.laws.final_fit import Tolerances, about_itself
from dieseltwin.discovery.laws.reading_twin import ReadingFault, ReadingTwin
from dieseltwin.discovery.laws.refit import Refit
from dieseltwin.discovery.laws.search import RESOLVED, RIVALS, Law, LawSearch, Rival
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.twins.interface import Twin, law_scope_of
from dieseltwin.discovery.twins.onset_times import onset_reaches, times_about

_WITHIN = 0.5  # of the best linear gain: faults that are refitted
_MOST = 4
_SCREENED = 0.3  # of the best linear gain inside the machine: points with less seldom have the law that comes first
_LEAST_POINTS = 4  # are looked at in any case
_ROUNDS = 8
_LAGS_S = (0.2, 1.0)  # where a lag's fit begins, too: what a long one does isn't linear


def faults_of(
    structure: Sequence[Structure], channels: Sequence[str], since_s: float | None = None
) -> list[ReadingFault]:
    """Faults of sensors worth a refit, by their linear gains: those of a scored `features.generic_features`, from a
    time on [s]."""
    sensors = [item for item in structure if item.feature.channel is not None]
    found: dict[tuple[int, FaultKind], float] = {}
    for item in sensors:
        channel, kind = cast(int, item.feature.channel), cast(FaultKind, item.feature.fault)
        if item.gain >= _WITHIN * sensors[0].gain:
            # an offset's coefficient is relative to the simulated mean
            size = float(np.max(np.abs(item.response))) if kind == "offset" else 1.0
            found.setdefault((channel, kind), item.coefficient * size)
    return [ReadingFault(channels[at], kind, size, None, since_s) for (at, kind), size in list(found.items())[:_MOST]]


def near_the_best(structure: Sequence[Structure], twin: Twin) -> tuple[str, ...] | None:
    """Names of the points at which simple terms gain enough for a law to be looked for; None for all.

    A simple term's linear gain costs one lane of a simulation, all forms of a point cost as many as a window has
    samples. A law follows more than a simple term, but seldom a multiple of it.
    """
    best: dict[int, float] = {}
    for item in structure:
        if item.feature.point is not None:
            best[item.feature.point] = max(item.gain, best.get(item.feature.point, 0.0))
    if len(best) <= _LEAST_POINTS:
        return None
    ordered = sorted(best, key=lambda index: -best[index])
    limit = min(_SCREENED * best[ordered[0]], best[ordered[_LEAST_POINTS - 1]])
    return tuple(twin.points[index].name for index in ordered if best[index] >= limit)


@dataclass(frozen=True)
class FaultFit:
    """The fault of a sensor that explains most, refitted; two of the same sensor where the second explains enough.

    Attributes:
        faults: with their first sizes.
        at: the fit of the twin with it.
        gain: decrease of -2 log likelihood against no fault.
        charge: for the faults' sizes, and for the choice of them.
        rivals: other faults that the recording can't tell from it.
    """

    faults: tuple[ReadingFault, ...]
    at: Linearisation
    gain: float
    charge: float
    rivals: tuple[Rival, ...]

    @property
    def score(self) -> float:
        """Gain less charge."""
        return self.gain - self.charge

    def law(self, tolerances: Tolerances | None = None) -> Law:
        """As a law, its std with the tolerances inside; `tolerances`: as of `laws_in_turn`."""
        twin = cast(ReadingTwin, self.at.twin)
        count, name = len(twin.base.parameters), self.faults[0].channel
        best = about_itself(self.at, tolerances)
        estimates = zip(self.faults, best.fit.parameters[count:], best.fit.std[count:], strict=True)
        found = tuple(replace(fault, size=float(size), std=float(std)) for fault, size, std in estimates)
        absolute = law_scope_of(twin.base).channel_units.get(name, "")
        units = [fault.unit(absolute) for fault in found]
        text = ", ".join(fault.text(unit) for fault, unit in zip(found, units, strict=True))
        return Law(
            f"sensor:{name}", text, cast(float, found[0].std), units[0], name, None, self.gain, self.score,
            self.rivals, best.fit.parameters[:count], best.fit.local, (), found,
        )  # fmt: skip


def sensor_fault(
    twin: Twin, at: Linearisation, faults: Sequence[ReadingFault], since_s: float | None = None
) -> FaultFit | None:
    """The fault of a sensor that explains most of what is left of a fit, with a second one of that sensor (its span and
    its zero) where that explains enough by itself.

    Args:
        twin: without it.
        at: converged linearisation of that twin, with its tolerance directions.
        faults: to choose from, with first sizes (`faults_of`).
        since_s: from when on they are there, nearly; the best one's onset is moved until it fits best. None: always.

    Returns:
        None where none is resolved.
    """
    tried = [fault for fault in faults if fault.kind != "lag"]
    tried += [replace(fault, size=size) for fault in faults if fault.kind == "lag" for size in (fault.size, *_LAGS_S)]
    fits = _Fits(twin, at)
    best = fits.add([(fault,) for fault in tried], at.fit)
    if best is None:
        return None
    for reach in () if since_s is None else onset_reaches(twin):
        (fault,) = fits.faults
        fault = replace(fault, size=float(best.fit.parameters[len(twin.parameters)]))
        others = (t for t in times_about(twin, cast(float, fault.since_s), reach) if t != fault.since_s)
        best = cast(Linearisation, fits.add([(replace(fault, since_s=t),) for t in others], best.fit))
    objective, (fault,) = best.fit.objective, fits.faults
    rivals: dict[tuple[str, str], Rival] = {}
    for other, (weaker,) in sorted(fits.tried, key=lambda item: item[0]):
        if other - objective < RIVALS and (weaker.channel, weaker.kind) != (fault.channel, fault.kind):
            rival = Rival(f"sensor:{weaker.channel}", other - objective)
            rivals.setdefault((weaker.kind, weaker.channel), rival)
    readings = int(at.whitening.present.sum())
    charge = float(np.log(readings) + 2.0 * np.log(2.0 * len(twin.channels)))
    found = FaultFit((fault,), best, at.fit.objective - objective, charge, tuple(rivals.values()))
    if found.score < RESOLVED:
        return None
    both = [(fault, replace(fault, kind=kind, size=0.0)) for kind in ("gain", "offset") if kind != fault.kind]
    pairs = _Fits(twin, at)
    joined = pairs.add(both, best.fit)
    # charged as the first one, chosen among two
    needed = float(np.log(readings) + 2.0 * np.log(2.0)) + RESOLVED
    if joined is None or objective - joined.fit.objective < needed:
        return found
    gain = at.fit.objective - joined.fit.objective
    return FaultFit(pairs.faults, joined, gain, charge + needed - RESOLVED, found.rivals)


class _Fits:
    """Fits of a twin with faults of sensors. Of all but the best one the objective is kept: a linearisation holds a
    hundred megabytes of an engine that was learned.

    Attributes:
        tried: objective and faults of each that could be fitted.
        faults: of the best one.
    """

    def __init__(self, twin: Twin, at: Linearisation) -> None:
        self.twin, self.at = twin, at
        self.tried: list[tuple[float, tuple[ReadingFault, ...]]] = []
        self.faults: tuple[ReadingFault, ...] = ()
        self._best: Linearisation | None = None

    def add(self, sets: Iterable[tuple[ReadingFault, ...]], start: Fit) -> Linearisation | None:
        """The best of all so far, after further ones from a fit without or with some like them; None for none."""
        at, P = self.at, len(self.twin.parameters)
        for faults in sets:
            wrong = cast(Twin, ReadingTwin(self.twin, faults))
            begun = Fit(at.fit.candidate, np.append(start.parameters[:P], [fault.size for fault in faults]),
                        at.fit.magnitudes, start.local, np.inf, False)  # fmt: skip
            try:
                fitted = fit_fully(wrong, at.whitening, begun, at.nuisance_response, _ROUNDS)
            except np.linalg.LinAlgError:
                continue
            objective = fitted.fit.objective
            if not np.isfinite(objective) or (faults[0].kind == "lag" and fitted.fit.parameters[P] <= 0.0):
                continue
            self.tried.append((objective, faults))
            if self._best is None or objective < self._best.fit.objective:
                self.faults, self._best = faults, fitted
        return self._best


@dataclass(frozen=True)
class Resolved:
    """A law that is resolved, before its report, which takes as many simulations as its search.

    Attributes:
        score: as `Law.score`.
        report: the law with its intervals; None where the machine runs away with it.
    """

    score: float
    report: Callable[[], Law | None]


def laws_in_turn(
    twin: Twin, at: Linearisation, structure: Sequence[Structure], tolerances: Tolerances | None = None,
    since_s: float | None = None,
) -> Iterator[Resolved]:  # fmt: skip
    """Laws for what no name explains, of a sensor where the linear scores say so, else from the grammar.

    The first is the best of the likely points, a second that of all, where it is another; who is content with the first
    needn't ask for it. None come where none is resolved.

    Args:
        twin: without it.
        at: converged health-only fit, with its tolerance directions.
        structure: scored generic features, strongest first.
        tolerances: directions about a linearisation of a law; None keeps those of `at`.
        since_s: from when on the law acts, as the features were scored [s]; None: always.
    """
    top = structure[0].gain if structure else 0.0
    near = [item for item in structure if item.gain >= _WITHIN * top]
    of_sensors = [item for item in near if item.feature.channel is not None]
    fault = sensor_fault(twin, at, faults_of(of_sensors, twin.channels, since_s), since_s)
    of_fault = None if fault is None else Resolved(fault.score, partial(fault.law, tolerances))
    if len(of_sensors) == len(near) > 0:
        if of_fault is not None:
            yield of_fault
        return
    inside: LawSearch | None = None
    likely = near_the_best(structure, twin)
    before: Refit | FaultFit | None = None
    for screened in (None,) if likely is None else (likely, None):
        best: Refit | FaultFit | None = fault
        found = of_fault
        try:
            inside = inside or LawSearch(twin, at, tolerances, since_s, structure)
            refit = inside.best(screened)
        except np.linalg.LinAlgError:  # with the best law inside the machine runs away: no law of this machine
            refit = None
        if inside is not None and refit is not None and (fault is None or _is_ahead(refit, fault)):
            best, found = refit, Resolved(refit.score, partial(_reported, inside, of_fault))
        if found is None or best is before:
            return
        before = best
        yield found


def _reported(inside: LawSearch, otherwise: Resolved | None) -> Law | None:
    """The search's law, else the fault of a sensor where the machine runs away with it."""
    try:
        return inside.law()
    except np.linalg.LinAlgError:
        return None if otherwise is None else otherwise.report()


def _is_ahead(refit: Refit, fault: FaultFit) -> bool:
    """Whether a law from the grammar explains more than a fault of a sensor, which is as simple as a constant."""
    bent = len(refit.ranked.placed) > 1 or any(placed.form.factors for placed in refit.ranked.placed)
    return refit.score - fault.score >= (RIVALS if bent else 0.0)


def best_law(
    twin: Twin, at: Linearisation, structure: Sequence[Structure], tolerances: Tolerances | None = None,
    since_s: float | None = None,
) -> Law | None:  # fmt: skip
    """The first of `laws_in_turn`."""
    first = next(laws_in_turn(twin, at, structure, tolerances, since_s), None)
    return None if first is None else first.report()


__all__ = ["FaultFit", "best_law", "faults_of", "laws_in_turn", "sensor_fault"]
