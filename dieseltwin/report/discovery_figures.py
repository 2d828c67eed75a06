"""Figures of a discovery: what could be seen, evidence, candidates, law, health parameters, score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import Candidate, Curves, Discovery
from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.discovery.verdict.when import clock, moments
from dieseltwin.least_squares import Z_90
from dieseltwin.report import discovery_captions as captions
from dieseltwin.report import quantities, style
from dieseltwin.report.discovery_words import display_unit, magnitude_words, unit_of
from dieseltwin.report.segment_axis import WIDTH_IN
from dieseltwin.report.style import AFTER, BEFORE, LIGHT
from dieseltwin.report.visible_words import bias_words

DROPPED = "#b8b8b8"
MOST_CANDIDATES = 14
CELLS = 10  # of an operating map along each axis
MAPS = (("n_e_rpm", "u_delta_mg"), ("u_egr_pct", "u_vgt_pct"))


def edges_of(values: Array, cells: int = CELLS) -> Array:
    """Edges of `cells` equal cells over the visited range, (cells + 1,)."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high <= low:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, cells + 1)


def cell_means(x: Array, y: Array, values: Array, edges: tuple[Array, Array], least: int = 3) -> tuple[Array, Array]:
    """Means of `values` over the cells of a map, and counts, both (cells of y, cells of x); NaN below `least` rows."""
    kept = np.isfinite(x) & np.isfinite(y) & np.isfinite(values)
    bins = [edges[0], edges[1]]
    count, _, _ = np.histogram2d(x[kept], y[kept], bins=bins)
    total, _, _ = np.histogram2d(x[kept], y[kept], bins=bins, weights=values[kept])
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(count >= least, total / count, np.nan)
    return mean.T, count.T


