"""What was found on a rig, as the documents that every machine has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.score import Scored, best_of_each, minimum_detectable, without_parameters
from dieseltwin.discovery.twins.interface import Array, single
from dieseltwin.discovery.verdict.assemble import details_of_search, finite_only, p_value
from dieseltwin.discovery.verdict.document import (
    NONE_OF_THESE,
    Discrepancy,
    Fit,
    FoundEffect,
    Location,
    Provenance,
    RecordingInfo,
    fit_doubts,
    with_warnings,
)
from dieseltwin.discovery.verdict.explain import plain
from dieseltwin.discovery.verdict.findings import (
    effects,
    none_of_these,
    ranked_location,
    site_probabilities,
    valid_for,
)
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.discovery.verdict.when import when_words
from dieseltwin.notes import Note, listing
from dieseltwin.rigs.fitting import rms_left, times_noise
from dieseltwin.rigs.rounds import LOUD, RigDiscovery, Round
from dieseltwin.rigs.simulate import step_error
from dieseltwin.rigs.twin import RigTwin
from dieseltwin.version import __version__

MORE = "more is missing; no law foretells it"
"""What is said where no name and no law is left."""
LONG_STEPS = "long_steps"
UNEXPLAINED = "wrong_engine"
HOLD = "hold"
LEFT = "residuals"
SENSORS = "no_sensor_site"
TAKEN_UP = 0.03  # of what an effect does to the readings, that parameters leave where they say the same
MOVED = 0.2  # of the parameter that moves farthest
LEFT_BY_HOLD = 0.8  # of the error (rms); another way between rows leaves less than that where it is the right one
LEAST_EXPLAINED = 0.5  # of a reading's variance; the tanks without what they lack explain 0.95


def document(result: RigDiscovery) -> Discrepancy:
    """`discrepancy.json` of a rig: what was found in the order of finding, the first with its onset."""
    recording, first = result.recording, result.rounds[0]
    entries = _effects(result)
    before, after = result.before.parameters, result.repaired.parameters
    made = Discrepancy(
        schema=1,  # type: ignore[call-arg]  # the alias of schema_version
        recording=RecordingInfo(path=recording.path, sha256=recording.sha256,
                                duration_s=float(recording.time_s[-1] - recording.time_s[0]),
                                channels=tuple(recording.readings)),
        mismatch=bool(entries), p_value=_p_value(first) if entries else 1.0,
        location=_location(result, first) if entries else None,
        effects=entries, more_is_missing=result.more_is_missing,
        health={name: HealthValue(value=p.value, std=p.std, before=before[name].value) for name, p in after.items()},
        fit=_fit(result),
        minimum_detectable=finite_only(minimum_detectable(first.found.scored, first.found.settings.alarm_gain)),
        provenance=Provenance(code_version=__version__, params_sha256=result.options.sha256),
    )  # fmt: skip
    own = (*_unexplained(result, made.fit), *_left_notes(result), *_step_notes(result), *_hold_notes(result),
           *_sensor_notes(result))  # fmt: skip
    doubts = [*fit_doubts(made), *own, *recording.notes]
    return with_warnings(made, doubts)


def _p_value(first: Round) -> float:
    """Probability that chance alone gives as much as the first finding."""
    if first.law is not None and first.when is not None:  # its search is of names that begin then
        return float(np.clip(first.found.chance.p_value(first.law.gain), 0.0, 1.0))
    return p_value(first.found)


def _unexplained(result: RigDiscovery, fit: Fit) -> list[Note]:
    """Readings of which the machine explains less than half: what is missing in it has nothing to stand out from."""
    notes = []
    for name, values in result.recording.readings.items():
        off, spread = fit.rmse_after[name], float(np.nanstd(values))
        if off > max(LEAST_EXPLAINED**0.5 * spread, result.repaired.floors.get(name, 0.0)):
            text = (f"{name} is off by {off:.3g} (rms) where it varies by {spread:.3g}: fitted as it may be, this "
                    "machine explains less than half of it; check units, columns and its file's values")  # fmt: skip
            notes.append(Note(text, UNEXPLAINED, [name]))
    return notes


def _judged(result: RigDiscovery) -> list[Round]:
    """Rounds that were taken by free runs."""
    return [item for item in result.taken if item.after.size]


def _left_notes(result: RigDiscovery) -> list[Note]:
    """Readings of which the machine leaves several times the noise: in free runs with what was found, as what is named
    may be part of what is missing; in its fit where nothing was found, as that is no proof of health."""
    judged = _judged(result)
    if result.more_is_missing:
        return []
    at = result.fit_after
    left = judged[-1].after if judged else rms_left(at)
    missed = [(name, f"{off:.3g} (rms), {times:.2g} times its noise")
              for name, off, times in zip(at.twin.channels, left, times_noise(at, left), strict=True) if times > LOUD]
    if not judged:
        return [Note(f"the fit misses {name} by {by}", LEFT, [name]) for name, by in missed]
    return [Note(f"free runs of the repaired machine miss {name} by {by}: what is found isn't all that is missing, or "
                 "stands for something that the file has no name for", LEFT, [name]) for name, by in missed]


def _step_notes(result: RigDiscovery) -> list[Note]:
    """Whether the error of the integration is large enough to raise an alarm by itself."""
    at = result.fit_after
    twin: RigTwin = at.twin  # type: ignore[assignment]
    error = step_error(twin, single(at.fit.parameters, at.fit.local))
    weights = np.nansum((error / twin.misfit) ** 2, axis=0)  # of gains, whose fourth root goes with the step
    if not (whole := float(weights.sum())) > result.options.search.alarm_gain:
        return []
    worst = int(np.argmax(weights))
    name, change = twin.channels[worst], float(np.nanmax(np.abs(error[:, worst])))
    steps = int(np.ceil(twin.rig.sub_steps * whole**0.25))
    text = (f"steps of the integration are too long to judge by: halved, they change {name} by up to {change:.2g}, and "
            f"what is found may be theirs; give sub_steps: {steps} in place of {twin.rig.sub_steps}")  # fmt: skip
    return [Note(text, LONG_STEPS, [name])]


def unseen(result: RigDiscovery) -> str:
    """Effects that the machine's own parameters say as well: what was there from the first row on is taken for those,
    as far as they may be other than believed. Empty where there is none; a tank that never overflows is none of these.
    """
    first = result.rounds[0].found
    smallest = minimum_detectable(first.scored, first.settings.alarm_gain)
    taken = {name for item in result.taken for name in item.names}
    told = []
    for item in best_of_each(first.scored):
        effect, size = first.twin.hypotheses[item.name], smallest[item.name]
        by = _said_by(first.null, item) if size > effect.tolerance and item.name not in taken else []
        if by:
            seen = f"below {size:.2g} {effect.unit}".removesuffix(" -")
            whole = size > max(map(abs, effect.limits))
            told.append(f"{item.name} {'of any size' if whole else seen} ({', '.join(by)})")
    return "" if not told else (
        "not seen, as other values of the machine's own parameters do the same from the first row on: "
        f"{listing(told)}; a smaller prior_std, where more is known of these, or another reading tells"
    )  # fmt: skip


def _said_by(at: Linearisation, item: Scored) -> list[str]:
    """Parameters that say the same as an effect, those first that must move farthest for it; none where readings tell
    the difference, or where it does nothing."""
    raw = at.metric.project(item.response[None])
    size, left, rows = float(np.linalg.norm(raw)), without_parameters(at, raw)[0], raw.shape[1]
    if not size or float(np.linalg.norm(left[:rows])) > TAKEN_UP * size:
        return []
    moved = np.abs(left[rows : rows + len(at.twin.parameters)])  # in deviations of what is believed
    return [at.twin.parameters[k].name for k in np.argsort(-moved) if moved[k] > MOVED * moved.max()]


def _sensor_notes(result: RigDiscovery) -> list[Note]:
    """Readings for whose sensors the file has no place, where a law was found: an offset of one that began was "0.4 N
    more", which shows the same."""
    if all(item.law is None for item in result.taken):
        return []
    rig = result.repaired
    places = {*(effect.site for effect in rig.effects.values()), *(q.site for q in rig.quantities.values())}
    missing = [name for name in rig.readings if f"sensor:{name}" not in places]
    if not missing:
        return []
    text = (f"the file has no place for what a sensor does wrong ({listing(missing)}), so that a reading that is off "
            "may be a law elsewhere that shows the same; give it a quantity or an effect with such a site "
            f"(sensor:{missing[0]})")  # fmt: skip
    return [Note(text, SENSORS, missing)]


