"""Panels over time: the channels of a file, and a simulated engine beside its readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dieseltwin.report import quantities, style
from dieseltwin.sensors import MEASURED

MOST_POINTS = 4000  # of a channel: more than a panel has pixels
SHOWN = (*MEASURED, "w_af_kg_s", "torque_nm")
LABELS = {"w_af_kg_s": "$W_{af}$ [kg/s]"}
"""Axes of quantities that other engines than the nomenclature's have."""
WIDTH_IN, PANEL_IN = 9.0, 1.5
LINE = style.AFTER


def extremes(values: NDArray[np.float64], most: int) -> NDArray[np.intp]:
    """Rows (m,) of the lowest and the highest of `values` (n,) in each of most/2 stretches: every spike stays."""
    if values.size <= most:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, most // 2 + 1).astype(np.intp)
    lowest, highest = np.nan_to_num(values, nan=np.inf), np.nan_to_num(values, nan=-np.inf)
    pairs = [(a + lowest[a:b].argmin(), a + highest[a:b].argmax()) for a, b in pairwise(edges)]
    return np.unique(np.array(pairs))


@style.styled
def overview(rows: Sequence[tuple[str, str, np.ndarray | None, np.ndarray]]) -> style.ReportFigure | None:
    """A small panel for every channel, lowest and highest of each stretch where there are more readings than pixels.

    Args:
        rows: our column, the file's name and unit, times (n,) [s] (None where there is no clock), values (n,).
    """
    if not rows:
        return None
    figure = Figure(figsize=(WIDTH_IN, 1.05 * len(rows) + 0.4))
    panels = np.atleast_1d(figure.subplots(len(rows), 1, sharex=len({row[2] is None for row in rows}) == 1))
    for axes, (column, name, time_s, values) in zip(panels, rows, strict=True):
        x = np.arange(values.size, dtype=np.float64) if time_s is None else time_s - time_s[0]
        there = np.isfinite(values)
        kept = extremes(values[there], MOST_POINTS)
        axes.plot(x[there][kept], values[there][kept], color=LINE, linewidth=0.9)
        axes.set_ylabel(quantities.symbol(column), rotation=0, ha="right", va="center")
        axes.set_title(style.plain_text(name), loc="left", fontsize=8, fontweight="normal", color="#555555", pad=2)
    panels[-1].set_xlabel("row [–]" if rows[-1][2] is None else "time since the first reading [s]")
    caption = "The channels that were taken for one of the model's quantities, each in the file's own unit."
    return style.ReportFigure("overview", "The channels over time", caption, figure, kind="png")


@style.styled
def beside_readings(simulated: pd.DataFrame, readings: Mapping[str, np.ndarray]) -> style.ReportFigure:
    """One panel a quantity of `SHOWN`; of another machine one a reading.

    Args:
        simulated: columns [SI], time_s among them.
        readings: column -> (n,) [SI] at the same times.
    """
    columns = [name for name in SHOWN if name in simulated] or [name for name in readings if name in simulated]
    figure = Figure(figsize=(WIDTH_IN, PANEL_IN * len(columns) + 0.6))
    panels = np.atleast_1d(figure.subplots(len(columns), 1, sharex=True))
    time_min = simulated["time_s"].to_numpy() / 60.0
    for axes, name in zip(panels, columns, strict=True):
        if name in readings and np.isfinite(readings[name]).any():
            axes.plot(time_min, quantities.shown(name, readings[name]), ".", color=style.MEASURED, markersize=2.2,
                      label="read")  # fmt: skip
        axes.plot(time_min, quantities.shown(name, simulated[name]), color=LINE, linewidth=1.1, label="simulated")
        axes.set_ylabel(LABELS.get(name) or quantities.axis_label(name))
    panels[-1].set_xlabel("time [min]")
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return style.ReportFigure("readings", "Simulated", "Simulated quantities over time, readings beside them.", figure,
                              kind="png")  # fmt: skip
