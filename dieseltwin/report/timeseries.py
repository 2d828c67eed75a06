"""Figures over time: states, flows and temperatures, maps of the engine, and residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dieseltwin.report import captions, quantities, style
from dieseltwin.report.results import MethodResult, Results
from dieseltwin.report.segment_axis import WIDTH_IN
from dieseltwin.report.statistics import autocorrelation, band, odd_channels, residuals
from dieseltwin.symbols import STATES

FLOWS = ("w_egr_kg_s", "w_c_kg_s", "w_t_kg_s", "w_ei_kg_s", "t_em_k", "t_e_k")
EMPIRICAL = ("eta_vol", "f_egr", "f_vgt_pi_t", "eta_tm", "eta_c", "phi_c")
ACF_LAG_S = 4.0  # lags shown: several times the turbocharger's share of a sample, far below a segment
LEAST_LIMIT_PCT = 0.05  # errors below this are rounding
OUTLIER_FACTOR, OUTLIER_LEAST_PCT = (
    10.0,
    2.0,
)  # a method beyond both leaves the error panel and is told in words
MARGINS_IN, GAPS_IN, WIDTHS = (0.6, 0.05, 0.55, 0.6), (0.75, 0.35), (4.2, 1.5, 1.9)  # of panels of residuals
RESIDUAL_LIMIT = 5.0  # axis of residuals in standard deviations; rarer ones are counted at the edge
BREAK_GAP = 3.0  # a step in time longer than this many usual steps breaks the line


def _with_breaks(
    table: pd.DataFrame, values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time [min] and values with NaN between segments and across gaps: each segment is estimated on its own."""
    time = table["time_s"].to_numpy(dtype=float)
    if len(time) < 2:
        return time / 60, values
    step = np.diff(time)
    cut = (step > BREAK_GAP * np.median(step)) | (step <= 0)
    if "segment" in table:
        cut |= np.diff(table["segment"].to_numpy()) != 0
    places = np.flatnonzero(cut) + 1
    return np.insert(time / 60, places, np.nan), np.insert(values.astype(float), places, np.nan)


def _mark_segments(axes: Axes, results: Results) -> None:
    edges = sorted({edge for s in results.segments for edge in (s.t0_s, s.t1_s)})
    for edge in edges:
        axes.axvline(edge / 60, color=style.SEGMENT_LINE, linewidth=0.7, linestyle=":")
    if edges:
        axes.set_xlim(edges[0] / 60, edges[-1] / 60)


def _span(results: Results, table: pd.DataFrame) -> pd.DataFrame:
    """The rows inside the identified part of the recording (truth and measurement may be longer)."""
    if not results.segments:
        return table
    first, last = min(s.t0_s for s in results.segments), max(s.t1_s for s in results.segments)
    return table[(table["time_s"] >= first - 1e-6) & (table["time_s"] <= last + 1e-6)]


def _draw_value(axes: Axes, results: Results, column: str) -> None:
    if results.measured is not None and column in results.measured:
        table = _span(results, results.measured)
        axes.plot(
            table["time_s"] / 60,
            quantities.shown(column, table[column]),
            ".",
            color=style.MEASURED,
            markersize=2.2,
            alpha=0.75,
            zorder=1,
        )
    if results.truth_states is not None and column in results.truth_states:
        table = _span(results, results.truth_states)
        axes.plot(
            table["time_s"] / 60,
            quantities.shown(column, table[column]),
            color=style.TRUTH,
            linewidth=2.0,
            zorder=2,
        )
    for method in results.methods:
        if method.states is None or column not in method.states:
            continue
        look = style.method_style(method.method)
        edges = band(method.states, column)
        if edges is not None:
            time, low = _with_breaks(method.states, quantities.shown(column, edges[0]))
            _, high = _with_breaks(method.states, quantities.shown(column, edges[1]))
            axes.fill_between(time, low, high, color=look.colour, alpha=0.25, linewidth=0, zorder=2.5)
        time, values = _with_breaks(
            method.states, quantities.shown(column, method.states[column].to_numpy(dtype=float))
        )
        axes.plot(time, values, color=look.colour, linestyle=look.line, linewidth=1.1, zorder=3)
    axes.set_ylabel(quantities.axis_label(column))


