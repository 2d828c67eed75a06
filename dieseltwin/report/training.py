"""Convergence of an iterative method."""

from __future__ import annotations

import math

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dieseltwin.report import captions, quantities, style
from dieseltwin.report.results import PARAMETERS, MethodResult, Results
from dieseltwin.report.segment_axis import WIDTH_IN

LOSS_PREFIX = "loss"
TOTAL = ("loss", "loss_total")
SVG_MAX_SEGMENTS = 8  # more lines make an SVG heavier than a picture
_SEGMENT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7a5195", "#5c5c5c")
_LOSS_COLOURS = ("#000000", *_SEGMENT_COLOURS, "#b8860b")


def _range_over_runs(table: pd.DataFrame) -> tuple[pd.Index, pd.Series, pd.Series, pd.Series]:
    grouped = table.groupby("epoch")["value"]
    return grouped.median().index, grouped.median(), grouped.min(), grouped.max()


@style.styled
def convergence(results: Results, method: MethodResult) -> style.ReportFigure | None:
    """Losses and unknown parameters over the epochs, the range over runs as a band. None without curves."""
    curves = method.curves
    if curves is None or not len(curves):
        return None
    losses = [q for q in curves["quantity"].unique() if str(q).startswith(LOSS_PREFIX)]
    unknowns = [p for p in PARAMETERS if p in set(curves["quantity"])]
    figure = Figure(figsize=(WIDTH_IN, (3.4 if losses else 0) + (2.4 * math.ceil(len(unknowns) / 2)) + 0.5))
    heights = ([1.4] if losses else []) + [1.0] * math.ceil(len(unknowns) / 2)
    layout = ([["loss", "loss"]] if losses else []) + [
        unknowns[i : i + 2] for i in range(0, len(unknowns), 2)
    ]
    layout = [row if len(row) == 2 else [row[0], row[0]] for row in layout]
    panels: dict[str, Axes] = figure.subplot_mosaic(layout, sharex=True, height_ratios=heights)
    if losses:
        axes = panels["loss"]
        for index, name in enumerate(losses):
            epochs, middle, low, high = _range_over_runs(curves[curves["quantity"] == name])
            colour = _LOSS_COLOURS[index % len(_LOSS_COLOURS)]
            if name in TOTAL:  # a band for each of ten terms would hide the lines
                axes.fill_between(epochs, low, high, color=colour, alpha=0.12, linewidth=0)
            axes.plot(
                epochs,
                middle,
                color=colour,
                linewidth=2.0 if name in TOTAL else 1.1,
                label=_loss_words(str(name)),
                linestyle="-" if index < len(_LOSS_COLOURS) // 2 else "--",
            )
        axes.set_yscale("log")
        axes.set_ylabel("loss [–]")
        axes.set_title("loss: median over segments and runs, with their range", fontweight="normal")
        axes.tick_params(labelbottom=True)
        axes.legend(loc="upper right", ncols=2 if len(losses) > 5 else 1)
    segments = sorted(curves["segment"].unique())
    for name in unknowns:
        axes = panels[name]
        chosen = curves[curves["quantity"] == name]
        for index, segment in enumerate(segments):
            colour = _SEGMENT_COLOURS[index % len(_SEGMENT_COLOURS)]
            epochs, middle, low, high = _range_over_runs(chosen[chosen["segment"] == segment])
            edges = quantities.shown(name, low), quantities.shown(name, high)
            axes.fill_between(epochs, *edges, color=colour, alpha=0.2, linewidth=0)
            axes.plot(epochs, quantities.shown(name, middle), color=colour)
        truth = results.true_value(name)
        if math.isfinite(truth):
            axes.axhline(
                float(quantities.shown(name, truth)), color=style.TRUTH, linestyle="--", linewidth=1.1
            )
        axes.set_ylabel(quantities.axis_label(name))
    last = layout[-1]
    for name in set(last):
        panels[name].set_xlabel("epoch [–]")
    handles = [
        Line2D(
            [],
            [],
            color=_SEGMENT_COLOURS[i % len(_SEGMENT_COLOURS)],
            label=f"{_minutes(results, int(s))} min",
        )
        for i, s in enumerate(segments)
    ]
    if results.truth is not None:
        handles.append(Line2D([], [], color=style.TRUTH, linestyle="--", label="truth"))
    if unknowns:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(8, len(handles)))
    slug = style.slug(method.method)
    title = f"Convergence of {style.method_style(method.method).label}"
    kind = "svg" if len(segments) <= SVG_MAX_SEGMENTS else "png"
    return style.ReportFigure(f"convergence_{slug}", title, captions.CONVERGENCE, figure, kind)


def _minutes(results: Results, segment: int) -> str:
    return results.segments[segment].minutes if segment < len(results.segments) else str(segment)


def _loss_words(name: str) -> str:
    text = name.removeprefix(LOSS_PREFIX).strip("_. ")
    for kind, words in (
        ("ode", "physics"),
        ("physics", "physics"),
        ("data", "data"),
        ("initial", "initial"),
        ("ini", "initial"),
    ):
        for form in (f"_{kind}", f"{kind}_"):
            if text.endswith(form) or text.startswith(form):
                column = text.removesuffix(form).removeprefix(form)
                return f"{_any_symbol(column)} ({words})"
    return text.replace("_", " ") or "total, as minimised"


def _any_symbol(name: str) -> str:
    """Symbol of a name, a column, or a column without its unit."""
    if quantities.known(name):
        return quantities.symbol(name)
    lowered = {key.lower(): key for key in ("p_im", "p_em", "omega_t", "x_r", "T_1", "W_egr", "T_em", "W_c")}
    return quantities.symbol(lowered[name.lower()]) if name.lower() in lowered else name
