"""What one identification of the field engine is set beside: the paper's printed run times and few-shot table."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dieseltwin.paper import printed
from dieseltwin.paper.cells import cell_rmse
from dieseltwin.paper.evaluation.ensembles import diverged
from dieseltwin.report import captions, quantities, style
from dieseltwin.report.page import Table, marked, swatched
from dieseltwin.report.results import PARAMETERS, MethodResult, Results
from dieseltwin.report.segment_axis import WIDTH_IN

RUN_TIMES = captions.line("""
    Wall seconds per run (one start on one 60 s segment): total wall time of the batch divided by its runs. One step of
    the grid is a factor of ten. Grey: the paper's printed times for noisy data, 301 points, one core of another
    computer; they are shown for scale, not as a race on equal terms.
""")

BESIDE_PAPER = captions.line("""
    Error of each cell in % of the truth, sqrt((mean − truth)² + std²) over the runs that did not diverge; paper:
    few-shot table, noisy data, 301 points, its own driving and starts near the truth. Cells in brackets are not
    identifiable here and not scored.
""")


@style.styled
def run_times(results: Results) -> style.ReportFigure:
    """Seconds per run of each method on a logarithmic axis, beside the paper's printed times."""
    rows: list[tuple[str, float, str, str]] = []
    for method in results.methods:
        look = style.method_style(method.method)
        seconds = method.seconds_per_run
        if not math.isfinite(seconds) or seconds <= 0:
            continue
        count = method.number_of_runs * len(method.segments)
        rows.append((look.label, seconds, look.colour, f"{seconds:.3g} s per run, {count} runs"))
    theirs = [(f"paper: {name}", s, style.PAPER, f"{s:.0f} s per run") for name, s in printed.mean_seconds().items()]
    figure = Figure(figsize=(WIDTH_IN, 0.5 * (len(rows) + len(theirs)) + 1.4))
    axes = figure.subplots()
    everything = rows + theirs
    start = min([seconds for _, seconds, _, _ in everything], default=1.0) / 4
    for place, (_, seconds, colour, text) in enumerate(everything):
        axes.plot([start, seconds], [place, place], color=colour, linewidth=7, solid_capstyle="butt")
        axes.text(seconds * 1.12, place, text, va="center", fontsize=9.5)
    axes.set_yticks(range(len(everything)), [name for name, *_ in everything])
    axes.set_ylim(len(everything) - 0.5, -0.5)
    axes.set_xscale("log")
    axes.set_xlim(start, 15 * max([seconds for _, seconds, _, _ in everything], default=1.0))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("wall time per run of one 60 s segment [s], logarithmic")
    axes.set_ylabel("method")
    axes.grid(False, axis="y")
    axes.legend(
        handles=[
            Patch(color="#555555", label="this computer"),
            Patch(color=style.PAPER, label="paper (other computer, printed)"),
        ],
        loc="upper right",
    )
    return style.ReportFigure("run_times", "Run times", RUN_TIMES, figure)


def paper_table(results: Results) -> pd.DataFrame:
    """Root-mean-square error of each cell beside the paper's noisy few-shot table, in units of the truth.

    A cell is one parameter in one minute, its error `cells.cell_rmse` over the runs that did not diverge.
    Columns: minute, parameter, paper, one per method, identifiable (by every method). Empty without truth or where
    the segments are not the paper's five minutes.
    """
    rows: list[dict[str, object]] = []
    cells = printed.PARAMETER_TABLES[printed.FEW_SHOT]["noisy-301"]
    minutes = [minute.replace("-", "–") for minute in printed.MINUTES]  # as results write them
    for minute, row_of in zip(minutes, cells, strict=True):
        for (mean, std), parameter in zip(row_of, PARAMETERS, strict=True):
            truth = results.true_value(parameter)
            places = [
                next((i for i, s in enumerate(m.segments) if s.minutes == minute), None)
                for m in results.methods
            ]
            if not math.isfinite(truth) or all(place is None for place in places):
                continue
            row: dict[str, object] = {
                "minute": minute,
                "parameter": parameter,
                "paper": math.hypot(mean - 1, std),
            }
            flags = []
            for method, place in zip(results.methods, places, strict=True):
                if place is None:
                    continue
                row[method.method] = cell_rmse(_ratios(results, method, place)[parameter].to_numpy())
                flags.append(method.segments[place].parameters[parameter].identifiable)
            rows.append({**row, "identifiable": all(flags)})
    return pd.DataFrame(rows)


def _ratios(results: Results, method: MethodResult, segment: int) -> pd.DataFrame:
    """Estimate over truth [-] of one segment's runs that did not diverge, a row a run, a column a parameter.

    Runs that did not converge count: the paper's tables have no such choice. Without runs the segment's own estimate.
    """
    truth = np.array([results.true_value(name) for name in PARAMETERS])
    own = method.segments[segment].parameters
    runs = method.runs[method.runs["segment"] == segment]
    if runs.empty:
        return pd.DataFrame([[own[name].mean for name in PARAMETERS] / truth], columns=PARAMETERS)
    values = runs.pivot(index="run", columns="parameter", values="value")[list(PARAMETERS)]
    bound = np.array([0.0 if own[name].identifiable else np.inf for name in PARAMETERS])
    return values[~diverged(values.to_numpy(dtype=float), truth, bound)] / truth


def paper_rows(results: Results) -> tuple[Table, ...]:
    """The cells beside the paper's table, as text; nothing where there is nothing to compare."""
    table = paper_table(results)
    if table.empty:
        return ()
    methods = [m.method for m in results.methods if m.method in table]
    rows: list[list[str | Markup]] = []
    for minute, part in table.groupby("minute", sort=True):
        for name, label in (("paper", "paper"), *((m, style.method_style(m).label) for m in methods)):
            colour = style.PAPER if name == "paper" else style.method_style(name).colour
            row: list[str | Markup] = [str(minute) if name == "paper" else "", swatched(label, colour)]
            for parameter in PARAMETERS:
                cell = part[part["parameter"] == parameter].iloc[0]
                text = quantities.percent(cell[name])
                row.append(text if cell["identifiable"] else marked(f"({text})", "none"))
            rows.append(row)
    heads = ["minute", "method", *(Markup(quantities.html_symbol(p)) for p in PARAMETERS)]
    return (Table(heads, rows, words=(0, 1), title="Beside the paper's table", about=BESIDE_PAPER),)