def _reach(values: NDArray[np.float64]) -> float:
    """What an axis must show of ``values``: all but the rarest half per cent (segments start with a spike)."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.quantile(finite, 0.995)) if len(finite) else 0.0


def _fair_limit(reaches: Sequence[float]) -> float:
    """Half height [%] of an error panel: all methods, unless one is so far off that the others would be a line."""
    if not reaches:
        return LEAST_LIMIT_PCT
    return max(LEAST_LIMIT_PCT, min(max(reaches), max(OUTLIER_FACTOR * min(reaches), OUTLIER_LEAST_PCT)))


def _informed(method: MethodResult) -> NDArray[np.bool_]:
    """Rows of a method's states in segments where every parameter is identifiable; all rows where there are none.

    A segment without information has bands that would set the scale of all others.
    """
    if method.states is None:
        return np.zeros(0, dtype=bool)
    time = method.states["time_s"].to_numpy(dtype=float)
    rows = np.zeros(len(time), dtype=bool)
    for segment in method.segments:
        if all(estimate.identifiable for estimate in segment.parameters.values()):
            rows |= (time > segment.t0_s) & (time < segment.t1_s)
    return rows if rows.any() else np.ones(len(time), dtype=bool)


def _shade_blind(axes: Axes, results: Results) -> None:
    blind = {
        (s.t0_s, s.t1_s)
        for m in results.methods
        for s in m.segments
        if not all(e.identifiable for e in s.parameters.values())
    }
    for first, last in blind:
        axes.axvspan(first / 60, last / 60, **style.BLIND, zorder=0)


def _draw_error(axes: Axes, results: Results, column: str) -> None:
    truth = results.truth_states
    axes.axhline(0.0, color=style.TRUTH, linewidth=0.9)
    axes.set_ylabel("error [%]")
    if truth is None or column not in truth:
        return
    time_true, value_true = truth["time_s"].to_numpy(dtype=float), truth[column].to_numpy(dtype=float)
    scale = abs(float(np.nanmean(_span(results, truth)[column])))
    if not scale > 0:
        return
    reaches: dict[str, float] = {}
    for method in results.methods:
        if method.states is None or column not in method.states:
            continue
        look = style.method_style(method.method)
        expected = np.interp(method.states["time_s"].to_numpy(dtype=float), time_true, value_true)
        error = 100 * (method.states[column].to_numpy(dtype=float) - expected) / scale
        edges = band(method.states, column)
        if edges is not None:
            time, low = _with_breaks(method.states, 100 * (edges[0] - expected) / scale)
            _, high = _with_breaks(method.states, 100 * (edges[1] - expected) / scale)
            axes.fill_between(time, low, high, color=look.colour, alpha=0.2, linewidth=0)
            edge = np.maximum(np.abs(edges[0] - expected), np.abs(edges[1] - expected))
            reaches[method.method] = _reach(100 * edge[_informed(method)] / scale)
        time, values = _with_breaks(method.states, error)
        axes.plot(time, values, color=look.colour, linewidth=0.9, linestyle=look.line)
        reaches[method.method] = max(
            _reach(error[_informed(method)]), reaches.get(method.method, 0.0)
        )
    limit = 1.25 * _fair_limit(list(reaches.values()))
    axes.set_ylim(-limit, limit)
    outside = [(name, reach) for name, reach in reaches.items() if reach > limit]
    for place, (name, reach) in enumerate(outside):
        look = style.method_style(name)
        axes.text(
            0.995,
            0.95 - 0.27 * place,
            f"{look.label}: up to {reach:.0f} %",
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=8.5,
            color=look.colour,
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
        )


def _handles(results: Results, columns: Sequence[str]) -> list[Line2D]:
    handles = []
    if results.truth_states is not None and any(c in results.truth_states for c in columns):
        handles.append(Line2D([], [], color=style.TRUTH, linewidth=2.0, label="truth"))
    if results.measured is not None and any(c in results.measured for c in columns):
        handles.append(Line2D([], [], color=style.MEASURED, marker=".", linestyle="none", label="measured"))
    for method in results.methods:
        if method.states is None:
            continue
        look = style.method_style(method.method)
        handles.append(
            Line2D([], [], color=look.colour, linestyle=look.line, label=f"{look.label} (band: 90 %)")
        )
    return handles


@style.styled
def trajectories(
    results: Results, columns: Sequence[str], name: str, title: str, words: str
) -> style.ReportFigure | None:
    """Estimated quantities over time against truth and measurement, each with its error below it.

    Returns None where no method has any of ``columns``.
    """
    present = [c for c in columns if any(m.states is not None and c in m.states for m in results.methods)]
    if not present:
        return None
    known = results.truth_states is not None and any(c in results.truth_states for c in present)
    ratios = [3.0, 1.3] if known else [3.0]
    figure = Figure(figsize=(WIDTH_IN, (2.55 if known else 1.9) * len(present) + 0.6))
    panels = figure.subplots(len(ratios) * len(present), 1, sharex=True, height_ratios=ratios * len(present))
    panels = np.atleast_1d(panels)
    for index, column in enumerate(present):
        top = panels[len(ratios) * index]
        top.set_title(quantities.words(column), fontweight="normal")
        _draw_value(top, results, column)
        _mark_segments(top, results)
        if known:
            _draw_error(panels[2 * index + 1], results, column)
            _mark_segments(panels[2 * index + 1], results)
            _shade_blind(panels[2 * index + 1], results)
    panels[-1].set_xlabel("time [min]")
    handles = _handles(results, present)
    blind = any(
        not e.identifiable for m in results.methods for s in m.segments for e in s.parameters.values()
    )
    style.legend_above(figure, handles, WIDTH_IN)
    caption = f"{words} {captions.SEGMENTS}" + (f" {captions.ERRORS}" if known else "")
    caption += f" {captions.BLIND}" if known and blind else ""
    return style.ReportFigure(name, title, caption, figure, kind="png")


def states(results: Results) -> style.ReportFigure | None:
    """The five states that the estimators carry."""
    return trajectories(results, STATES, "states", "States", captions.STATES)


def flows(results: Results) -> style.ReportFigure | None:
    """Mass flows and gas temperatures."""
    return trajectories(results, FLOWS, "flows", "Flows and temperatures", captions.FLOWS)


def empirical(results: Results) -> style.ReportFigure | None:
    """The six empirical variables of the engine model."""
    return trajectories(results, EMPIRICAL, "empirical", "Empirical variables", captions.EMPIRICAL)


@style.styled
def residual_figure(results: Results, method: MethodResult) -> style.ReportFigure | None:
    """Residuals of one method in standard deviations of the noise: over time, as histogram, and autocorrelation.

    Returns None where predictions, measurements or noise levels are missing.
    """
    found = residuals(results, method)
    if not found:
        return None
    look = style.method_style(method.method)
    figure = Figure(figsize=(WIDTH_IN, 1.75 * len(found) + 0.7))
    panels = style.grid_of_panels(figure, len(found), 3, MARGINS_IN, GAPS_IN, width_ratios=WIDTHS, sharex="col")
    grid = np.linspace(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, 201)
    for row, (column, (time, values)) in zip(panels, found.items(), strict=True):
        over_time, histogram, correlation = row
        inside = np.clip(values, -RESIDUAL_LIMIT, RESIDUAL_LIMIT)
        over_time.axhspan(-2, 2, color=style.BAND_OF_TRUTH, alpha=0.6, linewidth=0)
        over_time.axhline(0, color=style.TRUTH, linewidth=0.9)
        over_time.plot(time / 60, inside, ".", color=look.colour, markersize=2.4)
        over_time.set_ylim(-RESIDUAL_LIMIT, RESIDUAL_LIMIT)
        over_time.set_ylabel(f"{quantities.symbol(column)}  [σ]")
        _mark_segments(over_time, results)
        beyond = int((np.abs(values) > RESIDUAL_LIMIT).sum())
        mean = f"{round(values.mean(), 2) + 0.0:+.2f}".replace("-", "−")
        text = f"mean {mean} σ, std {values.std():.2f} σ" + (f", {beyond} beyond ±5 σ" if beyond else "")
        over_time.set_title(text, fontweight="normal", fontsize=9.5, loc="right")
        histogram.hist(
            inside,
            bins=np.linspace(-RESIDUAL_LIMIT, RESIDUAL_LIMIT, 41),
            density=True,
            color=look.colour,
            alpha=0.55,
        )
        histogram.plot(
            grid, np.exp(-(grid**2) / 2) / math.sqrt(2 * math.pi), color=style.TRUTH, linewidth=1.1
        )
        histogram.set_ylabel("density [1/σ]")
        step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
        lags = max(1, round(ACF_LAG_S / step))
        acf = autocorrelation(values, lags)[1:]
        limit = 1.96 / math.sqrt(len(values))
        correlation.axhspan(-limit, limit, color=style.BAND_OF_TRUTH, alpha=0.8, linewidth=0)
        correlation.axhline(0, color=style.TRUTH, linewidth=0.9)
        places = step * np.arange(1, len(acf) + 1)
        correlation.vlines(places, 0, acf, color=look.colour, linewidth=2.2)
        reach = max(0.15, 1.2 * float(np.nanmax(np.abs(acf), initial=0.0)))
        correlation.set_ylim(-reach, reach)
        correlation.set_ylabel("autocorr. [–]")
    panels[0, 0].set_title("residual over time", loc="left")
    panels[0, 1].set_title("distribution")
    panels[0, 2].set_title("autocorrelation")
    panels[-1, 0].set_xlabel("time [min]")
    panels[-1, 1].set_xlabel("residual [σ]")
    panels[-1, 2].set_xlabel("lag [s]")
    handles = [
        Line2D(
            [],
            [],
            color=look.colour,
            marker=".",
            linestyle="none",
            label=f"{look.label}: measured − predicted",
        ),
        Line2D([], [], color=style.TRUTH, label="standard normal"),
        Line2D([], [], color=style.BAND_OF_TRUTH, linewidth=8, label="±2 σ; 95 % range of white noise"),
    ]
    figure.legend(handles=handles, loc="upper center", ncols=len(handles))
    slug = style.slug(method.method)
    title = f"Residuals of {look.label}"
    return style.ReportFigure(f"residuals_{slug}", title, _verdict(look.label, found), figure, kind="png")


def _verdict(label: str, found: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]) -> str:
    """What the residuals say, in words."""
    sentences = []
    for kind, columns in odd_channels(found).items():
        if columns:
            names = [symbol.name if (symbol := quantities.known(c)) else c for c in columns]
            sentences.append(captions.ODD[kind].format(channels=", ".join(names)))
    return f"Measured minus predicted of {label}. " + " ".join(sentences or [captions.WHITE])