@style.styled
def minimum_detectable(found: Discovery) -> style.ReportFigure | None:
    """Smallest visible size of each effect over its tolerance."""
    curves = found.curves
    known = {n: v for n, v in found.document.minimum_detectable.items() if curves.tolerance.get(n)}
    if not known:
        return None
    ratios = sorted(((v / curves.tolerance[n], n) for n, v in known.items()), reverse=True)
    figure = Figure(figsize=(WIDTH_IN, 0.26 * len(ratios) + 1.5))
    axes = figure.subplots()
    for place, (ratio, name) in enumerate(ratios):
        colour = AFTER if ratio <= 1.0 else BEFORE
        axes.plot(ratio, place, "o", color=colour, markersize=6.5)
        unit = curves.units.get(name) or unit_of(name)
        size = magnitude_words(name, known[name], None, unit, extra=False, digits=2)
        moved = [f"({words})" for words in bias_words(found.document.health_bias, name)[:1]]
        label = axes.text(ratio * 1.12, place, " ".join([size, *moved]), va="center", fontsize=8.5)
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1.0})
    axes.axvline(1.0, color=style.TRUTH, linestyle="--", linewidth=1.1)
    axes.set_xscale("log")
    values = [ratio for ratio, _ in ratios]
    axes.set_xlim(0.6 * min(*values, 1.0), 8.0 * max(*values, 1.0))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(ratios)), [name for _, name in ratios])
    axes.set_ylim(-0.7, len(ratios) - 0.3)
    axes.set_xlabel("smallest visible size over tolerance [–], logarithmic")
    handles = [
        Line2D([], [], marker="o", linestyle="none", color=AFTER, label="visible below its tolerance"),
        Line2D([], [], marker="o", linestyle="none", color=BEFORE, label="visible only above its tolerance"),
        Line2D([], [], linestyle="--", color=style.TRUTH, label="tolerance"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return style.ReportFigure("minimum_detectable", "What this recording could show at all", captions.MINIMUM, figure)


def _held_out_spans(curves: Curves) -> list[tuple[float, float]]:
    if curves.held_out is None or not np.any(curves.held_out):
        return []
    mask = np.r_[False, np.asarray(curves.held_out, dtype=bool), False].astype(np.int8)
    starts, ends = np.flatnonzero(np.diff(mask) == 1), np.flatnonzero(np.diff(mask) == -1) - 1
    return [(float(curves.time_s[a]), float(curves.time_s[b])) for a, b in zip(starts, ends, strict=True)]


@style.styled
def evidence_time(found: Discovery) -> style.ReportFigure | None:
    """Evidence of each window and its sum, over time; none where nothing was found."""
    curves, location = found.curves, found.document.location
    if not found.document.mismatch:
        return None
    middle, gain = curves.evidence_over_time
    figure = Figure(figsize=(WIDTH_IN, 3.9))
    axes = figure.subplots()
    for low, high in _held_out_spans(curves):
        axes.axvspan(low, high, color="#ececec", linewidth=0, zorder=0)
    width = float(np.median(np.diff(middle))) if middle.size > 1 else 10.0
    axes.bar(middle, gain, width=0.9 * width, color=np.where(gain >= 0, LIGHT, DROPPED), linewidth=0)
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"log-likelihood gained\nin {width:.3g} s [–]")
    total = axes.twinx()
    total.plot(middle, np.cumsum(np.nan_to_num(gain)), color=AFTER, linewidth=1.8)
    total.set_ylabel("sum so far [–]", color=AFTER)
    total.spines["right"].set_visible(True)
    total.tick_params(axis="y", colors=AFTER)
    total.grid(False)
    _same_zero(axes, total)
    handles: list[Patch | Line2D] = [
        Patch(color=LIGHT, label=f"gained in {width:.3g} s"),
        Line2D([], [], color=AFTER, linewidth=1.8, label="sum so far (right axis)"),
    ]
    if _held_out_spans(curves):
        handles.append(Patch(color="#ececec", label="held out"))
    for name, at in moments(location):
        dashes = "--" if name == "onset" else ":"
        axes.axvline(curves.start_s + at, color=BEFORE, linestyle=dashes)
        handles.append(Line2D([], [], color=BEFORE, linestyle=dashes, label=f"{name}, {clock(at)}"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return style.ReportFigure("evidence_time", "Evidence over time", captions.EVIDENCE_TIME, figure)


def _same_zero(left: Axes, right: Axes) -> None:
    """Shift the limits of two axes so that their zeros lie side by side."""
    shares = []
    for axes in (left, right):
        low, high = axes.get_ylim()
        low, high = min(low, 0.0), max(high, 0.0)
        shares.append(-low / (high - low) if high > low else 0.0)
    share = min(max(shares), 0.9)
    for axes in (left, right):
        low, high = axes.get_ylim()
        high = max(high, -low * (1.0 - share) / share if share > 0.0 else high, 1e-12)
        axes.set_ylim(-high * share / (1.0 - share), high)


@style.styled
def evidence_maps(found: Discovery) -> style.ReportFigure | None:
    """Mean evidence per sample over speed and load, and over the two actuators."""
    curves, location = found.curves, found.document.location
    pairs = [pair for pair in MAPS if all(name in curves.evidence_map for name in pair)]
    if not pairs or not found.document.mismatch:
        return None
    figure = Figure(figsize=(WIDTH_IN, 4.0))
    panels = np.atleast_1d(figure.subplots(1, len(pairs)))
    grids = []
    for x_name, y_name in pairs:
        x, y = curves.evidence_map[x_name], curves.evidence_map[y_name]
        edges = (edges_of(x), edges_of(y))
        grids.append((edges, cell_means(x, y, curves.evidence, edges)[0]))
    largest = _symmetric([grid for _, grid in grids])
    image: Any = None
    for axes, (x_name, y_name), (edges, grid) in zip(panels, pairs, grids, strict=True):
        image = axes.pcolormesh(*edges, grid, cmap="RdBu_r", vmin=-largest, vmax=largest)
        axes.grid(False)
        axes.set_xlabel(quantities.axis_label(x_name))
        axes.set_ylabel(quantities.axis_label(y_name))
        for region in location.regions if location is not None else ():
            (left, right), (low, high) = getattr(region, x_name), getattr(region, y_name)
            left, right = max(left, edges[0][0]), min(right, edges[0][-1])
            low, high = max(low, edges[1][0]), min(high, edges[1][-1])
            box = Rectangle((left, low), right - left, high - low, fill=False, edgecolor="black", linewidth=1.6)
            axes.add_patch(box)
            axes.annotate(f"{100 * region.share_of_evidence:.0f} %", (left, high), xytext=(3, -11),
                          textcoords="offset points", fontsize=9, fontweight="bold")
    figure.colorbar(image, ax=list(panels), label="log-likelihood gained per sample [–]")
    return style.ReportFigure("evidence_map", "Evidence over the operating map", captions.EVIDENCE_MAP, figure)


def _symmetric(grids: Sequence[Array]) -> float:
    values = np.abs(np.concatenate([grid[np.isfinite(grid)] for grid in grids] or [np.array([1.0])]))
    return float(np.quantile(values, 0.98)) if values.size and values.max() > 0 else 1.0


@style.styled
def law_curves(found: Discovery) -> style.ReportFigure | None:
    """Each found term over its main argument, with band and points."""
    laws = list(found.curves.laws)
    if not laws:
        return None
    figure = Figure(figsize=(WIDTH_IN if len(laws) > 1 else 0.72 * WIDTH_IN, 4.2))
    panels = np.atleast_1d(figure.subplots(1, len(laws)))
    for axes, law in zip(panels, laws, strict=True):
        unit, scale = display_unit(law["name"], law["unit"])
        low, high = scale * np.asarray(law["low"]), scale * np.asarray(law["high"])
        x, points_x = quantities.shown(law["x_name"], law["x"]), quantities.shown(law["x_name"], law["points_x"])
        axes.fill_between(x, low, high, color=AFTER, alpha=0.22, linewidth=0, label="90 % band")
        axes.plot(x, scale * np.asarray(law["curve"]), color=AFTER, linewidth=2.0, label="law")
        bars = law.get("points_std")
        axes.errorbar(points_x, scale * np.asarray(law["points_y"]),
                      yerr=None if bars is None else scale * np.asarray(bars), fmt="o", color="#444444",
                      markersize=4.5, linewidth=1.0, label="freed in bins")  # fmt: skip
        axes.axhline(0.0, color="#777777", linewidth=0.8)
        axes.set_xlabel(_axis(law["x_name"]))
        axes.set_ylabel(f"{_quantity(found, law['name'])} [{unit or '–'}]")
        axes.legend(loc="best")
    return style.ReportFigure("law", "The found law", captions.LAW, figure)


def _quantity(found: Discovery, name: str) -> str:
    """What a law's curve is: the effect, or, of a law without a name, what stands before its formula."""
    said = next((e.law for e in found.document.effects if e.name == name == NONE_OF_THESE and e.law), "")
    quantity, colon, _ = said.partition(":")
    return quantity if colon else name


def _axis(name: str) -> str:
    if quantities.known(name) is not None:
        return quantities.axis_label(name)
    parts = [quantities.symbol(part) if quantities.known(part) else part for part in name.split("/")]
    return "/".join(parts) if "[" in name else "/".join(parts) + (" [–]" if len(parts) == 2 else "")


@style.styled
def health(found: Discovery) -> style.ReportFigure | None:
    """Health parameters before and after, with intervals."""
    entries = found.document.health
    if not entries:
        return None
    figure = Figure(figsize=(WIDTH_IN, 3.6))
    panels = np.atleast_1d(figure.subplots(1, len(entries)))
    mismatch = found.document.mismatch
    for axes, (name, entry) in zip(panels, entries.items(), strict=True):
        scale = quantities.factor(name)
        value, before = entry.value * scale, entry.before * scale
        half = Z_90 * (0.0 if entry.std is None else entry.std) * scale
        axes.errorbar([1], [value], yerr=[half], fmt="o", color=AFTER, capsize=5, markersize=8)
        title = quantities.symbol(name)
        if mismatch:
            axes.plot([0], [before], "o", markerfacecolor="white", color=BEFORE, markersize=8, markeredgewidth=1.8)
            axes.annotate("", (0.9, value), (0.1, before), arrowprops={"arrowstyle": "->", "color": "#777777"})
            title += f", before {quantities.percent(before / value - 1.0, signed=True)}" if value else ""
        axes.set_title(title, fontweight="normal", fontsize=10.5)
        axes.set_xticks([0, 1] if mismatch else [1], ["before", "after"] if mismatch else ["fit"])
        axes.set_xlim(-0.5, 1.5)
        span = max(abs(value - before) if mismatch else 0.0, half, 1e-3 * abs(value), 1e-12)
        axes.set_ylim(min(value, before) - 1.2 * span, max(value, before) + 1.2 * span)
        axes.set_ylabel(f"[{quantities.unit(name) or '–'}]")
    words = captions.HEALTH if mismatch else captions.HEALTH_HEALTHY
    title = "Health parameters before and after" if mismatch else "Health parameters"
    return style.ReportFigure("health", title, words, figure)


@style.styled
def score(found: Discovery) -> style.ReportFigure:
    """Held-out score before and after; residuals per channel over noise."""
    fit, curves = found.document.fit, found.curves
    figure = Figure(figsize=(WIDTH_IN, 3.6))
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.4))
    bars = [("before", fit.held_out_nll_before, BEFORE), ("after", fit.held_out_nll_after, AFTER)]
    known = [(name, value, colour) for name, value, colour in bars if value is not None and math.isfinite(value)]
    if known:
        values = [value for _, value, _ in known]
        span = max(max(values) - min(values), 1e-3 * max(abs(v) for v in values), 1e-9)
        for place, (_, value, colour) in enumerate(known):
            left.plot(place, value, "o", color=colour, markersize=10)
            left.annotate(f"{value:.{3 if span > 0.01 else 5}f}", (place, value), xytext=(0, 9),
                          textcoords="offset points", ha="center", fontsize=9.5)
        left.set_xticks(range(len(known)), [name for name, _, _ in known])
        left.set_xlim(-0.6, len(known) - 0.4)
        left.set_ylim(min(values) - 0.3 * span, max(values) + 0.4 * span)
    else:
        style.note(left, "nothing was held out")
    left.set_ylabel("held-out negative\nlog-likelihood per sample [–]")
    sigma = dict(zip(curves.channels, curves.sigma, strict=True))
    names = [name for name in fit.rmse_after if sigma.get(name)]
    pairs = ((-0.19, fit.rmse_before, BEFORE, "before"), (0.19, fit.rmse_after, AFTER, "after"))
    for place, name in enumerate(names):
        for offset, table, colour, label in pairs:
            if name in table:
                right.bar(place + offset, table[name] / sigma[name], width=0.36, color=colour,
                          label=label if place == 0 else None)
    right.axhline(1.0, color=style.TRUTH, linestyle="--", linewidth=1.0, label="noise alone")
    right.set_xticks(range(len(names)), [quantities.symbol(name) for name in names])
    right.set_ylabel("rms residual over noise [–]")
    right.grid(False, axis="x")
    figure.legend(*right.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return style.ReportFigure("score", "Held-out score and residuals per channel", captions.SCORE, figure)


def candidate_colour(found: Discovery, name: str) -> str:
    """Colour of a candidate: reported, equivalent, dropped."""
    reported = [effect.name for effect in found.document.effects]
    equivalent = [other for effect in found.document.effects for other in effect.equivalent_names]
    return AFTER if name in reported else (LIGHT if name in equivalent else DROPPED)


@style.styled
def candidates(found: Discovery) -> style.ReportFigure | None:
    """Log-likelihood gain of the strongest candidates."""
    rows: list[tuple[Candidate, float]] = []
    for candidate in found.curves.candidates:
        gain = candidate["log_likelihood_gain"]
        if gain is not None and math.isfinite(gain) and gain > 0.0:
            rows.append((candidate, gain))
    rows = sorted(rows, key=lambda row: -row[1])[:MOST_CANDIDATES]
    if not rows:
        return None
    figure = Figure(figsize=(WIDTH_IN, 0.34 * len(rows) + 1.5))
    axes = figure.subplots()
    best = rows[0][1]
    start = 0.5 * min(gain for _, gain in rows)
    for place, (candidate, gain) in enumerate(rows):
        axes.plot([start, gain], [place, place], color=candidate_colour(found, candidate["name"]), linewidth=9,
                  solid_capstyle="butt")
        size = candidate["magnitude"]
        text = f"{gain:.1f}" if place == 0 else f"{gain:.1f}, {best - gain:.1f} behind"
        if size is not None:
            unit = found.curves.units.get(candidate["name"]) or unit_of(candidate["name"])
            text += "   " + magnitude_words(candidate["name"], size, candidate["std"], unit, extra=False)
        axes.text(gain * 1.06, place, text, va="center", fontsize=9)
    axes.set_xscale("log")
    axes.set_xlim(start, best * (best / start) ** 0.65 * 1.5)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(rows)), [candidate["name"] for candidate, _ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(False, axis="y")
    axes.set_xlabel("log-likelihood gained over the health parameters alone [–], logarithmic")
    handles = [Patch(color=AFTER, label="reported"), Patch(color=LIGHT, label="cannot be told apart"),
               Patch(color=DROPPED, label="dropped")]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    words = captions.CANDIDATES.format(apart=f"{0.5 * found.details['equivalent_gain']:g}")
    return style.ReportFigure("candidates", "What was weighed", words, figure)
