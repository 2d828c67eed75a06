"""Figures and the page of a discovery on a petrol engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import median_filter

from dieseltwin.discovery.verdict.document import Discrepancy, FoundEffect
from dieseltwin.discovery.verdict.when import moments
from dieseltwin.engine.courses import course
from dieseltwin.petrol.calibrate import SubmodelFit
from dieseltwin.petrol.discover import PetrolDiscovery
from dieseltwin.petrol.effects import HYPOTHESES
from dieseltwin.petrol.parameters import FaultFreePiece
from dieseltwin.report import findings, quantities, style
from dieseltwin.report.discovery_words import display_unit, magnitude_words
from dieseltwin.report.interactive import Line, Mark, Panel, Series, over, still
from dieseltwin.report.law_cards import Told, law_cards
from dieseltwin.report.page import Page, Section, Table
from dieseltwin.report.style import AFTER, BEFORE, ReportFigure

LIMIT = "#000000"
TITLES = {"cylinder": "cylinder balance: air flow against η_vol(ω_e, p_im)",
          "throttle": "throttle balance: air flow against A(α)", "boost": "boost: p_ic against p_amb at rest"}
SHOWN = ("cylinder", "throttle", "boost")
CLIP = 0.25  # of a residual in the figures [-]
SMOOTH_BLOCKS = 15  # running median: structure, not tip-ins
PALE = {BEFORE: "#f2c4a5", AFTER: "#a9cce3"}
DRAWN = "Seconds as points (cut at 25 %), running median over 15 s as lines."
OVER_TIME = {True: "Misfit of the balances against the calibrated maps: as read, and with the explanation and the "
                   f"levels fitted beside it taken back. {DRAWN}",
             False: f"Misfit of the balances against the calibrated maps, as read. {DRAWN}"}  # fmt: skip
OVER_PRESSURE = {True: "Seconds in which it acts over p_im. A gain shifts evenly, a leak most at low load.",
                 False: "All seconds over p_im. A gain would shift evenly, a leak most at low load."}
COLOURS = {True: "Orange: as read; blue: repaired.", False: "Blue: as read."}
"""What a figure shows, with a mismatch and without."""
VISIBLE = ("Smallest size that this recording shows, had the effect begun after a tenth of it. What was there from the "
           "first row on has to be larger: the recording's own levels take some of it up.")  # fmt: skip
MEANINGS = {
    "throttle_offset": "The throttle stands elsewhere than its position says, everywhere by as much.",
    "throttle_gain": "The throttle opens by another share of what its position says.",
    "_gain": "The sensor shows its quantity times a factor.",
    "_offset": "The sensor shows its quantity plus a constant.",
    "_leak": "A hole through which gas flows as through a nozzle.",
    "volumetric_efficiency_change": "The cylinders take another share of the charge than when they were calibrated.",
    "throttle_area_change": "The throttle's area is another share of that of the calibration, as by deposits.",
}  # fmt: skip
"""Ending of the name of a petrol engine's effect -> what it means."""
MOST_SHOWN = 8  # effects in the figure of what was weighed


def _misfits(found: PetrolDiscovery, name: str) -> tuple[np.ndarray, list[tuple[np.ndarray, str, str]]]:
    """Blocks that count, and a balance's misfit there as read and, where something was found, with it taken back."""
    twin = found.twin
    j = twin.channels.index(name)
    kept = np.isfinite(twin.measured[:, j])
    repaired = twin.measured[:, j] - found.after[:, j]
    states = [(twin.measured[:, j], BEFORE if found.document.mismatch else AFTER, "as read")]
    if found.document.mismatch:
        states.append((repaired, AFTER, "repaired"))
    return kept, [(np.clip(values[kept], -CLIP, CLIP), colour, label) for values, colour, label in states]


def _acts(found: PetrolDiscovery, stamps: np.ndarray) -> np.ndarray:
    """Whether the effect acts at time stamps [s], as the document says it; everywhere without one."""
    location = found.document.location
    times = (None, None) if location is None else (location.onset_s, location.until_s)
    return np.asarray(course(stamps, *times) > 0.0)