def _hold_notes(result: RigDiscovery) -> list[Note]:
    """Whether the machine fits better with its inputs taken otherwise between rows: every law would follow that."""
    if result.fit_otherwise is None:
        return []
    left, otherwise = rms_left(result.fit_before), rms_left(result.fit_otherwise)
    share = float(np.mean(otherwise / np.maximum(left, np.finfo(float).tiny)))
    if not share < LEFT_BY_HOLD:
        return []
    twin: RigTwin = result.fit_otherwise.twin  # type: ignore[assignment]
    other = twin.rig.hold
    text = (f"with its inputs {other} between rows, not {result.before.hold}, the machine of this file leaves "
            f"{100.0 * share:.0f} % of the error (rms) before anything is found; if the recorder works so, give "
            f"hold: {other}: what is found may be the difference")  # fmt: skip
    return [Note(text, HOLD, list(result.recording.readings))]


def shares(result: RigDiscovery) -> list[tuple[tuple[str, ...], float]]:
    """Names of each round that was taken, and the share of the squared error of free runs that no fit has seen which it
    takes away [-]."""
    judged = _judged(result)
    return [((NONE_OF_THESE,) if item.law is not None else item.names,
             float(np.nanmean((item.before**2 - item.after**2) / judged[0].before**2))) for item in judged]


