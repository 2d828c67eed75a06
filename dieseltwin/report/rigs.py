"""The page of a discovery on a machine that is no engine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.document import NONE_OF_THESE, Discrepancy, FoundEffect
from dieseltwin.discovery.verdict.reasons import candidate_rows
from dieseltwin.discovery.verdict.when import moments, when_words
from dieseltwin.report import findings
from dieseltwin.report.discovery_words import magnitude_words
from dieseltwin.report.interactive import Line, Mark, Panel, Series, repair_panels, still
from dieseltwin.report.law_cards import Told, law_cards
from dieseltwin.report.page import Page, Section, Table
from dieseltwin.report.quantities import EMPTY
from dieseltwin.report.style import AFTER, BEFORE, MEASURED
from dieseltwin.rigs.equations import equations
from dieseltwin.rigs.expressions import names_in
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.rounds import RigDiscovery
from dieseltwin.rigs.simulate import simulate_rig
from dieseltwin.rigs.verdict import LEFT, shares, unseen

SIMULATED = ("simulated, as the file is", "simulated, repaired")
HELD_OUT = ("The last part in free runs of machines that were fitted to what comes before: nothing of it was seen by a "
            "fit. A finding stays if it foretells this part no worse than a machine without it.")
COLOURS = "Orange: the machine as the file has it, fitted; blue: repaired."
VISIBLE = "The smallest size of each effect that this recording could show; a smaller one can be there unseen."


def units_of(rig: RigParameters) -> dict[str, str]:
    """Name of an input, state, parameter, effect or quantity -> unit; of a reading that of what its formula names."""
    known = {**rig.inputs, **{n: s.unit for n, s in rig.states.items()},
             **{n: p.unit for n, p in rig.parameters.items()}, **{n: q.unit for n, q in rig.quantities.items()},
             **{n: e.unit for n, e in rig.effects.items()}}  # fmt: skip
    for name, formula in rig.readings.items():
        named = {known[used] for used in names_in(formula) if used in known}
        known[name] = named.pop() if len(named) == 1 else "-"
    return {name: "" if unit == "-" else unit for name, unit in known.items()}


def free_runs(first: RigParameters, second: RigParameters | None, recording: RigRecording) -> tuple[Panel, ...]:
    """Readings beside free runs of two machines, and their errors: two panels a reading.

    Args:
        first: as the file is.
        second: repaired; None where nothing was found.
        recording: what they run over.
    """
    units, readings = units_of(first), {n: v for n, v in recording.readings.items() if np.isfinite(v).any()}
    runs = [simulate_rig(rig, recording) for rig in (first, second) if rig is not None]
    shown: list[list[Array]] = [[run[name].to_numpy(dtype=np.float64) for name in readings] for run in runs]
    measured = list(readings.values())
    panels = repair_panels(recording.time_s, list(readings), measured, shown[0] if second is not None else None,
                           shown[-1], SIMULATED, [units[name] for name in readings])  # fmt: skip
    errors = tuple(
        Panel(f"{name}, reading less simulated", units[name], recording.time_s, tuple(
            Line(label, colour, measured[j] - run[j])
            for label, colour, run in zip(("as the file is", "repaired"), (BEFORE, AFTER), shown, strict=False)))
        for j, name in enumerate(readings)
    )  # fmt: skip
    return (*panels, *errors)


def _held_out(found: RigDiscovery) -> Section:
    """Free runs over the part that no fit has seen, and their errors round by round."""
    judged = [item for item in found.taken if item.early is not None]
    series = None
    if judged and found.early is not None:
        series = Series(free_runs(found.early, judged[-1].early, found.recording.part(found.checked)))
        series = replace(series, drawn=still(series, ("held_out", "Free runs that no fit has seen", COLOURS)))
    channels = list(found.repaired.readings)
    table: list[tuple[str | Markup, ...]] = []
    for number, item in enumerate(found.rounds, 1):
        if not item.before.size:
            continue
        what = ", ".join(item.names) or (NONE_OF_THESE if item.law is None else f"{NONE_OF_THESE}: {item.law.text}")
        errors = "; ".join(f"{c} {b:.3g} → {a:.3g}" for c, b, a in zip(channels, item.before, item.after, strict=True)
                           if not np.isnan(b))  # absent there
        table.append((str(number), what, errors, "kept" if item.taken else "left out again"))
    heads = ("round", "finding", "error of free runs without → with it (rms)", "verdict")
    return Section("held-out", "Held-out proof", words=HELD_OUT, series=series,
                   tables=(Table(heads, table, words=(0, 1, 2, 3), long=(1,)),))  # fmt: skip


def told(rig: RigParameters, effect: FoundEffect) -> Told | None:
    """What a rig's file says of an effect of its own: its words, and the formulae that it enters."""
    entry = rig.effects.get(effect.name)
    if entry is None or effect.magnitude is None:
        return None
    laws = equations(rig, effect.name)
    units = units_of(rig)
    names = dict.fromkeys(name for law in laws for name in _names(law) if name in units)
    symbols = tuple((name, f"[{units[name] or EMPTY}]") for name in names)
    unit = findings.as_it_is(effect.name, effect.unit)
    size = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit, extra=False, shown=unit)
    about = f"In the file's words: {entry.law}."
    return Told(f"{effect.name.replace('_', ' ')} of {size}", about, entry.site, laws, effect.name, size, symbols)


