"""The self-contained HTML report: one page, everything embedded, nothing loaded from anywhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dieseltwin.atomic import write_text
from dieseltwin.report import captions, charts, interactive, quantities, style, timeseries, training, violins
from dieseltwin.report.encoding import encode_all
from dieseltwin.report.interactive import results_series
from dieseltwin.report.page import shown_figure, templates
from dieseltwin.report.results import PARAMETERS, Results
from dieseltwin.report.style import ReportFigure
from dieseltwin.report.tables import headline, segment_table, summary_table

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Section:
    """One section of the page: its anchor, heading, a sentence, its figures and finished pictures, and its tables."""

    id: str
    title: str
    words: str
    figures: tuple[ReportFigure, ...]
    pictures: tuple[Mapping[str, str], ...] = ()
    table: Mapping[str, Any] | None = field(default=None)
    beside_paper: Mapping[str, Any] | None = field(default=None)


def kept(*figures: ReportFigure | None) -> tuple[ReportFigure, ...]:
    """Those that there is data for."""
    return tuple(figure for figure in figures if figure is not None)


def sections(results: Results) -> list[Section]:
    """What the page of any identification shows; :func:`page` leaves out what has nothing to show."""
    residuals = kept(*(timeseries.residual_figure(results, m) for m in results.methods))
    return [
        Section("summary", "Summary", "", ()),
        Section(
            "parameters",
            "Health parameters",
            "",
            kept(
                charts.identifiability_map(results),
                violins.violins(results),
                violins.violins(results, close=True),
            ),
            table=_segment_rows(results),
        ),
        Section("accuracy", "Accuracy", "", kept(charts.bound_ratio(results))),
        Section(
            "states",
            "States and flows",
            "",
            kept(timeseries.states(results), timeseries.flows(results), timeseries.empirical(results)),
        ),
        Section("residuals", "Residuals", captions.RESIDUALS, residuals),
        Section(
            "training", "Training", "", kept(*(training.convergence(results, m) for m in results.methods))
        ),
    ]


def _summary_rows(results: Results) -> Rows:
    groups: Rows = []
    table = summary_table(results)
    for method in results.methods:
        look = style.method_style(method.method)
        rows = []
        for row in table[table["method"] == method.method].itertuples():
            scale, unit = quantities.factor(row.parameter), quantities.unit(row.parameter)
            digits = quantities.decimals_for(row.std * scale)
            truth = results.true_value(row.parameter)
            interval = f"{row.low * scale:.{digits}f} – {row.high * scale:.{digits}f}"
            rows.append(
                {
                    "symbol": quantities.html_symbol(row.parameter),
                    "unit": unit,
                    "identifiable": row.identifiable,
                    "estimate": quantities.value_with_std(row.parameter, row.mean, row.std, with_unit=False),
                    "interval": interval if math.isfinite(row.low + row.high) else "–",
                    "truth": f"{truth * scale:.{digits}f}" if math.isfinite(truth) else "–",
                    "error": quantities.percent(row.error, signed=True),
                    "change": quantities.percent(row.nominal_change, signed=True),
                    "ratio": quantities.significant(row.ratio_to_bound, 3),
                    "used": f"{row.segments_identifiable} of {row.segments}",
                    "runs": str(row.runs),
                    "seconds": quantities.significant(row.seconds_per_run, 2),
                }
            )
        stopped = _stopped(method.number_not_converged, method.number_of_runs * len(method.segments))
        groups.append({"label": look.label, "colour": look.colour, "rows": rows, "stopped": stopped})
    return groups


def _stopped(not_converged: int, runs: int) -> str:
    if not not_converged:
        return ""
    return (
        f"none of {runs} runs converged"
        if not_converged == runs
        else f"{not_converged} of {runs} runs not converged"
    )


def _segment_rows(results: Results) -> dict[str, Any]:
    table = segment_table(results)
    groups: Rows = []
    for method in results.methods:
        look = style.method_style(method.method)
        rows = []
        chosen = table[table["method"] == method.method]
        for _, part in chosen.groupby("t0_s", sort=True):
            cells = []
            for parameter in PARAMETERS:
                row = part[part["parameter"] == parameter].iloc[0]
                text = quantities.value_with_std(parameter, row["mean"], row["std"], with_unit=False)
                if not row["identifiable"]:
                    bound = row["relative_bound"]
                    size = f" (bound {100 * bound:.0f} %)" if math.isfinite(bound) else ""
                    text = f"not identifiable here{size}"
                elif math.isfinite(row["error"]):
                    text += f" ({quantities.percent(row['error'], signed=True)})"
                cells.append({"text": text, "none": not row["identifiable"]})
            rows.append({"segment": part["segment"].iloc[0], "cells": cells})
        groups.append({"label": look.label, "colour": look.colour, "rows": rows})
    heads = [f"{quantities.html_symbol(p)} [{quantities.unit(p)}]" for p in PARAMETERS]
    return {"heads": heads, "groups": groups}


def _given(results: Results) -> list[tuple[str, str]]:
    """What each method was given (exact formulae or learned maps, ..), as report.json says under "methods"."""
    words = results.about.get("methods") or {}
    labels = {m.method: style.method_style(m.method).label for m in results.methods}
    return [(labels[name], _plain(text)) for name, text in words.items() if name in labels]


def _provenance(results: Results) -> list[tuple[str, str]]:
    about = results.about
    names = {
        "recording": "recording",
        "sha256": "SHA-256 of the recording",
        "profile": "profile",
        "seed": "seed",
        "params_sha256": "SHA-256 of the parameters",
        "code_version": "code version",
        "git": "revision",
        "engine": "engine",
        "noise": "noise",
        "maps": "empirical maps",
        "commands": "commands",
    }
    found = [
        (words, _plain(about[key]))
        for key, words in names.items()
        if about.get(key) not in (None, "", [], {})
    ]
    for method in results.methods:
        label = style.method_style(method.method).label
        found.append(
            (
                label,
                f"{method.number_of_runs} runs on each of {len(method.segments)} segments"
                + "".join(f", {key} {_plain(value)}" for key, value in method.settings.items()),
            )
        )
    return found


def _machine(results: Results) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    seen: set[str] = set()
    for method in results.methods:
        runtime = method.runtime
        label = style.method_style(method.method).label
        if runtime.get("seconds") is not None:
            found.append((f"{label}, wall time", f"{quantities.significant(float(runtime['seconds']), 3)} s"))
        for key in ("host", "platform", "cpus", "versions", "machine", "finished"):
            value = runtime.get(key)
            if value in (None, "", {}):
                continue
            text = _plain(value)
            if f"{key}={text}" in seen:
                continue
            seen.add(f"{key}={text}")
            found.append((f"{key}, {label}" if key == "finished" else key, text))
    return found


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items() if item is not None)
    if isinstance(value, list | tuple):
        return "; ".join(_plain(item) for item in value)
    return str(value)


def _about_line(results: Results) -> str:
    about = results.about
    parts = [
        f"Recording: {about['recording']}" if about.get("recording") else "",
        f"{len(results.segments)} segments",
    ]
    parts.append("simulated, truth known" if results.truth is not None else "truth not known")
    parts.append(f"profile {about['profile']}" if about.get("profile") else "")
    return " · ".join(part for part in parts if part)


def page(results: Results, chosen: Sequence[Section], encode: Callable[[ReportFigure], bytes]) -> str:
    """The whole page as text, without the sections that have nothing to show.

    Args:
        results: of one method or several.
        chosen: sections in their order.
        encode: a figure's file.
    """
    known = results.truth is not None
    series = results_series(results)
    whole = None if series is None else series.still
    note = captions.SUMMARY_KNOWN if known else captions.SUMMARY_UNKNOWN
    return templates().get_template("report.html.j2").render(
        series=series,
        script="" if series is None else interactive.script(),
        look="" if series is None else interactive.look(),
        still=None if whole is None else shown_figure(whole, encode(whole)),
        title=str(results.about.get("title") or "Engine health from a recording"),
        about=_about_line(results),
        headline=headline(results),
        summary_note=captions.SUMMARY.format(ratio=note),
        given=_given(results),
        known_truth=known,
        known_nominal=bool(results.nominal),
        ratio_title="error over bound" if known else "std over bound",
        summary=_summary_rows(results),
        sections=[
            {
                "id": s.id,
                "title": s.title,
                "words": s.words,
                "table": s.table,
                "beside_paper": s.beside_paper,
                "figures": [*s.pictures, *(shown_figure(f, encode(f)) for f in s.figures)],
            }
            for s in chosen
            if s.id == "summary" or s.figures or s.pictures
        ],
        provenance=_provenance(results),
        machine=_machine(results),
    )


def identification_page(results: Results, out_html: str | Path, figures_dir: str | Path) -> list[Path]:
    """Write the page of one identification and its figures as files, each drawn once; returns the figures' paths."""
    chosen = sections(results)
    encoded = encode_all([figure for section in chosen for figure in section.figures])
    paths: list[Path] = []

    def encode(figure: ReportFigure) -> bytes:
        content = encoded.get(figure.name) or figure.encode()
        paths.append(figure.save(figures_dir, content))
        return content

    write_text(Path(out_html), page(results, chosen, encode))
    return paths
