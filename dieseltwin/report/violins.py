"""Violins of the estimated parameters, per segment and method."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from dieseltwin.report import captions, quantities, style
from dieseltwin.report.results import PARAMETERS, MethodResult, Results
from dieseltwin.report.segment_axis import LINE_HALF, WIDTH_IN, method_handles, offsets_of, segment_axis
from dieseltwin.report.statistics import reference_values, relative_bound

PAPER_BAND = 0.075  # the paper's error band around the true value, caption of its violin plots
VIOLIN_MIN_RUNS = 5  # fewer points give no density worth drawing
SVG_MAX_DOTS = 600  # dots in a panel; more make an SVG heavier than a picture
VIOLIN_MAX_SLOTS = 60  # more violins than this in one row are too thin to read; points and intervals stay


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
    """Axis limits in units of the reference: all identifiable runs, at least +-10 %, at most +-50 %."""
    wanted = [1 - 0.1, 1 + 0.1]
    for method in results.methods:
        for index, segment in enumerate(method.segments):
            estimate = segment.parameters[parameter]
            if results.flagged_by_any(segment, parameter):
                continue
            values = [estimate.mean, *_run_values(method, index, parameter)]
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
        height = 0.016 * span
        agreeing = len(inside) > 1 and np.ptp(inside) < height
        # dots that fall together become one larger dot: spread sideways they would look like a result
        places = x + (np.zeros(len(inside)) if agreeing else swarm(inside, 0.75 * half, height))
        size = 22 if agreeing else (7 if len(inside) > VIOLIN_MIN_RUNS else 18)
        axes.scatter(
            places, inside, s=size, color=look.colour, marker=look.marker, alpha=alpha, linewidths=0, zorder=3
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
    offsets = offsets_of(len(results.methods))
    half = LINE_HALF / len(results.methods)
    violin = len(results.methods) * len(results.segments) <= VIOLIN_MAX_SLOTS
    for axes, parameter in zip(panels, PARAMETERS, strict=True):
        reference = references[parameter]
        segment_axis(axes, results)
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
            axes.axvspan(place - 0.5, place + 0.5, **style.BLIND, zorder=0.5)
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
    handles: list[Line2D | Patch] = list(method_handles(results.methods))
    handles.append(
        Line2D([], [], color=style.TRUTH, linestyle="--", label="truth" if known else "pooled estimate")
    )
    handles.append(
        Patch(facecolor=style.BAND_OF_TRUTH, edgecolor=style.MEASURED, linestyle=":", label="±7.5 %")
    )
    if any(not s.parameters[p].identifiable for m in results.methods for s in m.segments for p in PARAMETERS):
        handles.append(Patch(**style.BLIND, label="not identifiable here"))
    style.legend_above(figure, handles, WIDTH_IN)
    dots = sum(len(method.runs) for method in results.methods) // len(PARAMETERS)
    kind = "svg" if dots <= SVG_MAX_DOTS else "png"
    title = "Health parameters per segment"
    if close:
        words = captions.VIOLINS_CLOSE.format(expectation=captions.EXPECTATION if known else "")
        return style.ReportFigure("violins_close", f"{title}, seen closely", words, figure, kind)
    words = captions.VIOLINS.format(centre=captions.CENTRE_TRUTH if known else captions.CENTRE_POOLED)
    return style.ReportFigure("violins", title, words, figure, kind)
