"""None of these, at a sensor: a gain, an offset or a lag of a reading, refitted by simulation with all parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.laws.final_fit import Tolerances, about_itself
from dieseltwin.discovery.laws.reading_twin import FaultKind, ReadingFault, ReadingTwin
from dieseltwin.discovery.laws.search import Law, Rival, search
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, fit_fully
from dieseltwin.discovery.twins.interface import Twin, law_scope_of

_WITHIN = 0.5  # of the best linear gain: faults that are refitted
_MOST = 4
_SCREENED = 0.3  # of the best linear gain inside the machine: points with less seldom have the law that comes first
_LEAST_POINTS = 4  # are looked at in any case
_ROUNDS = 8
_RIVALS = 9.0  # 2 delta log-likelihood within which two laws can't be told apart (docs/discovery.md)
_LAGS_S = (0.2, 1.0)  # where a lag's fit begins: at none it has no useful slope
_RESOLVED = 6.0  # score that a fault must reach over no law


def faults_of(structure: Sequence[Structure], channels: Sequence[str]) -> list[ReadingFault]:
    """Faults of sensors worth a refit, by their linear gains: those of a scored `features.generic_features`."""
    sensors = [item for item in structure if item.feature.channel is not None]
    if not sensors:
        return []
    out = []
    for item in sensors[:_MOST]:
        if item.gain >= _WITHIN * sensors[0].gain:
            kind: FaultKind = "gain" if item.feature.text == "gain" else "offset"
            size = item.coefficient  # an offset's is relative to the simulated mean
            if kind == "offset":
                size *= float(np.max(np.abs(item.response)))
            out.append(ReadingFault(channels[cast(int, item.feature.channel)], kind, size))
    return out


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


def sensor_law(
    twin: Twin, at: Linearisation, faults: Sequence[ReadingFault], nuisance_response: np.ndarray | None = None,
    tolerances: Tolerances | None = None,
) -> Law | None:  # fmt: skip
    """The fault of a sensor that explains most of what is left of a fit; lags of sensors that may lag (`LawScope`) too.

    Args:
        twin: without it.
        at: converged linearisation of that twin.
        faults: to choose from, with first sizes (`faults_of`).
        nuisance_response: (K, n, C) tolerance directions, as used for `at`.
        tolerances: directions about the fault found, for its last fit; None keeps those given.

    Returns:
        The law, its std with the tolerances inside; None where none is resolved.
    """
    lagging = [name for name in law_scope_of(twin).lagging_sensors if name in twin.channels]
    tried = [*faults, *(ReadingFault(name, "lag", size) for name in lagging for size in _LAGS_S)]
    fits: list[tuple[float, ReadingFault, Linearisation]] = []
    P = len(twin.parameters)
    for fault in tried:
        wrong = cast(Twin, ReadingTwin(twin, (fault,)))
        start = Fit(at.fit.candidate, np.append(at.fit.parameters[:P], fault.size), at.fit.magnitudes, at.fit.local,
                    np.inf, False)  # fmt: skip
        try:
            fitted = fit_fully(wrong, at.whitening, start, nuisance_response, _ROUNDS)
        except np.linalg.LinAlgError:
            continue
        if np.isfinite(fitted.fit.objective) and (fault.kind != "lag" or fitted.fit.parameters[P] > 0.0):
            fits.append((fitted.fit.objective, fault, fitted))
    if not fits:
        return None
    fits.sort(key=lambda item: item[0])
    readings = int(at.whitening.present.sum())
    charge = float(np.log(readings) + 2.0 * np.log(2.0 * len(twin.channels)))
    objective, fault, best = fits[0]
    gain = at.fit.objective - objective
    if gain - charge < _RESOLVED:
        return None
    best = about_itself(best, tolerances)
    found = replace(fault, size=float(best.fit.parameters[P]), std=float(best.fit.std[P]))
    rivals: dict[tuple[str, str], Rival] = {}
    for other, weaker, _ in fits[1:]:
        if other - objective < _RIVALS and (weaker.channel, weaker.kind) != (fault.channel, fault.kind):
            rival = Rival(f"sensor:{weaker.channel}", other - objective)
            rivals.setdefault((weaker.kind, weaker.channel), rival)
    unit = {"gain": "-", "lag": "s"}.get(fault.kind, law_scope_of(twin).channel_units.get(fault.channel, ""))
    return Law(
        f"sensor:{fault.channel}", found.text(unit), cast(float, found.std), unit, fault.channel, None, gain,
        gain - charge, tuple(rivals.values()), best.fit.parameters[:P], best.fit.local, (), (found,),
    )  # fmt: skip


def best_law(
    twin: Twin, at: Linearisation, structure: Sequence[Structure], tolerances: Tolerances | None = None,
    everywhere: bool = False,
) -> Law | None:  # fmt: skip
    """A law for what no name explains: of a sensor where the linear scores say so, else from the grammar.

    Args:
        twin: without it.
        at: converged health-only fit, with its tolerance directions.
        structure: scored generic features, strongest first.
        tolerances: directions about a linearisation of a law; None keeps those of `at`.
        everywhere: at points, too, whose linear gains are small.
    """
    top = structure[0].gain if structure else 0.0
    near = [item for item in structure if item.gain >= _WITHIN * top]
    of_sensors = [item for item in near if item.feature.channel is not None]
    fault = sensor_law(twin, at, faults_of(of_sensors, twin.channels), at.nuisance_response, tolerances=tolerances)
    if len(of_sensors) == len(near) > 0:
        return fault
    try:
        screened = None if everywhere else near_the_best(structure, twin)
        inside = search(twin, at, at.nuisance_response, tolerances, screened)
    except np.linalg.LinAlgError:  # with the best law inside the machine runs away: no law of this machine
        inside = None
    if inside is None or fault is None:
        return inside or fault
    bent = len(inside.placed) > 1 or any(placed.form.factors for placed in inside.placed)
    ahead = inside.score - fault.score  # a fault of a sensor is as simple as a constant
    return fault if ahead < (_RIVALS if bent else 0.0) else inside


__all__ = ["best_law", "faults_of", "sensor_law"]
