"""Charts over segments and methods: violins, estimate against Cramer-Rao bound, identifiability map, run times."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from dieseltwin.report import captions, quantities, style
from dieseltwin.report.printed import PRINTED_SECONDS
from dieseltwin.report.results import PARAMETERS, MethodResult, Results
from dieseltwin.report.statistics import error_over_bound, reference_values, relative_bound, std_over_bound

PAPER_BAND = 0.075  # the paper's error band around the true value, caption of its violin plots
VIOLIN_MIN_RUNS = 5  # fewer points give no density worth drawing
VIOLIN_MAX_SLOTS = 60  # more violins than this in one row are too thin to read; points and intervals stay
MAP_TEXT_MAX_SEGMENTS = 24
WIDTH_IN = 11.0
SMALLEST_RATIO = 0.1  # an error far below the bound is luck of one noise draw: drawn at the edge
LINE_HALF = 0.4  # half width of one segment's slot on the axis


def _segment_axis(axes: Axes, results: Results) -> None:
    names = [segment.minutes for segment in results.segments]
    step = max(1, math.ceil(len(names) / 24))
    axes.set_xticks(range(0, len(names), step), names[::step])
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.grid(False, axis="x")
    for edge in range(1, len(names)):
        axes.axvline(edge - 0.5, color=style.SEGMENT_LINE, linewidth=0.6, linestyle=":")


def _method_handles(methods: Sequence[MethodResult], *, line: bool = False) -> list[Line2D]:
    handles = []
    for method in methods:
        look = style.method_style(method.method)
        handles.append(
            Line2D(
                [],
                [],
                color=look.colour,
                marker=look.marker,
                markersize=6,
                label=look.label,
                linestyle=look.line if line else "none",
            )
        )
    return handles


def _offsets(count: int) -> NDArray[np.float64]:
    """Centres of ``count`` slots inside one segment."""
    width = 2 * LINE_HALF / count
    return np.asarray(-LINE_HALF + width * (np.arange(count) + 0.5), dtype=np.float64)


def swarm(values: NDArray[np.float64], reach: float, height: float) -> NDArray[np.float64]:
    """Sideways positions (n,) of dots so that dots nearer than ``height`` don't hide each other, within ``+-reach``."""
    steps = 9
    ladder = [0.0] + [sign * reach * k / steps for k in range(1, steps + 1) for sign in (1, -1)]
    placed: list[tuple[float, float]] = []
    positions = np.zeros(len(values))
    for index in np.argsort(values, kind="stable"):
        near = {x for y, x in placed if abs(y - values[index]) < height}
        # a slot that is full stacks its dots again from the middle: the violin shows the density anyway
        x = next((x for x in ladder if x not in near), ladder[len(near) % len(ladder)])
        positions[index] = x
        placed.append((float(values[index]), x))
    return positions


def _vertical_range(results: Results, parameter: str, reference: float) -> tuple[float, float]:
    """Axis limits in units of the reference: all identifiable intervals and runs, at least +-10 %, at most +-50 %."""
    wanted = [1 - 0.1, 1 + 0.1]
    for method in results.methods:
        for index, segment in enumerate(method.segments):
            estimate = segment.parameters[parameter]
            if not estimate.identifiable:
                continue
            values = [estimate.mean, *estimate.interval_90, *_run_values(method, index, parameter)]
            wanted += [v / reference for v in values if math.isfinite(v)]
    low, high = max(min(wanted), 0.5), min(max(wanted), 1.5)
    margin = 0.04 * (high - low)
    return low - margin, high + margin


def _close_range(results: Results, parameter: str, reference: float) -> tuple[float, float]:
    """Axis limits that fit the sharpest method: twice the usual reach of its identifiable 90 % intervals."""
    reaches = []
    for method in results.methods:
        estimates = [segment.parameters[parameter] for segment in method.segments]
        edges = [e.interval_90 for e in estimates if e.identifiable and math.isfinite(sum(e.interval_90))]
        reach = [max(abs(low / reference - 1), abs(high / reference - 1)) for low, high in edges]
        if reach:
            reaches.append(float(np.median(reach)))
    half = 2.0 * min(reaches, default=0.1)
    return 1 - half, 1 + half


