"""Figures of a score: detection over size, receiver operating characteristic, confusion of names, magnitudes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.challenge.metrics import COVERAGE_Z, Share, nameable
from dieseltwin.challenge.plant_effects import FAMILIES
from dieseltwin.challenge.records import COUNTED_RATIO, CaseRow
from dieseltwin.discovery.verdict.document import NONE_OF_THESE

_BLUE, _RED, _GREY, _GREEN = "#1f5a92", "#b3392f", "#8a8f98", "#3b7d3b"
_BINS = np.array([1.0, 1.5, 2.2, 3.0, 4.5, 6.7, 10.01])


def write_figures(rows: Sequence[CaseRow], folder: Path) -> list[Path]:
    """Write every figure that the rows allow; returns the files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    made = []
    for name, draw, size in (
        ("detection_over_size", _detection, (6.4, 4.0)), ("p_values", _roc, (5.0, 4.4)),
        ("names_confusion", _confusion, (11.0, 10.0)), ("magnitudes", _magnitudes, (5.4, 4.8)),
    ):  # fmt: skip
        figure = Figure(figsize=size, layout="constrained")
        if draw(figure, rows):
            figure.savefig(folder / f"{name}.png", dpi=150)
            made.append(folder / f"{name}.png")
    return made


def _detection(figure: Any, rows: Sequence[CaseRow]) -> bool:
    faulty = [row for row in rows if row.truth]
    if not faulty:
        return False
    axes = figure.add_subplot()
    ratios = np.array([row.ratio for row in faulty])
    for label, colour, hit, shift in (
        ("mismatch reported", _BLUE, [row.mismatch for row in faulty], 0.97),
        ("site right", _GREEN, [row.site in {e.site for e in row.truth} for row in faulty], 1.03),
    ):
        at, low, middle, high = [], [], [], []
        for a, b in pairwise(_BINS):
            inside = (ratios >= a) & (ratios < b)
            share = Share(int(np.array(hit)[inside].sum()), int(inside.sum()))
            if share.value is not None:
                at.append(np.sqrt(a * b) * shift)
                middle.append(share.value)
                low.append(share.value - share.interval[0])
                high.append(share.interval[1] - share.value)
        axes.errorbar(at, middle, yerr=[low, high], fmt="o-", color=colour, capsize=3, lw=1.2, ms=4, label=label)
    axes.axvline(COUNTED_RATIO, color=_GREY, lw=0.8, ls="--")
    axes.text(COUNTED_RATIO * 1.02, 0.03, "counted from here", color=_GREY, fontsize=8)
    axes.set_xscale("log")
    axes.set_xticks([1, 2, 3, 5, 10], ["1", "2", "3", "5", "10"])
    axes.minorticks_off()
    axes.set(xlabel="magnitude / tolerance [-]", ylabel="share of cases [-]", ylim=(0.0, 1.04))
    axes.set_title(f"{len(faulty)} faulty machines, 95 % intervals", fontsize=10)
    axes.legend(loc="lower right", frameon=False, fontsize=9)
    return True


def _roc(figure: Any, rows: Sequence[CaseRow]) -> bool:
    healthy = np.array([row.p_value for row in rows if not row.truth and row.p_value is not None])
    faulty = np.array([row.p_value for row in rows if row.truth and row.p_value is not None])
    counted = np.array([r.p_value for r in rows if r.ratio >= COUNTED_RATIO and r.p_value is not None])
    if not healthy.size or not faulty.size:
        return False
    axes = figure.add_subplot()
    for values, label, colour in ((counted, "at least 3 x tolerance", _BLUE), (faulty, "all faulty machines", _GREY)):
        if not values.size:
            continue
        levels = np.unique(np.r_[0.0, healthy, values, 1.0])
        axes.step([np.mean(healthy <= p) for p in levels], [np.mean(values <= p) for p in levels], where="post",
                  color=colour, label=f"{label} ({values.size})")  # fmt: skip
    axes.plot([0, 1], [0, 1], color=_GREY, lw=0.6, ls=":")
    at = [np.array([row.mismatch for row in among], dtype=float).mean() for among in (
        [row for row in rows if not row.truth], [row for row in rows if row.ratio >= COUNTED_RATIO]
    )]  # fmt: skip
    axes.plot(*at, "o", color=_RED, ms=6, label="as reported")
    axes.set(xlabel=f"false alarms, share of {healthy.size} healthy [-]", ylabel="detected [-]", xlim=(-0.02, 1.0),
             ylim=(0.0, 1.02))  # fmt: skip
    axes.legend(loc="lower right", frameon=False, fontsize=9)
    return True


