"""Why a name was or wasn't chosen, and what would split names that can't be told apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.search.state import Search, occam
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.discovery.verdict.curves import Candidate
from dieseltwin.sensors import SENSORS

_ENOUGH = 9.0  # squared distance that splits two names


def candidate_rows(found: Search) -> list[Candidate]:
    """Every effect that was weighed, strongest first, with the reason of its fate."""
    P = len(found.twin.parameters)
    chosen = set(found.best.fit.candidate.names) if found.best is not None and found.kind != "law" else set()
    equivalent = {name for names in found.equivalent for name in names} - chosen if found.kind != "healthy" else set()
    rows: list[Candidate] = []
    fitted: dict[str, Fit] = {fit.candidate.names[0]: fit for fit in found.singles}
    top = max(map(found.gain, found.singles[:1]), default=0.0)
    confined = _confined(found)
    fitted |= {name: fit for name, (_, fit) in confined.items()}
    if found.kind == "variant":
        top = max(top, found.explained())
    if found.standing and found.best is not None:
        fitted[found.best.fit.candidate.names[0]] = found.best.fit
    evidence = {name: occam(found, fit) for name, fit in fitted.items()}
    total = np.logaddexp.reduce(list(evidence.values())) if evidence else 0.0
    linear = {item.name: item for item in sorted(found.scored, key=lambda s: s.gain)}
    for name, hypothesis in found.twin.hypotheses.items():
        fit = fitted.get(name)
        if name in found.settings.withhold or (fit is None and name not in linear):
            continue
        gain = found.gain(fit) if fit is not None else linear[name].gain if name in linear else 0.0
        magnitude = float(fit.magnitudes[0]) if fit is not None else linear[name].magnitude
        std = float(fit.std[P]) if fit is not None else linear[name].std
        rows.append(
            Candidate(
                name=name, site=hypothesis.site, log_likelihood_gain=float(0.5 * gain), magnitude=magnitude,
                std=std if np.isfinite(std) else None, tolerance=hypothesis.tolerance,
                probability=float(np.exp(evidence[name] - total)) if fit is not None else None,
                reason=_reason(found, name, gain, magnitude, top, chosen, equivalent)
                + (f", {_where(confined[name][0])}" if name in confined else ""),
            )
        )
    return sorted(rows, key=lambda row: -(row["log_likelihood_gain"] or 0.0))


def _confined(found: Search) -> dict[str, tuple[Variant, Fit]]:
    """Effects with their best variants, where such a one is the explanation: the chosen one's own, and those that gain
    more than their effect does that is of one size everywhere and always."""
    if found.kind != "variant" or found.variant is None:
        return {}
    alone = {fit.candidate.names[0]: found.gain(fit) for fit in found.singles}
    best: dict[str, tuple[Variant, Fit]] = {}
    for variant, fit in sorted(found.variants, key=lambda pair: pair[0] is not found.variant):  # it comes first
        if variant is found.variant or found.gain(fit) > alone.get(variant.name, 0.0):
            best.setdefault(variant.name, (variant, fit))
    return best


def _where(variant: Variant) -> str:
    if variant.profile is not None:
        return "of another size in some recordings than in others"
    return "acting in a part of the driving" if variant.region is not None else "acting at some times"


def _reason(
    found: Search, name: str, gain: float, magnitude: float, top: float, chosen: set[str], equivalent: set[str]
) -> str:
    hypothesis = found.twin.hypotheses[name]
    size = abs(magnitude) / hypothesis.tolerance
    half = 0.5 * gain if abs(gain) >= 0.1 else 0.0  # never "-0.0"
    if name in chosen:
        return f"chosen: it raises the log-likelihood by {half:.1f} at {size:.2g} times its size of interest"
    if name in equivalent:
        return f"can't be told from the chosen one: only {0.5 * (top - gain):.1f} less in log-likelihood"
    if found.standing:
        return f"log-likelihood gain {half:.1f} beside the valve that stands still"
    if found.kind == "healthy":
        threshold = 0.5 * found.gain_of_alarm
        if half < threshold:
            return f"log-likelihood gain {half:.1f}, below the alarm at {threshold:.1f}"
        return f"gain {half:.1f}, but only {size:.2g} times its size of interest"
    if found.kind == "law":
        best = 0.5 * found.everything_unnamed()[0].gain
        return f"log-likelihood gain {half:.1f}, against {best:.1f} by a term without a name"
    best_kind = "one" if found.kind == "variant" else "single effect"
    return f"log-likelihood gain {half:.1f}, {0.5 * (top - gain):.1f} less than the best {best_kind}"


def split_by(found: Search, name: str, others: Sequence[str]) -> str:
    """What would tell `name` from the first of the others: a sensor that isn't used, or longer driving."""
    fits = {fit.candidate.names: fit for fit in [*found.singles, *found.pairs]}
    mine = next((fit for key, fit in fits.items() if name in key), None)
    rival = next((fit for key, fit in fits.items() if others[0] in key and name not in key), None)
    if mine is not None and rival is not None:
        worth = _worth_of_sensors(found.twin, mine, rival)
        best = max(worth, key=lambda column: worth[column], default="")
        if best and worth[best] > 4.0 * _ENOUGH:
            return f"a {best} sensor"
        behind = abs(rival.objective - mine.objective)
        if behind > 0.5:
            return f"driving {max(2.0, _ENOUGH / behind):.0f} times as long, or with more contrast between loads"
    return "nothing that this driving measures; a test with other loads at the same speeds"


def _worth_of_sensors(twin: Twin, mine: Fit, rival: Fit) -> dict[str, float]:
    """Column of a sensor that isn't used -> squared distance between two fits in its readings [noise]."""
    missing = [(j, sensor) for j, sensor in enumerate(SENSORS) if sensor.column not in twin.channels]
    a, b = (twin.simulate_all(fit.lanes()) if missing else None for fit in (mine, rival))
    if a is None or b is None:
        return {}
    sigma = {j: sensor.noise * np.mean(np.abs(a[0, :, j])) for j, sensor in missing}
    return {s.column: float((((a[0, :, j] - b[0, :, j]) / sigma[j]) ** 2).sum()) for j, s in missing}
