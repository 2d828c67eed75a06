"""Errors of operators, bodies and maps beside the paper's printed numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from dieseltwin.paper.printed import BODY_ERRORS, operator_errors
from dieseltwin.report import captions, quantities, style
from dieseltwin.report.results import Results, number
from dieseltwin.report.segment_axis import WIDTH_IN

OURS = {"": "#0072B2", "train": "#0072B2", "held_out": "#56B4E9", "test": "#56B4E9", "pod_floor": "#5c5c5c"}
WORDS = {
    "train": "training",
    "held_out": "held-out minutes",
    "test": "test",
    "pod_floor": "POD floor",
    "paper": "as printed",
}
# one series of marks: label, values by row [%], colour, marker, filled
Series = list[tuple[str, Mapping[str, Any], str, str, bool]]
# printed numbers of one kind: label, (mean, std) by row [%]
Printed = list[tuple[str, Mapping[str, tuple[float, float]]]]
KINDS = ("", "train", "held_out", "test", "pod_floor")
VARIANTS = ("", "paper", "conditioned", "improved")
VARIANT_COLOURS = ("#D55E00", "#0072B2", "#009E73")
ROWS = ("u_egr1", "u_egr2", "u_vgt", "p_im", "p_em", "x_r", "T_1", "omega_t",
        "eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c")  # fmt: skip
_MARKERS = ("o", "s", "^", "D", "v")

PRETRAINING = captions.line("""
    Relative L2 errors of the learned parts: marks are this run, grey bars with a whisker (one std) the paper's printed
    numbers. POD floor: what as many fixed shapes, taken straight from the training minutes (singular vectors), reach
    on the held-out minutes; a good body comes near it or below. Floor and held-out errors are taken before the output
    transformation, training errors are those of the states.
""")


def _error_panel(axes: Axes, rows: Sequence[str], series: Series, printed: Printed) -> None:
    """Our errors as marks and the printed ones as bars on a logarithmic axis, one row per output."""
    smallest, largest = [0.5], [2.0]
    shades = (style.PAPER, "#8f8f8f")
    height = 0.8 / max(1, len(printed))
    for order, (label, values) in enumerate(printed):
        for place, row in enumerate(rows):
            if row in values:
                mean, std = values[row]
                y = place - 0.4 + height * (order + 0.5)
                axes.barh(
                    y,
                    mean,
                    height=0.85 * height,
                    color=shades[order % 2],
                    xerr=std,
                    error_kw={"ecolor": "#666666", "lw": 1},
                    label=label if place == 0 else None,
                    left=0,
                )
                smallest.append(mean)
                largest.append(mean + std)
    for order, (label, values, colour, marker, filled) in enumerate(series):
        points = [(number(values.get(row)), place) for place, row in enumerate(rows)]
        points = [(x, y) for x, y in points if math.isfinite(x) and x > 0]
        if not points:
            continue
        spread = 0.0 if len(series) == 1 else min(0.5, 0.2 * len(series)) * (order / (len(series) - 1) - 0.5)
        axes.plot(
            [x for x, _ in points],
            [y + spread for _, y in points],
            marker,
            color=colour,
            linestyle="none",
            markersize=7,
            markerfacecolor=colour if filled else "white",
            label=label,
            zorder=4,
        )
        smallest += [x for x, _ in points]
        largest += [x for x, _ in points]
    axes.set_xscale("log")
    axes.set_xlim(min(smallest) / 2, 2 * max(largest))
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(rows)), [quantities.symbol(_row_symbol(row)) for row in rows], fontsize=11)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(False, axis="y")
    axes.set_xlabel("relative $L_2$ error [%], logarithmic")
    axes.set_ylabel("output")


def _row_symbol(row: str) -> str:
    return "u_vgt_act" if row == "u_vgt" else row


def _variants(entry: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Split ``{"paper": {...}, "improved": {...}}`` from a plain ``{"p_im": {...}}``."""
    nested = {
        k: v for k, v in entry.items() if isinstance(v, Mapping) and k in ("paper", "improved", "conditioned")
    }
    return nested or {"": entry}


def _series(entry: Mapping[str, Any]) -> tuple[list[str], Series]:
    """Rows and series of one group; a value is a number [%] or a mapping of kinds (train, test, held_out, ..)."""
    series: dict[tuple[str, str], dict[str, Any]] = {}
    for variant, values in _variants(entry).items():
        for row, value in values.items():
            for kind, error in (value if isinstance(value, Mapping) else {"": value}).items():
                if kind in KINDS:
                    # the floor belongs to the width, not to the kind of body: shown once
                    key = ("", kind) if kind == "pod_floor" else (variant, kind)
                    series.setdefault(key, {})[row] = error
    # files may come in any order: the same order in every report
    rows = sorted({row for values in series.values() for row in values}, key=_place(ROWS))
    variants = sorted({variant for variant, kind in series if kind != "pod_floor"}, key=_place(VARIANTS))
    single = len({kind for _, kind in series}) == 1
    found: Series = []
    place = _place(VARIANTS)
    order = sorted(series, key=lambda key: (key[1] == "pod_floor", place(key[0]), KINDS.index(key[1])))
    for variant, kind in order:
        index = variants.index(variant) if variant in variants else len(_MARKERS) - 1
        name = (
            ", ".join(part for part in (WORDS.get(variant, variant), WORDS.get(kind, kind)) if part)
            or "error"
        )
        colour = VARIANT_COLOURS[index % len(VARIANT_COLOURS)] if single else OURS[kind]
        found.append(
            (name, series[variant, kind], colour, _MARKERS[index % len(_MARKERS)], kind != "pod_floor")
        )
    return rows, found


def _place(order: Sequence[str]) -> Callable[[str], tuple[int, str]]:
    """Sort key: known names in their order, the others behind by name."""
    return lambda name: (order.index(name) if name in order else len(order), name)


@style.styled
def pretraining(results: Results) -> style.ReportFigure | None:
    """Errors of operators, bodies and maps beside the paper's printed numbers. None where nothing was pretrained."""
    operators: Printed = [("paper, training", operator_errors("train")), ("paper, test", operator_errors("test"))]
    groups: dict[str, tuple[str, Printed]] = {
        "operators": ("Actuator operators (DeepONets)", operators),
        "bodies": ("Multi-head bodies", [("paper, training", BODY_ERRORS)]),
        "maps": ("Empirical maps (the paper prints no error)", []),
    }
    present = [(key, *_series(results.pretraining[key])) for key in groups if results.pretraining.get(key)]
    present = [(key, rows, series) for key, rows, series in present if rows]
    if not present:
        return None
    heights = [0.55 * len(rows) + 1.0 for _, rows, _ in present]
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.3))
    panels = np.atleast_1d(figure.subplots(len(present), 1, height_ratios=heights))
    for axes, (key, rows, series) in zip(panels, present, strict=True):
        title, printed = groups[key]
        _error_panel(axes, rows, series, printed)
        axes.set_title(title)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))
    return style.ReportFigure("pretraining", "Pretraining errors", PRETRAINING, figure)