def _confusion(figure: Any, rows: Sequence[CaseRow]) -> bool:
    single = [r for r in rows if len(r.truth) == 1 and r.ratio >= COUNTED_RATIO and r.problem is None]
    if not single:
        return False
    names = [name for name in FAMILIES if any(r.truth[0].name == name for r in single)]
    # a withheld effect may not come back under its own name: `none of these` is right there, and a row of its own
    truths = [n for n in names if any(r.truth[0].name == n and not r.withheld for r in single)]
    withheld = [n for n in names if any(r.truth[0].name == n and r.withheld for r in single)]
    said = [n for n in FAMILIES if n in truths or any(r.said and r.said[0].name == n for r in single)]
    columns = [*said, NONE_OF_THESE, "nothing"]
    labels = [*truths, *(f"({n})" for n in withheld)]
    counts = np.zeros((len(labels), len(columns)))
    for row in single:
        label = f"({row.truth[0].name})" if row.withheld else row.truth[0].name
        name = row.said[0].name if row.said else "nothing"
        if name in columns:
            counts[labels.index(label), columns.index(name)] += 1
    axes = figure.add_subplot()
    axes.imshow(np.where(counts > 0, counts, np.nan), cmap="Blues", vmin=0, vmax=max(counts.max(), 4), aspect="auto")
    for i, j in np.argwhere(counts > 0):
        right = columns[j] == (NONE_OF_THESE if labels[i].startswith("(") else labels[i])
        dark = counts[i, j] > 0.6 * max(counts.max(), 4)
        colour = "white" if dark else ("black" if right else _RED)
        axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", color=colour, fontsize=9,
                  fontweight="normal" if right else "bold")  # fmt: skip
    axes.set_xticks(range(len(columns)), [_words(c) for c in columns], rotation=60, ha="right", fontsize=8)
    axes.set_yticks(range(len(labels)), [_words(name) for name in labels], fontsize=8)
    axes.set_xticks(np.arange(len(columns)) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(labels)) + 0.5, minor=True)
    axes.grid(which="minor", color="#e3e6ea", lw=0.6)
    axes.tick_params(which="minor", length=0)
    axes.set(xlabel="reported first", ylabel="true, (withheld from the tool)")
    axes.set_title(f"{len(single)} single faults of at least 3 x tolerance; wrong in red", fontsize=10)
    return True


def _words(name: str) -> str:
    return name.replace("_", " ")


def _magnitudes(figure: Any, rows: Sequence[CaseRow]) -> bool:
    points = []
    for row in nameable(rows):
        for effect in row.truth:
            for one in row.said:
                if one.name == effect.name and one.magnitude is not None:
                    tolerance = FAMILIES[effect.name].tolerance
                    sign = np.sign(effect.magnitude)
                    std = 0.0 if one.std is None else one.std / tolerance
                    points.append((effect.ratio, sign * one.magnitude / tolerance, std, len(row.truth) > 1))
    if not points:
        return False
    true, found, spread, two = (np.array(column) for column in zip(*points, strict=True))
    axes = figure.add_subplot()
    for among, colour, label in ((~two, _BLUE, "one fault"), (two, _RED, "one of two")):
        if among.any():
            axes.errorbar(true[among], np.maximum(found[among], 0.05), yerr=COVERAGE_Z * spread[among], fmt="o", ms=3.5,
                          lw=0.7, color=colour, alpha=0.8, label=f"{label} ({among.sum()})")  # fmt: skip
    ends = np.array([0.9, 11.0])
    axes.plot(ends, ends, color=_GREY, lw=0.8)
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=(0.3, 30.0))
    axes.set_xticks([1, 2, 3, 5, 10], ["1", "2", "3", "5", "10"])
    axes.set_yticks([0.3, 1, 3, 10, 30], ["0.3", "1", "3", "10", "30"])
    axes.minorticks_off()
    axes.set(xlabel="true magnitude / tolerance [-]", ylabel="found magnitude / tolerance [-], 90 % interval")
    axes.legend(loc="upper left", frameon=False, fontsize=9)
    return True
