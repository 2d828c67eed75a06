"""The page of the evaluation: the paper's tables beside ours, and its figures, in one self-contained file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from dieseltwin.paper import printed
from dieseltwin.paper.evaluation import words as words
from dieseltwin.paper.evaluation.ensembles import CASES
from dieseltwin.paper.evaluation.figures import over_epochs_figure, ratios_figure
from dieseltwin.report import quantities, style, timeseries, training, violins
from dieseltwin.report.page import Page, Section, Table, kept, marked, write_page
from dieseltwin.report.results import PARAMETERS, Results
from dieseltwin.report.style import ReportFigure
from dieseltwin.settings.methods import find

SIZE_LIMIT_BYTES = 12 * 1024 * 1024
Rows = Sequence[Sequence[str | Markup]]
TITLE = "The paper's tables and figures, and ours beside them"
_WORDS = {printed.MULTI_STAGE: "the paper's multi-stage table", printed.FEW_SHOT: "the paper's few-shot table"}


def build_page(
    tables: Mapping[str, pd.DataFrame],
    results: Mapping[str, Results],
    out: Path,
    *,
    figures_dir: Path | None = None,
    about: Mapping[str, Any] | None = None,
) -> Path:
    """Write the page.

    Args:
        tables: of `tables` by name: scores, beside_paper, cells, run_times, operators, bodies, maps,
            calibration, over_epochs, identifiability; variants of `variants`.
        results: case -> results of all methods on it, for the figures.
        out: the HTML file.
        figures_dir: folder for the figures as files too.
        about: what the page says about where its numbers come from.

    Returns:
        The path.
    """
    notes = dict(about or {})
    page = Page(
        title=TITLE, about=" · ".join(f"{key} {notes[key]}" for key in ("profile", "seed") if key in notes),
        headline=Markup("</p><p>").join(headline(tables["scores"])), alarm=False, sections=sections(tables, results),
        provenance=[(key, str(value)) for key, value in notes.items() if not isinstance(value, Mapping)],
        source="Wahlström and Eriksson (2011). Printed values: Nath, Kumar, Smith, Karniadakis",
        most_bytes=SIZE_LIMIT_BYTES,
    )  # fmt: skip
    return write_page(page, out, figures_dir)


def _table(title: str, heads: Sequence[str], rows: Rows, words: int = 1, dense: bool = False) -> Table:
    """A table from HTML, whose first `words` columns hold words, the others numbers."""
    marked_heads = [Markup(head) for head in heads]
    return Table(marked_heads, rows, words=tuple(range(words)), title=Markup(title), dense=dense)


def sections(tables: Mapping[str, pd.DataFrame], results: Mapping[str, Results]) -> list[Section]:
    """All sections that there is something for."""
    beside, scores = tables["beside_paper"], tables["scores"]
    made = [
        _section("scores", [_scores(scores)] if len(scores) else [], [ratios_figure(beside)] if len(beside) else []),
        *(
            Section(
                f"parameters-{number}", f"Estimates beside {_WORDS[table]}", words=words.SECTIONS["parameters"][1],
                tables=tuple(_beside(part, case) for case, part in whole.groupby("case", sort=False)),
            )
            for number, (table, whole) in enumerate(beside.groupby("table", sort=False))
        ),
        _section("times", [_times(tables["run_times"])] if len(tables["run_times"]) else []),
        _section("learned", _learned(tables)),
        _section("calibration", [_calibration(tables["calibration"])] if len(tables["calibration"]) else []),
        _section("epochs", (), [over_epochs_figure(tables["over_epochs"])] if len(tables["over_epochs"]) else []),
        _section("identifiability", _identifiability(tables["identifiability"])),
        _section("variants", [*_variants(tables["cells"]), *_variant_scores(tables["variants"])]),
    ]  # fmt: skip
    for case, found in results.items():
        figures = [
            violins.violins(found), timeseries.states(found), timeseries.flows(found), timeseries.empirical(found),
            *(training.convergence(found, method) for method in found.methods),
        ]  # fmt: skip
        own = tuple(replace(figure, name=f"{case}-{figure.name}") for figure in kept(*figures))  # cases share names
        made.append(Section(f"figures-{case}", f"Figures, {CASES[case].words}", own))
    return made


def _section(name: str, tables: Sequence[Table], figures: Sequence[ReportFigure] = ()) -> Section:
    title, text = words.SECTIONS[name]
    return Section(name, title, tuple(figures), text, tables=tuple(tables))


def _pm(mean: float, std: float, digits: int = 4) -> str:
    if not math.isfinite(mean):
        return "–"
    return f"{mean:.{digits}f} ± {std:.{digits}f}" if math.isfinite(std) else f"{mean:.{digits}f}"


def _p(value: float) -> str:
    text = "p –" if not math.isfinite(value) else ("p &lt; 0.001" if value < 1e-3 else f"p = {value:.2g}")
    return f"<small>{text}</small>"


def _percent(value: float, digits: int = 1) -> str:
    return f"{100.0 * value:.{digits}f} %" if math.isfinite(value) else "–"


def _label(method: str) -> str:
    return style.method_style(method).label


def _symbols() -> list[str]:
    return [quantities.html_symbol(name) for name in PARAMETERS]


def _scores(table: pd.DataFrame) -> Table:
    heads = ["method", "against", "case", "cells scored", "ours at most the paper's", "RMSE ratio", "95 % interval",
             "worse beyond interval", "members diverged", "cells not scored"]  # fmt: skip
    rows = [
        [_label(r.method), _WORDS[r.table], r.case, str(r.cells),
         marked(_percent(r.better, 0), "better" if r.better >= 0.8 else "worse"), f"{r.ratio:.3g}",
         f"{r.low:.3g} – {r.high:.3g}", str(r.worse_beyond), str(r.diverged), str(r.unscored)]
        for r in table.sort_values("method", key=lambda names: names.map(_place), kind="stable").itertuples()
    ]  # fmt: skip
    return _table("", heads, rows, 3, dense=True)


def _beside(part: pd.DataFrame, case: Any) -> Table:
    rows = []
    for minute, cells in part.groupby("minute", sort=True):
        printed_row = cells.drop_duplicates("parameter").set_index("parameter")
        row = [str(minute), "paper"]
        row += [_pm(printed_row.loc[p, "paper_mean"], printed_row.loc[p, "paper_std"]) for p in PARAMETERS]
        rows.append(row)
        for method, ours in cells.groupby("method", sort=True):
            of = ours.set_index("parameter")
            row = ["", _label(str(method))]
            for p in PARAMETERS:
                r = of.loc[p]
                text = f"{_pm(r['mean'], r['std'])} {_p(r['p'])}"
                text += f", {int(r['diverged'])} diverged" if r["diverged"] else ""
                if r["bound_class"] == "not identifiable":
                    row.append(marked(Markup(f"({text})"), "none"))
                else:
                    row.append(marked(Markup(text), "better" if r["better"] else "worse"))
            rows.append(row)
    return _table(CASES[str(case)].words, ["minute", "", *_symbols()], rows, 2, dense=True)


def _times(table: pd.DataFrame) -> Table:
    heads = ["method", "case", "minutes", "epochs", "s per run", "ms an epoch", "paper's epochs", "paper, s per run",
             "paper, ms an epoch"]  # fmt: skip
    rows = []
    for _, part in table.groupby(["method", "case", "seconds"], sort=False, dropna=False):
        first, last = part.iloc[0], part.iloc[-1]
        minutes = str(first["minute"]).split("-")[0] + "-" + str(last["minute"]).split("-")[1]
        theirs = part["paper"].dropna()
        low, high = (theirs.min(), theirs.max()) if len(theirs) else (math.nan, math.nan)
        paper = "–" if not len(theirs) else (f"{low:.0f}" if low == high else f"{low:.0f} – {high:.0f}")
        rows.append(
            [_label(str(first["method"])), str(first["case"]), minutes, _whole(first["epochs"]),
             f"{first['seconds']:.3g}", _per_epoch(first["seconds"], first["epochs"]),
             _whole(first["paper_epochs"]), paper, _per_epoch(theirs.mean(), first["paper_epochs"])]
        )  # fmt: skip
    return _table("", heads, rows, 3, dense=True)


def _per_epoch(seconds: Any, epochs: Any) -> str:
    known = epochs is not None and math.isfinite(float(epochs)) and math.isfinite(float(seconds))
    return f"{1e3 * seconds / epochs:.2g}" if known else "–"


def _whole(value: Any) -> str:
    return "–" if value is None or not math.isfinite(float(value)) else f"{int(value):,}"


def _learned(tables: Mapping[str, pd.DataFrame]) -> list[Table]:
    made = []
    if tables["operators"]["trainings"].sum():
        rows = [
            [Markup(quantities.html_symbol(r.output)), f"{r.labels} labels", r.recording,
             str(r.trainings), _pm(r.mean, r.std, 3), _pm(r.paper, r.paper_std, 2)]
            for r in tables["operators"].itertuples()
        ]  # fmt: skip
        heads = ["operator's output", "", "recording", "trainings", "ours", "paper"]
        made.append(_table("Actuator operators (DeepONets)", heads, rows, 3))
    if tables["bodies"]["trainings"].sum():
        rows = [
            [Markup(quantities.html_symbol(r.output)), str(r.trainings), _pm(r.mean, r.std, 3),
             _pm(r.paper, r.paper_std, 3)]
            for r in tables["bodies"].itertuples()
        ]  # fmt: skip
        made.append(_table("Multi-head bodies, training", ["output", "trainings", "ours", "paper"], rows))
    if len(tables["maps"]):
        wide = tables["maps"].pivot(index="map", columns="kind", values="test_pct")
        wide = wide[sorted(wide.columns, key=lambda kind: kind != "paper")]
        rows = [
            [Markup(quantities.html_symbol(str(name))), *(f"{value:.3f}" for value in row)]
            for name, row in wide.T.items()
        ]
        kinds = [{"paper": "as printed", "improved": "improved"}.get(str(kind), str(kind)) for kind in wide.columns]
        made.append(_table("Empirical maps on Case-V", ["map", *kinds], rows))
    return made


def _calibration(table: pd.DataFrame) -> Table:
    heads = ["method", "variant", "parameter", "stated by", "intervals", "coverage of 90 %", "mean z", "std of z"]
    rows = [
        [_label(r.method), str(r.variant) if isinstance(r.variant, str) else "",
         Markup(quantities.html_symbol(r.parameter)),
         r.stated_by, str(r.intervals), _percent(r.coverage, 0), _two(r.z_mean),
         _two(r.z_std)]
        for r in table.itertuples()
    ]  # fmt: skip
    return _table("", heads, rows, 4)


def _two(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


def _identifiability(table: pd.DataFrame) -> list[Table]:
    made = []
    for (case, sensors), part in table.groupby(["case", "sensors"], sort=True):
        rows = []
        for minute, cells in part.groupby("minute", sort=True):
            of = cells.set_index("parameter")
            row = [str(minute)]
            for p in PARAMETERS:
                bound = of.loc[p, "bound"]
                text = f"{100 * bound:.3g} %" if math.isfinite(bound) else "no information"
                row.append(marked(text, "none") if of.loc[p, "bound_class"] == "not identifiable" else text)
            rows.append(row)
        names = str(sensors).split(", ")
        read = ", ".join(quantities.html_symbol(name) if "_" in name else name for name in names)
        made.append(_table(f"{CASES[str(case)].words}; sensors: {read}", ["minute", *_symbols()], rows))
    return made


def _variants(table: pd.DataFrame) -> list[Table]:
    rows = []
    noisy = table[(table["case"] == "noisy-301") & (table["bound_class"] != "not identifiable")]
    named = noisy.assign(variant=noisy["variant"].fillna(""))
    changed = set(named.loc[named["variant"] != "", "method"])
    for (method, variant), part in named[named["method"].isin(changed)].groupby(["method", "variant"], sort=True):
        median = part.groupby("parameter")["rmse"].median()
        cells = [_percent(float(median.get(p, math.nan)), 2) for p in PARAMETERS]
        rows.append([_label(str(method)), variant or "as in the tables above", *cells])
    if len(rows) < 2:
        return []
    return [_table("Median over the identifiable minutes, noisy data", ["method", "changed", *_symbols()], rows, 2)]


def _variant_scores(table: pd.DataFrame) -> list[Table]:
    heads = ["method", "changed", "against", "case", "cells scored", "ours at most the paper's", "RMSE ratio"]
    rows = [
        [_label(r.method), r.variant if isinstance(r.variant, str) and r.variant else "as above",
         _WORDS[r.table], r.case, str(r.cells), _percent(r.better, 0), f"{r.ratio:.3g}"]
        for r in table.itertuples()
    ]  # fmt: skip
    return [_table("Against the paper's tables", heads, rows, 4)] if rows else []


def _place(method: str) -> int:
    """The longest first: those are the paper's own."""
    return -find(method).rank


def headline(scores: pd.DataFrame) -> list[str]:
    """The result in words, one line for each method and table, the paper's methods first; noisy data on their own."""
    lines = []
    for method in sorted(scores["method"].unique(), key=_place):
        for table, part in scores[scores["method"] == method].groupby("table", sort=False):
            whole = part[part["case"] == "all"].iloc[0]
            noisy = part[part["case"] == "noisy-301"]
            line = (
                f"{_label(method)} ({find(method).learned}): RMSE at most the paper's in"
                f" {_percent(whole['better'], 0)} of {int(whole['cells'])} cells of {_WORDS[str(table)]}"
            )
            if len(noisy):
                line += f"; on noisy data in {_percent(noisy.iloc[0]['better'], 0)} of {int(noisy.iloc[0]['cells'])}"
            r = noisy.iloc[0] if len(noisy) else whole
            line += f", {r['ratio']:.2g} times the paper's in the geometric mean ({r['low']:.2g} – {r['high']:.2g})"
            lines.append(f"{line}.")
    return lines or ["No ensemble has a counterpart in the paper's tables."]
