"""The channels of a file over time, before anything is made of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from dieseltwin.report import quantities, style
from dieseltwin.report.extremes import extremes

MOST_POINTS = 4000  # of a channel: more than a panel has pixels
LINE = "#0072B2"


@style.styled
def overview(rows: Sequence[tuple[str, str, np.ndarray | None, np.ndarray]]) -> style.ReportFigure | None:
    """A small panel for every channel, lowest and highest of each stretch where there are more readings than pixels.

    Args:
        rows: our column, the file's name and unit, times (n,) [s] (None where there is no clock), values (n,).
    """
    if not rows:
        return None
    figure = Figure(figsize=(9.0, 1.05 * len(rows) + 0.4))
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