def _run_values(method: MethodResult, segment: int, parameter: str) -> NDArray[np.float64]:
    runs = method.runs
    if not len(runs):
        return np.empty(0)
    chosen = runs[(runs["segment"] == segment) & (runs["parameter"] == parameter)]
    values = chosen["value"].to_numpy(dtype=float)
    return values[np.isfinite(values)]


def _draw_slot(
    axes: Axes,
    method: MethodResult,
    index: int,
    parameter: str,
    reference: float,
    x: float,
    half: float,
    violin: bool,
) -> None:
    look = style.method_style(method.method)
    estimate = method.segments[index].parameters[parameter]
    low_limit, high_limit = axes.get_ylim()
    span = high_limit - low_limit
    values = _run_values(method, index, parameter) / reference
    inside = values[(values >= low_limit) & (values <= high_limit)]
    alpha = 0.9 if estimate.identifiable else 0.35
    if violin and len(inside) >= VIOLIN_MIN_RUNS and np.ptp(inside) > 0.004 * span:
        body = axes.violinplot([inside], positions=[x], widths=1.7 * half, showextrema=False)
        for part in list(body["bodies"]):  # type: ignore[call-overload]
            part.set(facecolor=look.colour, edgecolor=look.colour, alpha=0.28 * alpha / 0.9)
    if len(inside):
        size = 7 if len(inside) > VIOLIN_MIN_RUNS else 18
        axes.scatter(
            x + swarm(inside, 0.75 * half, 0.016 * span),
            inside,
            s=size,
            color=look.colour,
            marker=look.marker,
            alpha=alpha,
            linewidths=0,
            zorder=3,
        )
    if estimate.finite:
        low, high = (v / reference for v in estimate.interval_90)
        bar = x - 0.92 * half
        if math.isfinite(low) and math.isfinite(high):
            axes.plot(
                [bar, bar], [low, high], color=look.colour, linewidth=1.8, alpha=alpha, solid_capstyle="butt"
            )
        if low_limit <= estimate.mean / reference <= high_limit:
            axes.plot(
                [x - 0.92 * half, x + 0.92 * half],
                [estimate.mean / reference] * 2,
                color=look.colour,
                linewidth=1.4,
                alpha=alpha,
            )
    else:
        axes.text(
            x,
            0.5 * (low_limit + high_limit),
            "no\nresult",
            color=look.colour,
            ha="center",
            va="center",
            fontsize=8,
        )
    if not estimate.identifiable:
        return
    below, above = int((values < low_limit).sum()), int((values > high_limit).sum())
    for outside, edge, sign in ((below, low_limit, "↓"), (above, high_limit, "↑")):
        if outside:
            axes.text(
                x,
                edge,
                f"{outside}{sign}",
                color=look.colour,
                ha="center",
                fontsize=8,
                va="bottom" if sign == "↓" else "top",
            )