def _effects(result: RigDiscovery) -> tuple[FoundEffect, ...]:
    sizes = {term.effect: term for term in result.repaired.terms}
    entries: list[FoundEffect] = []
    for item in result.taken:
        if item.law is not None:
            entries.append(none_of_these(item.law.text, valid_for(item.found)))
            continue
        told = {e.name: e for e in effects(item.found)} if item.found.best is not None else {}
        for name in item.names:
            term, known = sizes[name], item.found.twin.hypotheses[name]
            own = told.get(name)
            entries.append(FoundEffect(
                name=name, probability=1.0 if own is None else own.probability,
                equivalent_names=() if own is None else own.equivalent_names, law=known.law, magnitude=term.magnitude,
                std=term.std, unit=known.unit, valid_for=valid_for(item.found),
                split_by=None if own is None else own.split_by,
            ))  # fmt: skip
    if result.more_is_missing and not any(e.name == NONE_OF_THESE for e in entries):
        entries.append(none_of_these(MORE, valid_for(result.rounds[-1].found)))
    return tuple(entries)


def _location(result: RigDiscovery, first: Round) -> Location:
    """Where the first finding sits, with its rivals, and when it is so."""
    if first.law is not None:
        return Location(site=first.law.site, probability=1.0, onset_s=first.law.since_s)
    if first.found.probabilities:
        weights = site_probabilities(first.found)
    elif first.names:
        weights = {first.found.twin.hypotheses[first.names[0]].site: 1.0}
    else:
        weights = {first.found.structure[0].feature.site: 1.0}
    when = result.when
    if when is None:
        return ranked_location(weights)
    onset_s = when.onset_s if when.onset_s > result.recording.time_s[0] else None
    return ranked_location(weights, onset_s=onset_s, until_s=when.until_s, grows=when.grown_s is not None)


def _fit(result: RigDiscovery) -> Fit:
    """Errors in the windows of the fit, in the misfit of the repaired machine; the likelihood of free runs that no fit
    has seen is that of an unknown variance, from the first round's to the last round's that was taken."""
    scale = result.fit_after.twin.misfit  # type: ignore[attr-defined]
    before, after = rms_left(result.fit_before), rms_left(result.fit_after)
    names = result.fit_before.twin.channels
    judged = _judged(result)
    return Fit(
        held_out_nll_before=_nll(judged[0].before) if judged else None,
        held_out_nll_after=_nll(judged[-1].after) if judged else None,
        chi2_per_sample_before=float(np.mean((before / scale) ** 2)),
        chi2_per_sample_after=float(np.mean((after / scale) ** 2)),
        rmse_before=dict(zip(names, map(float, before), strict=True)),
        rmse_after=dict(zip(names, map(float, after), strict=True)),
        share_explained=_whole(judged),
    )  # fmt: skip