def balances_over_time(found: PetrolDiscovery) -> Series:
    """Each balance over time, before and after what was found is taken back; points are seconds, lines a running
    median."""
    panels = []
    for name in (name for name in SHOWN if name in found.twin.channels):
        kept, states = _misfits(found, name)
        lines = [Line(f"{label}, each second", PALE[colour], 100.0 * values, dots=True)
                 for values, colour, label in states]
        if kept.sum() > SMOOTH_BLOCKS:
            lines += [Line(label, colour, 100.0 * median_filter(values, SMOOTH_BLOCKS, mode="mirror"))
                      for values, colour, label in states]
        stamps = found.time0_s + found.twin.time_s[kept]
        panels.append(Panel(f"misfit of the {TITLES[name]}", "%", stamps, tuple(lines)))
    series = Series(tuple(panels), marks=tuple(Mark(name, at) for name, at in moments(found.document.location)))
    words = COLOURS[found.document.mismatch]
    dashed = " Dashed: the onset, and the end where it went again." if series.marks else ""
    told = ("residuals_over_time", "Misfit of the balances", words + dashed)
    return replace(series, drawn=still(series, told))


@style.styled
def candidates(found: PetrolDiscovery) -> ReportFigure:
    """Gain of the leading effects, with the threshold."""
    rows = found.candidates[:MOST_SHOWN][::-1]
    figure = Figure(figsize=(8.0, 0.45 * len(rows) + 1.3))
    axes = figure.subplots()
    names = {e.name for e in found.document.effects}
    for row, c in enumerate(rows):
        gain = max(c["log_likelihood_gain"] or 0.0, 0.0)
        axes.barh(row, gain, color=BEFORE if c["name"] in names else style.MEASURED)
        axes.annotate(_size(c["magnitude"] or 0.0, found.twin.hypotheses[c["name"]].unit), (gain, row), xytext=(4, 0),
                      textcoords="offset points", va="center", fontsize=9)
    axes.axvline(0.5 * found.threshold, color=LIMIT, ls="--", lw=1.0)
    axes.set_yticks(range(len(rows)), [c["name"] for c in rows])
    axes.margins(x=0.15)
    axes.set_xlabel("log-likelihood gained [–]; dashed: alarm of an effect that is there all along")
    caption = "The leading effects, each refitted by itself, with its onset where it has one."
    return ReportFigure("candidates", "What was weighed", caption, figure)


def _size(value: float, unit: str) -> str:
    return f"{100 * value:+.1f} %" if unit == "-" else f"{value:.3g} {unit}"


def over_pressure(found: PetrolDiscovery) -> Series:
    """Cylinder and throttle balance over the manifold pressure: gain, leak and offset have other shapes."""
    panels = []
    for name in (name for name in ("cylinder", "throttle") if name in found.twin.channels):
        kept, states = _misfits(found, name)
        late = _acts(found, found.time0_s + found.twin.time_s[kept])
        lines = [Line(label, colour, 100.0 * values[late], dots=True) for values, colour, label in states]
        x = 1e-3 * found.twin.blocks.p_im[kept][late]
        panels.append(over(f"misfit of the {name} balance", "%", ("p_im", "kPa"), x, lines))
    series = Series(tuple(panels), linked=False)
    told = ("over_pressure", "Misfit over the manifold pressure", COLOURS[found.document.mismatch])
    return replace(series, drawn=still(series, told))


def told(effect: FoundEffect) -> Told | None:
    """What is known of an effect of a petrol engine."""
    if effect.magnitude is None or effect.law is None:
        return None
    size = magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit, extra=False,
                           shown=display_unit("", effect.unit))  # fmt: skip
    site = HYPOTHESES[effect.name].site if effect.name in HYPOTHESES else ""
    about = next((words for ending, words in MEANINGS.items() if effect.name.endswith(ending)), "")
    symbol = next((s for s in ("A", "k", "g", "b") if s in effect.law.replace("(", " ").replace(")", " ").split()), "")
    return Told(f"{effect.name.replace('_', ' ')} of {size}", about, site, (effect.law,), symbol, size)