def _names(law: str) -> list[str]:
    return "".join(c if c.isalnum() or c == "_" else " " for c in law).split()


def rig_page(found: RigDiscovery, document: Discrepancy, words: str) -> Page:
    """What the page says.

    Args:
        found: the rounds and both machines.
        document, words: the verdict.
    """
    recording, rig = found.recording, found.repaired
    units, first = units_of(rig), found.rounds[0].found
    since = ""
    if found.begun and document.location is not None:
        since = f"Each as it would be {when_words(document.location)}."
    seconds = float(recording.time_s[-1] - recording.time_s[0])
    checked = recording.time_s[found.checked]
    judged = Mark("the part that judged each finding, fitted to what comes before", float(checked[0]),
                  float(checked[-1]))  # fmt: skip
    marks = (*(Mark(name, at) for name, at in moments(document.location)), judged) if document.mismatch else ()
    inputs = tuple(Panel(name, units[name], recording.time_s, (Line("input", MEASURED, values),))
                   for name, values in recording.inputs.items())
    over_time = Series((*free_runs(found.before, rig if document.mismatch else None, recording), *inputs), marks=marks)
    hidden = unseen(found).replace("not seen", "Not seen", 1)
    sections = (
        Section("readings-over-time", "Readings over time", series=replace(over_time, drawn=still(over_time))),
        _held_out(found),
        Section("doubts", "What is doubtful", tables=(findings.doubts(document),)),
        Section("weighed", "Candidates", words=since,
                tables=(findings.weighed(candidate_rows(first), units, findings.as_it_is),)),
        Section("visible", "What could be seen", words=" ".join(filter(None, (VISIBLE, hidden and f"{hidden}."))),
                tables=(findings.visible(document, units, findings.as_it_is),)),
    )  # fmt: skip
    return Page(
        title=findings.heading(document),
        about=f"{rig.name} · recording: {Path(recording.path).name} · {seconds:.4g} s · {len(rig.readings)} reading"
        f"{'' if len(rig.readings) == 1 else 's'}",
        headline=escape(words), alarm=document.mismatch or any(doubt.code == LEFT for doubt in document.warnings),
        findings=findings.findings(document, shares(found), findings.as_it_is, found.begun),
        cards=law_cards(document, lambda effect: told(rig, effect)),
        tables=(findings.places(document), findings.levels(document, "parameter", units),
                findings.fit(document, units)),
        sections=sections, provenance=findings.provenance(document),
        source=rig.source or f"the file of {rig.name}",
    )  # fmt: skip