def _whole(judged: Sequence[Round]) -> float | None:
    """Share of the squared error of free runs that all rounds together take away [-]."""
    if not judged:
        return None
    return float(np.clip(1.0 - np.nanmean((judged[-1].after / judged[0].before) ** 2), 0.0, 1.0))


def _nll(error: Array) -> float:
    """Negative log-likelihood per sample of Gaussian errors whose root mean squares (C,) are those found, NaN for a
    reading that is absent."""
    return float(np.nansum(np.log(error) + 0.5 * np.log(2.0 * np.pi) + 0.5))


def sentence(result: RigDiscovery, found: Discrepancy) -> str:
    """The verdict in words."""
    name = result.repaired.name
    if not found.mismatch or found.location is None:
        unexplained = [doubt.text for doubt in found.warnings if doubt.code == UNEXPLAINED]
        if unexplained:
            return f"Nothing can be said of {name}: {'; '.join(unexplained)}."
        missed = [doubt.text for doubt in found.warnings if doubt.code == LEFT]
        if missed:
            return (f"Nothing was found that {name} leaves out and that has a name or a law, but {listing(missed)}: "
                    "something is missing, or moves within the recording.")
        left = ", ".join(_measured(result, column, f"{rmse:.3g}") for column, rmse in found.fit.rmse_after.items())
        return f"No mismatch of {name} beyond what its recording can tell; its fit leaves {left} (rms)."
    told = []
    for e in found.effects:
        when = f" {when_words(found.location)}" if e.name in result.begun else ""
        if e.magnitude is None:
            if e.law != MORE:
                told.append(f"none of the known effects: {e.law}{when}")
            continue
        apart = f", not told from {', '.join(e.equivalent_names)}" if e.equivalent_names else ""
        size = f"{e.magnitude:.4g}{'' if e.std is None else f' ± {e.std:.2g}'} {e.unit}"
        told.append(f"{e.name} {size} ({e.law}){when}{apart}")
    judged = _judged(result)
    if any(e.law == MORE for e in found.effects):
        told.append(f"beside {'these' if len(told) > 1 else 'this'} {MORE}" if told else MORE)
    text = f"{name}, first at {found.location.site}: {'; '.join(told)}."
    if judged:
        errors = zip(result.fit_before.twin.channels, judged[0].before, judged[-1].after, strict=True)
        shown = (_measured(result, c, f"{b:.3g} -> {a:.3g}") for c, b, a in errors if not np.isnan(b))
        text += f" Free runs no fit has seen, rms: {', '.join(shown)}"
        percent = round(100.0 * (found.fit.share_explained or 0.0))
        text += (f", {percent} % of the squared error explained." if percent
                 else ": what was found fits better where it was fitted, and foretells these no better.")
    return text


def _measured(result: RigDiscovery, column: str, numbers: str) -> str:
    """Numbers of a reading with its name and its unit, that of the state that it shows."""
    units = {state.nearest: state.unit for state in result.repaired.states.values()}
    return f"{column} {numbers} {units.get(column, '')}".removesuffix(" -").rstrip()


def details(result: RigDiscovery, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Content of `details.json`, from which `--explain` answers: the first round's candidates, and every round."""
    first = result.rounds[0].found
    rows = candidate_rows(first)
    for row in rows:
        for number, item in enumerate(result.rounds, 1):
            if row["name"] in item.names:
                fate = "foretells no worse" if item.taken else "left out again: free runs get worse with it"
                row["reason"] = f"chosen in round {number}; {fate}"
    return plain({  # type: ignore[no-any-return]
        "recording_sha256": result.recording.sha256, "options": dict(asked), "notes": [], "laws": [],
        **details_of_search(first, rows, first.best),
        "minimum_detectable": finite_only(minimum_detectable(first.scored, first.settings.alarm_gain)),
        "rounds": [
            {"names": list(item.names), "law": None if item.law is None else item.law.text, "taken": item.taken,
             **({} if item.when is None else {key: at for key, at in vars(item.when).items() if at is not None}),
             "run_error_before": item.before, "run_error_after": item.after, "kind": item.found.kind}
            for item in result.rounds
        ],
    })  # fmt: skip