def petrol_page(found: PetrolDiscovery) -> Page:
    """What the page says."""
    said = found.document
    units = {name: known.unit for name, known in found.twin.hypotheses.items()}
    sections = (
        Section("readings-over-time", "The balances over time", words=OVER_TIME[said.mismatch],
                series=balances_over_time(found)),
        Section("law-of-it", "Over the operating range", words=OVER_PRESSURE[said.mismatch],
                series=over_pressure(found)),
        Section("doubts", "What is doubtful", tables=(findings.doubts(said),)),
        Section("weighed", "Candidates", (candidates(found),), tables=(findings.weighed(found.candidates, units),)),
        Section("visible", "What could be seen", words=VISIBLE, tables=(findings.visible(said, units),)),
    )
    return Page(
        title=findings.heading(said), about=f"{found.engine.name} · recording: {Path(said.recording.path).name} · "
        f"{said.recording.duration_s:.0f} s · {len(said.recording.channels)} sensors",
        headline=quantities.with_symbols(found.sentence), alarm=said.mismatch,
        findings=findings.findings(said), cards=law_cards(said, told),
        tables=(findings.places(said), findings.levels(said, "level against the calibration", shift=False), _fit(said)),
        sections=sections, provenance=findings.provenance(said), source=found.engine.source,
    )  # fmt: skip


def _fit(said: Discrepancy) -> Table:
    """The first two rows: rms residuals of the balances are relative, and drawn."""
    whole = findings.fit(said)
    return replace(whole, rows=whole.rows[:2])



@style.styled
def fault_free_pieces(pieces: Sequence[FaultFreePiece]) -> ReportFigure:
    """Gain of the strongest effect in each fault-free piece at its time; alarms in another colour."""
    figure = Figure(figsize=(9.0, 2.8))
    panel = figure.subplots()
    for piece in pieces:
        panel.plot([piece.start_s / 60.0, piece.end_s / 60.0], [piece.gain, piece.gain],
                   color=BEFORE if piece.alarm else AFTER, lw=2.5)  # fmt: skip
        panel.text(piece.start_s / 60.0, piece.gain, piece.name, va="bottom", fontsize=8)
    panel.set_xlabel("time [min]")
    panel.set_ylabel("gain [–]")
    caption = "Gain of the strongest effect in each fault-free piece, with maps that did not see it."
    return ReportFigure("pieces", "Fault-free pieces", caption, figure)


def false_alarms(pieces: Sequence[FaultFreePiece], unjudged: int) -> str:
    """How many fault-free pieces raise an alarm, and how many couldn't be judged, in words."""
    if unjudged and not pieces:
        return f"false alarms aren't known, as none of {unjudged} fault-free pieces could be judged"
    told = f"{sum(p.alarm for p in pieces)} false alarms on {len(pieces)} fault-free pieces"
    return f"{told}; {unjudged} more couldn't be judged" if unjudged else told


def calibration_lines(
    fits: Sequence[SubmodelFit], pieces: Sequence[FaultFreePiece], unjudged: int
) -> list[str]:
    """Fit of each balance on held-out stretches, and the verdicts on held-out fault-free pieces, as lines of text."""
    lines = [f"{'balance':<10}{'steady':>9}{'all':>9}   held-out misfit (robust standard deviation)"]
    for f in fits:
        lines.append(f"{f.name:<10}{100 * f.steady:>7.2f} %{100 * f.all_blocks:>7.2f} %   {f.blocks} blocks of 1 s")
    lines += [f"fault-free piece {p.start_s:.0f}-{p.end_s:.0f} s: {'ALARM' if p.alarm else 'quiet'}, strongest "
              f"{p.name} with a gain of {p.gain:.1f}" for p in pieces]
    return [*lines, f"judged with maps that did not see them: {false_alarms(pieces, unjudged)}"]
