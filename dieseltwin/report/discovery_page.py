"""The page of a discovery on recordings of a diesel engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.notes import OF_THE_FIT
from dieseltwin.report import discovery_figures, discovery_residuals, findings, over_recordings, quantities
from dieseltwin.report.discovery_words import sentence, unit_of
from dieseltwin.report.encoding import Drawing, Drawn, drawn_here, drawn_in_two
from dieseltwin.report.interactive import discovery_series, still
from dieseltwin.report.law_cards import law_cards
from dieseltwin.report.page import Page, Section, kept_of, write_page
from dieseltwin.report.style import ReportFigure


def of_curves(found: Discovery) -> dict[str, Drawing]:
    """Drawings of the curves: what `discover` goes on to work out, health and sizes, changes nothing in them."""
    return {
        "residual_map": partial(discovery_residuals.residual_map, found),
        "residual_map_actuators": partial(discovery_residuals.residual_map, found, discovery_figures.MAPS[1]),
        "readings": lambda: still(discovery_series(found)),
        "residual_time": partial(discovery_residuals.residual_time, found),
        "visible": partial(discovery_figures.minimum_detectable, found),
        "candidates": partial(discovery_figures.candidates, found),
        "evidence_maps": partial(discovery_figures.evidence_maps, found),
        "score": partial(discovery_figures.score, found),
        "evidence_time": partial(discovery_figures.evidence_time, found),
    }  # fmt: skip


def discovery_sections(found: Discovery, drawn: Drawn = drawn_here) -> list[Section]:
    """The page's sections with all figures that `found` has data for; `drawn` makes the figures of drawings."""
    curves, series = found.curves, discovery_series(found)
    figures = drawn({
        **of_curves(found), "health": partial(discovery_figures.health, found),
        "law": partial(discovery_figures.law_curves, found), "trends": partial(over_recordings.trends, found),
    })  # fmt: skip

    units = {row["name"]: curves.units.get(row["name"]) or unit_of(row["name"]) or "" for row in curves.candidates}
    sections = [
        Section("readings-over-time", "Readings over time", series=replace(series, pictured=figures["readings"])),
        Section("doubts", "What is doubtful", tables=(findings.doubts(found.document),)),
        Section("over-recordings", "The recordings", kept_of(figures, "trends"),
                tables=over_recordings.tables(found)),
        Section("health-parameters", "Health parameters", kept_of(figures, "health")),
        Section("law-of-it", "Law", kept_of(figures, "law")),
        Section("evidence", "Evidence", kept_of(figures, "evidence_time", "evidence_maps")),
        Section("residuals", "Residuals", kept_of(figures, "residual_time", "residual_map", "residual_map_actuators")),
        Section("held-out", "Held-out score", kept_of(figures, "score")),
        Section("weighed", "Candidates", kept_of(figures, "candidates"),
                tables=(findings.weighed(curves.candidates, units),)),
        Section("visible", "What could be seen", kept_of(figures, "visible")),
    ]  # fmt: skip
    return [section for section in sections if not section.empty]


def caution(document: Discrepancy) -> str:
    """What is doubtful about the fit, to stand above the findings; empty where nothing is."""
    said = [doubt.text[:1].upper() + doubt.text[1:] for doubt in document.warnings if doubt.code in OF_THE_FIT]
    return "" if not said else ". ".join([*said, "Look at the residual maps before you believe what is found."])


def _page(found: Discovery, drawn: Drawn) -> Page:
    document = found.document
    recording = document.recording
    return Page(
        title=findings.heading(document),
        about=f"Recording: {Path(recording.path).name} · {recording.duration_s:.0f} s · {len(recording.channels)} "
        "sensors",
        headline=quantities.with_symbols(sentence(document)), alarm=document.mismatch,
        caution=quantities.with_symbols(caution(document)),
        findings=findings.findings(document), cards=law_cards(document),
        tables=(findings.places(document), findings.levels(document, "health parameter"), findings.fit(document)),
        sections=discovery_sections(found, drawn), provenance=findings.provenance(document),
    )  # fmt: skip


def build_discovery_report(
    found: Discovery, out_html: str | Path, *, figures_dir: str | Path | None = None,
    ahead: Mapping[str, ReportFigure | None] | None = None,
) -> Path:  # fmt: skip
    """Write the page atomically, and its figures as files beside it.

    Args:
        found: what `discover` returned.
        out_html: the page; its folder is made where missing.
        figures_dir: where to save the figures as SVG too; None for the page alone.
        ahead: those of `of_curves` that are drawn already.

    Returns:
        The path of the page.
    """
    there = dict(ahead or {})

    def drawn(drawings: Mapping[str, Drawing]) -> Mapping[str, ReportFigure | None]:
        return {**there, **drawn_in_two({name: drawings[name] for name in drawings if name not in there})}

    return write_page(_page(found, drawn), out_html, figures_dir)
