"""The page of an identification, of one method or several: numbers, figures and curves in one file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from markupsafe import Markup

from dieseltwin.notes import counted
from dieseltwin.report import captions, charts, quantities, style, timeseries, training, violins
from dieseltwin.report.encoding import Drawn, drawn_here
from dieseltwin.report.interactive import results_series, still
from dieseltwin.report.page import Page, Section, Table, kept_of, marked, swatched
from dieseltwin.report.quantities import EMPTY
from dieseltwin.report.results import PARAMETERS, MethodResult, Results
from dieseltwin.report.statistics import relative_error
from dieseltwin.report.tables import headline, segment_table, summary_table

SOURCE = (
    "Wahlström and Eriksson (2011). Method and comparison numbers: Nath, Kumar, Smith, Karniadakis, “A Digital Twin "
    "for Diesel Engines: Operator-infused Physics-Informed Neural Networks with Transfer Learning for Engine Health "
    "Monitoring”"
)


def identification_sections(results: Results, drawn: Drawn = drawn_here) -> list[Section]:
    """What the page of any identification shows; `drawn` makes the figures of drawings."""
    series, methods = results_series(results), results.methods
    figures = drawn({
        **{f"residuals {k}": partial(timeseries.residual_figure, results, m) for k, m in enumerate(methods)},
        "states": partial(timeseries.states, results), "flows": partial(timeseries.flows, results),
        "empirical": partial(timeseries.empirical, results),
        "readings": lambda: None if series is None else still(series),
        "map": partial(charts.identifiability_map, results), "violins": partial(violins.violins, results),
        "close": partial(violins.violins, results, close=True), "bound": partial(charts.bound_ratio, results),
        **{f"training {k}": partial(training.convergence, results, m) for k, m in enumerate(methods)},
    })  # fmt: skip

    every = range(len(methods))
    return [
        Section("readings-over-time", "Readings over time",
                series=None if series is None else replace(series, drawn=figures["readings"])),
        Section("doubts", "What is doubtful", tables=(_doubts(results),)),
        Section("parameters", "Health parameters", kept_of(figures, "map", "violins", "close"),
                tables=(_segments(results),)),
        Section("accuracy", "Accuracy", kept_of(figures, "bound")),
        Section("states", "States and flows", kept_of(figures, "states", "flows", "empirical")),
        Section("residuals", "Residuals", kept_of(figures, *(f"residuals {k}" for k in every)), captions.RESIDUALS),
        Section("training", "Training", kept_of(figures, *(f"training {k}" for k in every))),
    ]  # fmt: skip


def identification_page(results: Results, sections: Sequence[Section]) -> Page:
    """The page of one method or several.

    Args:
        results: what was identified.
        sections: in their order; empty ones are left out.
    """
    known = results.truth is not None
    reading = captions.SUMMARY.format(ratio=captions.SUMMARY_KNOWN if known else captions.SUMMARY_UNKNOWN)
    given = [Markup(" <b>{}</b>: {}.").format(label, words) for label, words in _given(results)]
    return Page(
        title=str(results.about.get("title") or "Engine health from a recording"), about=_about_line(results),
        headline=Markup(headline(results)), alarm=any(method.misfit for method in results.methods),
        note=Markup("").join([Markup.escape(reading), *given]),
        tables=(_summary(results), *_beside_tolerances(results)), sections=sections,
        provenance=_provenance(results), machine=_machine(results), source=SOURCE,
    )  # fmt: skip


def _label(method: MethodResult) -> Markup:
    look = style.method_style(method.method)
    return swatched(look.label, look.colour)


def _summary(results: Results) -> Table:
    """One row for each method and parameter; columns about the truth and the nominal engine where there is one."""
    known, nominal = results.truth is not None, bool(results.nominal)
    heads = ["method", "parameter", "estimate ± std", "90 % interval"]
    heads += ["truth", "error"] * known + ["against nominal"] * nominal
    heads += ["error over bound" if known else "std over bound", "segments used", "runs", "s per run"]
    rows: list[list[str | Markup]] = []
    table = summary_table(results)
    for method in results.methods:
        first: str | Markup = _label(method) + _stopped(method)
        for row in table[table["method"] == method.method].itertuples():
            scale = quantities.factor(row.parameter)
            digits = quantities.decimals_for(row.std * scale)
            truth = results.true_value(row.parameter)
            name, estimate, interval = _told(row.parameter, row.mean, row.std, row.low, row.high)
            if not row.identifiable:
                estimate, interval = marked("not identifiable here", "none"), EMPTY
            line = [first, name, estimate, interval]
            if known:
                line += [f"{truth * scale:.{digits}f}" if math.isfinite(truth) else EMPTY,
                         quantities.percent(row.error, signed=True)]  # fmt: skip
            if nominal:
                line.append(quantities.percent(row.nominal_change, signed=True))
            line += [quantities.significant(row.ratio_to_bound, 3), f"{row.segments_identifiable} of {row.segments}",
                     str(row.runs), quantities.significant(row.seconds_per_run, 2)]  # fmt: skip
            rows.append(line)
            first = ""
    return Table(heads, rows, words=(0, 1), grouped=True)


def _doubts(results: Results) -> Table:
    """Every warning of the methods, once."""
    told = {str(doubt["text"]): doubt for method in results.methods for doubt in method.warnings}
    rows = [(str(doubt["code"]), text, ", ".join(doubt["affects"]) or EMPTY) for text, doubt in told.items()]
    return Table(("kind", "what", "about"), rows, words=(0, 1, 2), long=(1,))


def _told(parameter: str, mean: float, std: float, low: float, high: float) -> list[str | Markup]:
    """Cells of a parameter with its unit, its estimate and its interval."""
    scale, unit = quantities.factor(parameter), quantities.unit(parameter)
    digits = quantities.decimals_for(std * scale)
    return [Markup(quantities.html_symbol(parameter)) + f" [{unit}]" * bool(unit),
            quantities.value_with_std(parameter, mean, std, with_unit=False),
            f"{low * scale:.{digits}f} – {high * scale:.{digits}f}" if math.isfinite(low + high) else EMPTY]


def _beside_tolerances(results: Results) -> list[Table]:
    """Health parameters of the fit beside tolerances, where one was made; it is the same whatever the method."""
    told = next((method.with_tolerances for method in results.methods if method.with_tolerances), {})
    if not told:
        return []
    known = results.truth is not None
    learned = any(estimate.since_reference is not None for estimate in told.values())
    rows: list[list[str | Markup]] = []
    for name, estimate in told.items():
        line = _told(name, estimate.mean, estimate.std, *estimate.interval_90)
        if learned:
            since = estimate.since_reference
            line.append(EMPTY if since is None else since.text.replace("-", "−"))
        if known:
            line.append(quantities.percent(relative_error(estimate.mean, results.true_value(name)), signed=True))
        rows.append(line)
    heads = ["parameter", "estimate ± std", "90 % interval", *["since the reference"] * learned, *["error"] * known]
    return [Table(heads, rows, title="Beside tolerances of maps and sensors", about=captions.BESIDE_TOLERANCES)]


def _stopped(method: MethodResult) -> Markup:
    """How many runs of a method did not converge."""
    count, runs = method.number_not_converged, method.number_of_runs * len(method.segments)
    if not count:
        return Markup("")
    words = f"none of {runs} runs converged" if count == runs else f"{count} of {runs} runs not converged"
    return Markup("<br>") + marked(words, "stopped")


def _segments(results: Results) -> Table:
    """Every estimate of every segment."""
    table = segment_table(results)
    rows: list[list[str | Markup]] = []
    for method in results.methods:
        first: str | Markup = _label(method)
        for _, part in table[table["method"] == method.method].groupby("t0_s", sort=True):
            line: list[str | Markup] = [first, part["segment"].iloc[0]]
            for parameter in PARAMETERS:
                row = part[part["parameter"] == parameter].iloc[0]
                bound = row["relative_bound"]
                if row["identifiable"]:
                    error = f" ({quantities.percent(row['error'], signed=True)})" * math.isfinite(row["error"])
                    text = quantities.value_with_std(parameter, row["mean"], row["std"], with_unit=False)
                    line.append(text + error)
                else:
                    size = f" (bound {100 * bound:.0f} %)" if math.isfinite(bound) else ""
                    line.append(marked(f"not identifiable here{size}", "none"))
            rows.append(line)
            first = ""
    heads = [Markup(f"{quantities.html_symbol(p)} [{quantities.unit(p)}]") for p in PARAMETERS]
    return Table(["method", "segment [min]", *heads], rows, grouped=True, folded="Every segment in numbers")


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
                f"{counted(method.number_of_runs, 'run')} on each of {counted(len(method.segments), 'segment')}"
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
