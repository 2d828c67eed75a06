"""Why a name was or wasn't chosen, and what would split names that can't be told apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.search.run import Search, occam
from dieseltwin.discovery.verdict.curves import Candidate
from dieseltwin.sensors import SENSORS

_ENOUGH = 9.0  # squared distance that splits two names


def candidate_rows(found: Search) -> list[Candidate]:
    """Every effect that was weighed, strongest first, with the reason of its fate."""
    P = len(found.twin.parameters)
    chosen = set(found.best.fit.candidate.names) if found.best is not None and found.kind != "law" else set()
    equivalent = {name for names in found.equivalent for name in names} - chosen
    top = found.gain(found.singles[0]) if found.singles else 0.0
    rows: list[Candidate] = []
    fitted: dict[str, Fit] = {fit.candidate.names[0]: fit for fit in found.singles}
    evidence = {name: occam(found, fit) for name, fit in fitted.items()}
    total = np.logaddexp.reduce(list(evidence.values())) if evidence else 0.0
    linear = {item.name: item for item in sorted(found.scored, key=lambda s: s.gain)}
    for name, hypothesis in found.twin.hypotheses.items():
        if name in found.settings.withhold:
            continue
        fit = fitted.get(name)
        gain = found.gain(fit) if fit is not None else linear[name].gain if name in linear else 0.0
        magnitude = float(fit.magnitudes[0]) if fit is not None else linear[name].magnitude
        std = float(fit.std[P]) if fit is not None else linear[name].std
        rows.append(
            Candidate(
                name=name, site=hypothesis.site, log_likelihood_gain=float(0.5 * gain), magnitude=magnitude,
                std=std if np.isfinite(std) else None, tolerance=hypothesis.tolerance,
                probability=float(np.exp(evidence[name] - total)) if fit is not None else None,
                reason=_reason(found, name, gain, magnitude, top, chosen, equivalent),
            )
        )
    return sorted(rows, key=lambda row: -(row["log_likelihood_gain"] or 0.0))


def _reason(
    found: Search, name: str, gain: float, magnitude: float, top: float, chosen: set[str], equivalent: set[str]
) -> str:
    hypothesis = found.twin.hypotheses[name]
    size = abs(magnitude) / hypothesis.tolerance
    half = 0.5 * gain
    if name in chosen:
        return f"chosen: it raises the log-likelihood by {half:.1f} at {size:.2g} times its size of interest"
    if name in equivalent:
        return f"can't be told from the chosen one: only {0.5 * (top - gain):.1f} less in log-likelihood"
    if found.kind == "healthy":
        threshold = 0.5 * max(found.settings.alarm_gain, found.chance.threshold(found.settings.alarm_level))
        if half < threshold:
            return f"log-likelihood gain {half:.1f}, below the alarm at {threshold:.1f}"
        return f"gain {half:.1f}, but only {size:.2g} times its size of interest"
    if found.kind == "law":
        best = 0.5 * found.structure[0].gain
        return f"log-likelihood gain {half:.1f}, against {best:.1f} by a term without a name"
    return f"log-likelihood gain {half:.1f}, {0.5 * (top - gain):.1f} less than the best single effect"


def split_by(found: Search, name: str, others: Sequence[str]) -> str:
    """What would tell `name` from the first of the others: a sensor that isn't used, or longer driving."""
    fits = {fit.candidate.names: fit for fit in [*found.singles, *found.pairs]}
    mine = next((fit for key, fit in fits.items() if name in key), None)
    rival = next((fit for key, fit in fits.items() if others[0] in key and name not in key), None)
    twin = found.twin
    missing = [(j, s) for j, s in enumerate(SENSORS) if s.column not in twin.channels]
    all_readings = getattr(twin, "simulate_all", None)
    if mine is not None and rival is not None and missing and all_readings is not None:
        a, b = all_readings(mine.lanes())[0], all_readings(rival.lanes())[0]
        worth = {}
        for j, sensor in missing:
            sigma = sensor.noise * float(np.mean(np.abs(a[:, j])))
            worth[sensor.column] = float((((a[:, j] - b[:, j]) / sigma) ** 2).sum())
        best = max(worth, key=lambda column: worth[column])
        if worth[best] > 4.0 * _ENOUGH:
            return f"a {best} sensor"
    behind = None if mine is None or rival is None else abs(rival.objective - mine.objective)
    if behind is not None and behind > 0.5:
        return f"driving {max(2.0, _ENOUGH / behind):.0f} times as long, or with more contrast between loads"
    return "nothing that this driving measures; a test with other loads at the same speeds"
