"""Residual structure before and after a repair: averaged over stretches of time and over cells of the operating map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import Curves, Discovery
from dieseltwin.discovery.verdict.when import moments
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.report import discovery_captions as captions
from dieseltwin.report import quantities, style
from dieseltwin.report.discovery_figures import MAPS, cell_means, edges_of
from dieseltwin.report.segment_axis import WIDTH_IN
from dieseltwin.report.style import AFTER, BEFORE

STRETCHES = 60  # of the whole recording: wide enough to average noise away, short enough to show driving
LEAST_STRETCH_S = 5.0
CELLS = 8
LEAST_ROWS = 10  # of a cell; the mean of fewer is noise
Z_95 = 1.96
MARGINS_IN, GAPS_IN = (0.65, 0.9, 0.55, 0.3), (0.2, 0.35)
BAR_IN = (0.15, 0.15)  # of the maps' colours: its distance and its width
SMALLEST_SCALE = 4.0  # of the maps' colours: less would paint chance in strong colours


def _standardised(curves: Curves) -> tuple[Array, Array]:
    """(n, C) residuals before and after over the noise, less what the tolerances explain beside the repaired fit."""
    allowed = 0.0 if curves.allowed is None else curves.allowed
    before, after = curves.measured - curves.before - allowed, curves.measured - curves.after - allowed
    return before / curves.sigma, after / curves.sigma


def noise_of_means(curves: Curves) -> Array:
    """Factor (C,) by which the correlation of the noise widens the mean of many samples, sqrt((1 + rho)/(1 - rho))."""
    rho = np.clip(np.nan_to_num(estimate_noise(curves.measured).rho), 0.0, 0.9)
    return np.sqrt((1.0 + rho) / (1.0 - rho))


def _binned(time_s: Array, values: Array, edges: Array) -> tuple[Array, Array]:
    kept = np.isfinite(values)
    place = np.clip(np.searchsorted(edges, time_s[kept], side="right") - 1, 0, edges.size - 2)
    count = np.bincount(place, minlength=edges.size - 1)
    total = np.bincount(place, weights=values[kept], minlength=edges.size - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, total / count, np.nan), count.astype(np.float64)


@style.styled
def residual_time(found: Discovery) -> style.ReportFigure:
    """Averaged residuals over time, one panel a channel."""
    curves = found.curves
    duration = float(curves.time_s[-1] - curves.time_s[0])
    width = max(duration / STRETCHES, LEAST_STRETCH_S)
    edges = curves.time_s[0] + np.arange(0.0, duration + width, width)
    edges[-1] = max(edges[-1], curves.time_s[-1])
    middle = 0.5 * (edges[:-1] + edges[1:])
    mismatch = found.document.mismatch
    before, after = _standardised(curves)
    widening = noise_of_means(curves)
    figure = Figure(figsize=(WIDTH_IN, 1.35 * len(curves.channels) + 0.9))
    panels = np.atleast_1d(figure.subplots(len(curves.channels), 1, sharex=True))
    for j, (axes, name) in enumerate(zip(panels, curves.channels, strict=True)):
        mean_before, count = _binned(curves.time_s, before[:, j], edges)
        mean_after, _ = _binned(curves.time_s, after[:, j], edges)
        band = np.where(count > 0, Z_95 * widening[j] / np.sqrt(np.maximum(count, 1)), np.nan)
        axes.fill_between(middle, -band, band, step="mid", color="#e2e2e2", linewidth=0)
        if mismatch:
            axes.plot(middle, mean_before, color=BEFORE, linewidth=1.3, marker="o", markersize=3)
        axes.plot(middle, mean_after, color=AFTER, linewidth=1.5, marker="s", markersize=2.6)
        axes.set_ylabel(f"{quantities.symbol(name)} [σ]")
        largest = [np.nanmax(np.abs(mean_before)), np.nanmax(np.abs(mean_after)), 2.0 * np.nanmedian(band)]
        limit = 1.15 * float(max(largest))
        axes.set_ylim(-limit, limit)
    for _, at in moments(found.document.location):
        for axes in panels:
            axes.axvline(curves.start_s + at, color="#333333", linestyle="--", linewidth=1.0)
    panels[-1].set_xlabel("time [s]")
    earlier = Line2D([], [], color=BEFORE, marker="o", markersize=4, label="before (health parameters alone)")
    handles = [
        *([earlier] if mismatch else []),
        Line2D([], [], color=AFTER, marker="s", markersize=4, label="after (repaired)" if mismatch else "fit"),
        Patch(color="#e2e2e2", label="95 % of pure noise"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    words = (captions.RESIDUAL_TIME if mismatch else captions.RESIDUAL_TIME_HEALTHY).format(width=f"{width:.3g}")
    return style.ReportFigure("residual_time", "Residual structure over time", words, figure)


def over_noise(grid: Array, count: Array, widening: float) -> Array:
    """Cell means [σ] over the standard deviation that noise alone gives them, same shape; chance leaves about ±2."""
    return grid * np.sqrt(count) / widening


@style.styled
def residual_map(found: Discovery, pair: tuple[str, str] = MAPS[0]) -> style.ReportFigure | None:
    """Averaged residuals over an operating map, before above after, one column a channel."""
    curves = found.curves
    if any(name not in curves.evidence_map for name in pair):
        return None
    x, y = (curves.evidence_map[name] for name in pair)
    edges = (edges_of(x, CELLS), edges_of(y, CELLS))
    widening = noise_of_means(curves)
    number = len(curves.channels)
    mismatch = found.document.mismatch
    figure = Figure(figsize=(WIDTH_IN, 4.6 if mismatch else 2.7))
    panels = style.grid_of_panels(figure, 1 + mismatch, number, MARGINS_IN, GAPS_IN, sharex=True, sharey=True)
    tables = [
        [over_noise(*cell_means(x, y, values[:, j], edges, LEAST_ROWS), float(widening[j])) for j in range(number)]
        for values in _standardised(curves)[0 if mismatch else 1 :]
    ]
    filled = np.concatenate([grid[np.isfinite(grid)] for row in tables for grid in row])
    largest = max(SMALLEST_SCALE, float(np.quantile(np.abs(filled), 0.98))) if filled.size else SMALLEST_SCALE
    image: Any = None
    for row, label in enumerate(("before", "after") if mismatch else ("fit",)):
        for j, name in enumerate(curves.channels):
            axes = panels[row, j]
            grid = tables[row][j]
            image = axes.pcolormesh(*edges, grid, cmap="RdBu_r", vmin=-largest, vmax=largest)
            axes.grid(False)
            size = float(np.nanmean(grid**2)) if np.isfinite(grid).any() else float("nan")
            axes.set_title(f"{quantities.symbol(name)}, {label}: {size:.1f}", fontsize=9.5, fontweight="normal")
    for axes in panels[:, 0]:
        axes.set_ylabel(quantities.axis_label(pair[1]))
    for axes in panels[-1]:
        axes.set_xlabel(quantities.axis_label(pair[0]))
    lowest, highest = panels[-1, -1].get_position(), panels[0, -1].get_position()
    bar = figure.add_axes((highest.x1 + BAR_IN[0] / WIDTH_IN, lowest.y0, BAR_IN[1] / WIDTH_IN, highest.y1 - lowest.y0))
    figure.colorbar(image, cax=bar, label="mean residual over its noise [–]")
    name = "residual_map" if pair == MAPS[0] else "residual_map_actuators"
    title = "Residual structure over " + ("speed and load" if pair == MAPS[0] else "the actuators")
    words = captions.RESIDUAL_MAP if mismatch else captions.RESIDUAL_MAP_HEALTHY
    return style.ReportFigure(name, title, words, figure)