@style.styled
def violins(results: Results, *, close: bool = False) -> style.ReportFigure:
    """Estimated parameters per segment and method: violin, one dot per run, mean, 90 % interval, +-7.5 % band.

    ``close`` fits the axes to the sharpest method instead of the paper's scale.
    """
    figure = Figure(figsize=(WIDTH_IN, 2.45 * len(PARAMETERS) + 0.6))
    panels = figure.subplots(len(PARAMETERS), 1, sharex=True)
    known = results.truth is not None
    references = reference_values(results)
    offsets = _offsets(len(results.methods))
    half = LINE_HALF / len(results.methods)
    violin = len(results.methods) * len(results.segments) <= VIOLIN_MAX_SLOTS
    for axes, parameter in zip(panels, PARAMETERS, strict=True):
        reference = references[parameter]
        _segment_axis(axes, results)
        axes.set_title(f"{quantities.symbol(parameter)}  {quantities.words(parameter)}", fontweight="normal")
        axes.set_ylabel(f"{quantities.symbol(parameter)} / {'truth' if known else 'pooled'} [–]")
        if not math.isfinite(reference):
            style.note(axes, "no finite estimate of this parameter in any segment")
            continue
        axes.axhspan(
            1 - PAPER_BAND, 1 + PAPER_BAND, color=style.BAND_OF_TRUTH, alpha=0.6, zorder=0, linewidth=0
        )
        axes.axhline(1.0, color=style.TRUTH, linewidth=1.1, linestyle="--", zorder=1)
        for edge in (1 - PAPER_BAND, 1 + PAPER_BAND):
            axes.axhline(edge, color=style.MEASURED, linewidth=0.7, linestyle=":", zorder=1)
        axes.set_ylim(*(_close_range if close else _vertical_range)(results, parameter, reference))
        flagged: dict[int, float] = {}
        for method, offset in zip(results.methods, offsets, strict=True):
            for index, segment in enumerate(method.segments):
                place = results.segment_index(segment)
                if not segment.parameters[parameter].identifiable:
                    flagged.setdefault(
                        place, relative_bound(results, segment.parameters[parameter], parameter)
                    )
                _draw_slot(axes, method, index, parameter, reference, place + offset, half, violin)
        for place, bound in flagged.items():
            axes.axvspan(
                place - 0.5,
                place + 0.5,
                facecolor=style.NOT_IDENTIFIABLE,
                edgecolor="#cfcfcf",
                hatch="///",
                linewidth=0,
                zorder=0.5,
            )
            size = f"\nbound {100 * bound:.0f} %" if math.isfinite(bound) else ""
            axes.text(
                place,
                axes.get_ylim()[1],
                f"not identifiable here{size}",
                ha="center",
                va="top",
                fontsize=8,
                color="#444444",
                zorder=5,
                bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
            )
    panels[-1].set_xlabel("segment [min]")
    handles: list[Line2D | Patch] = list(_method_handles(results.methods))
    handles.append(
        Line2D([], [], color=style.TRUTH, linestyle="--", label="truth" if known else "pooled estimate")
    )
    handles.append(
        Patch(facecolor=style.BAND_OF_TRUTH, edgecolor=style.MEASURED, linestyle=":", label="±7.5 %")
    )
    if any(not s.parameters[p].identifiable for m in results.methods for s in m.segments for p in PARAMETERS):
        handles.append(
            Patch(
                facecolor=style.NOT_IDENTIFIABLE,
                edgecolor="#cfcfcf",
                hatch="///",
                label="not identifiable here",
            )
        )
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    if close:
        words = captions.VIOLINS_CLOSE.format(expectation=captions.EXPECTATION if known else "")
        return style.ReportFigure(
            "violins_close", "Health parameters per segment, seen closely", words, figure
        )
    words = captions.VIOLINS.format(centre=captions.CENTRE_TRUTH if known else captions.CENTRE_POOLED)
    return style.ReportFigure("violins", "Health parameters per segment", words, figure)


