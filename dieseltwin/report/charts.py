"""Charts over segments and methods: estimate against Cramer-Rao bound, identifiability map."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import LogLocator

from dieseltwin.report import captions, quantities, style
from dieseltwin.report.results import PARAMETERS, Results
from dieseltwin.report.segment_axis import MOST_NAMES, WIDTH_IN, method_handles, name_segments, offsets_of, segment_axis
from dieseltwin.report.statistics import error_over_bound, relative_bound, std_over_bound

LEAST_STATED = 0.7  # a stated std below this share of the bound claims more than the readings can tell
SMALLEST_RATIO = 0.1  # an error far below the bound is luck of one noise draw: drawn at the edge


@style.styled
def bound_ratio(results: Results) -> style.ReportFigure:
    """Error and stated standard deviation of each segment's estimate in units of its Cramer-Rao bound."""
    figure = Figure(figsize=(WIDTH_IN, 6.4))
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    known = results.truth is not None
    offsets = 0.7 * offsets_of(len(results.methods))
    largest = 5.0
    for axes, parameter in zip(panels.flat, PARAMETERS, strict=True):
        segment_axis(axes, results)
        axes.set_yscale("log")
        marks = 0
        for method, offset in zip(results.methods, offsets, strict=True):
            look = style.method_style(method.method)
            for index, segment in enumerate(method.segments):
                estimate = segment.parameters[parameter]
                if results.flagged_by_any(segment, parameter):
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
    handles: list[Line2D] = method_handles(results.methods)
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
    words = " ".join([words, *_too_sure(results)])
    return style.ReportFigure("bound_ratio", "Accuracy against the Cramér–Rao bound", words, figure)


def _too_sure(results: Results) -> list[str]:
    """Sentences on methods that state less than the bound allows, by parameter and segment; needs no truth."""
    found = []
    for method in results.methods:
        places = []
        for parameter in PARAMETERS:
            minutes = [
                s.minutes
                for s in method.segments
                if s.parameters[parameter].identifiable
                and std_over_bound(s.parameters[parameter]) < LEAST_STATED
            ]
            if minutes:
                places.append(f"{parameter} ({', '.join(minutes)} min)")
        if places:
            label = style.method_style(method.method).label
            found.append(captions.TOO_SURE.format(label=label, places=", ".join(places)))
    return found


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
            if len(segments) > MOST_NAMES:
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
    name_segments(axes, segments)
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
        **{**style.BLIND, "edgecolor": "#9a9a9a"},
    )