@style.styled
def bound_ratio(results: Results) -> style.ReportFigure:
    """Error and stated standard deviation of each segment's estimate in units of its Cramer-Rao bound."""
    figure = Figure(figsize=(WIDTH_IN, 6.4))
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    known = results.truth is not None
    offsets = 0.7 * _offsets(len(results.methods))
    largest = 5.0
    for axes, parameter in zip(panels.flat, PARAMETERS, strict=True):
        _segment_axis(axes, results)
        axes.set_yscale("log")
        marks = 0
        for method, offset in zip(results.methods, offsets, strict=True):
            look = style.method_style(method.method)
            for index, segment in enumerate(method.segments):
                estimate = segment.parameters[parameter]
                if not estimate.identifiable:
                    continue
                x = results.segment_index(segment) + offset
                stated = std_over_bound(estimate)
                actual = error_over_bound(method, index, parameter, results.true_value(parameter))
                if math.isfinite(stated) and stated > 0:
                    axes.plot(
                        x,
                        max(stated, SMALLEST_RATIO),
                        look.marker,
                        color=look.colour,
                        markerfacecolor="white",
                        markersize=6.5,
                    )
                    marks += 1
                    largest = max(largest, stated)
                if math.isfinite(actual) and actual > 0:
                    axes.plot(x, max(actual, SMALLEST_RATIO), look.marker, color=look.colour, markersize=6.5)
                    marks += 1
                    largest = max(largest, actual)
        axes.axhline(1.0, color=style.TRUTH, linewidth=1.1, linestyle="--")
        axes.set_ylim(0.75 * SMALLEST_RATIO, 1.5 * largest)
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_title(quantities.symbol(parameter), fontweight="normal")
        if not marks:
            style.note(axes, "no identifiable segment")
    for axes in panels[:, 0]:
        axes.set_ylabel("multiple of the bound [–]")
    for axes in panels[-1]:
        axes.set_xlabel("segment [min]")
    handles: list[Line2D] = _method_handles(results.methods)
    if known:
        handles.append(Line2D([], [], color="#333333", marker="o", linestyle="none", label="actual error"))
    handles.append(
        Line2D(
            [], [], color="#333333", marker="o", markerfacecolor="white", linestyle="none", label="stated std"
        )
    )
    handles.append(Line2D([], [], color=style.TRUTH, linestyle="--", label="Cramér–Rao bound"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    words = captions.BOUND.format(marks=captions.BOUND_KNOWN if known else captions.BOUND_UNKNOWN)
    return style.ReportFigure("bound_ratio", "Accuracy against the Cramér–Rao bound", words, figure)


@style.styled
def identifiability_map(results: Results) -> style.ReportFigure:
    """Relative Cramer-Rao bound [%] of each parameter in each segment; too large ones say so."""
    segments = results.segments
    figure = Figure(figsize=(WIDTH_IN, 3.1))
    axes = figure.subplots()
    table = np.full((len(PARAMETERS), len(segments)), np.nan)
    flagged = np.zeros_like(table, dtype=bool)
    for column, segment in enumerate(segments):
        for row, parameter in enumerate(PARAMETERS):
            estimate = segment.parameters[parameter]
            table[row, column] = 100 * relative_bound(results, estimate, parameter)
            flagged[row, column] = not estimate.identifiable
    image = axes.imshow(
        np.where(flagged, np.nan, table), aspect="auto", cmap="viridis", norm=LogNorm(0.05, 25.0)
    )
    for row in range(len(PARAMETERS)):
        for column in range(len(segments)):
            value = table[row, column]
            if flagged[row, column]:
                axes.add_patch(_cell(column, row))
            if len(segments) > MAP_TEXT_MAX_SEGMENTS:
                continue
            text = _bound_text(value)
            if flagged[row, column] and len(segments) <= 8:
                text = f"not identifiable here\n({text})" if math.isfinite(value) else "not identifiable here"
            dark_cell = not flagged[row, column] and math.isfinite(value) and value < 4.0
            size = 9.5 if len(segments) <= 12 else 7
            axes.text(
                column,
                row,
                text,
                ha="center",
                va="center",
                color="white" if dark_cell else "black",
                fontsize=size,
            )
    names = [segment.minutes for segment in segments]
    step = max(1, math.ceil(len(names) / 24))
    axes.set_xticks(range(0, len(names), step), names[::step])
    axes.set_yticks(range(len(PARAMETERS)), [quantities.symbol(p) for p in PARAMETERS], fontsize=11)
    axes.set_xlabel("segment [min]")
    axes.set_ylabel("parameter")
    axes.grid(False)
    bar = figure.colorbar(
        image, ax=axes, label="Cramér–Rao bound [% of value]", ticks=[0.1, 0.3, 1, 3, 10, 25]
    )
    bar.ax.yaxis.set_major_formatter("{x:g}")
    bar.ax.minorticks_off()
    return style.ReportFigure(
        "identifiability", "What this driving can show", captions.IDENTIFIABILITY, figure
    )


def _bound_text(percent: float) -> str:
    if not math.isfinite(percent):
        return "–"
    return f"{quantities.significant(percent, 2)} %" if percent < 100 else ">100 %"


def _cell(column: int, row: int) -> Patch:
    return Rectangle(
        (column - 0.5, row - 0.5),
        1,
        1,
        facecolor=style.NOT_IDENTIFIABLE,
        edgecolor="#9a9a9a",
        hatch="///",
        linewidth=0,
    )


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
    printed = [
        (f"paper: {name}", s, style.PAPER, f"{s:.0f} s per run") for name, s in PRINTED_SECONDS.items()
    ]
    figure = Figure(figsize=(WIDTH_IN, 0.5 * (len(rows) + len(printed)) + 1.4))
    axes = figure.subplots()
    everything = rows + printed
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
    return style.ReportFigure("run_times", "Run times", captions.RUN_TIMES, figure)
