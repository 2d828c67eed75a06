"""Quantities of an engine from one recording to the next: values with intervals over dates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import matplotlib.dates as mdates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dieseltwin.least_squares import Z_90
from dieseltwin.report import style

COLUMNS = 2
_VALUE, _LEVEL, _ALARM = style.AFTER, "#777777", style.BEFORE
_WIDTH_IN, _ROW_IN = 9.0, 2.2


@dataclass(frozen=True)
class Trend:
    """One quantity over recordings.

    Attributes:
        title: with the unit.
        values, std: (R,) as shown; NaN where a recording says nothing.
        level: value that means "as before", None for none.
        line: joined by a line, without intervals.
    """

    title: str
    values: Sequence[float]
    std: Sequence[float] | None = None
    level: float | None = None
    line: bool = False


@style.styled
def trend_figure(
    name: str, title: str, caption: str, trends: Sequence[Trend], dates: Sequence[datetime] | None,
    alarms: Sequence[datetime] = (),
) -> style.ReportFigure | None:  # fmt: skip
    """Small panels, one a quantity, with 90 % intervals; None without a quantity.

    Args:
        name, title, caption: of the figure.
        trends: what is shown; dates: (R,) of the recordings, None where they have none: they are numbered.
        alarms: dates at which an alarm was raised.
    """
    if not trends:
        return None
    rows = -(-len(trends) // COLUMNS)
    figure = Figure(figsize=(_WIDTH_IN, _ROW_IN * rows + 0.4))
    panels = np.atleast_1d(figure.subplots(rows, min(COLUMNS, len(trends)), squeeze=False)).reshape(-1)
    for axes, trend in zip(panels, trends, strict=False):
        _panel(axes, trend, dates, alarms)
    for axes in panels[len(trends) :]:
        axes.set_visible(False)
    return style.ReportFigure(name, title, caption, figure)


def _panel(axes: Axes, trend: Trend, dates: Sequence[datetime] | None, alarms: Sequence[datetime]) -> None:
    values = np.asarray(trend.values, dtype=np.float64)
    days = np.arange(1.0, values.size + 1.0) if dates is None else np.asarray(mdates.date2num(dates), dtype=np.float64)
    for alarm in alarms:
        axes.axvline(float(mdates.date2num(alarm)), color=_ALARM, linewidth=1.2)
    if trend.level is not None:
        axes.axhline(trend.level, color=_LEVEL, linewidth=1.0, linestyle="--")
    if trend.line:
        axes.plot(days, values, "-o", color=_VALUE, markersize=3.5)
    else:
        half = None if trend.std is None else Z_90 * np.asarray(trend.std, dtype=np.float64)
        axes.errorbar(days, values, yerr=half, fmt="o", color=_VALUE, capsize=3, markersize=4)
    axes.set_title(trend.title, fontweight="normal", fontsize=10)
    if dates is None:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("recording [number]")
    else:
        locator = mdates.AutoDateLocator(minticks=2, maxticks=5)
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))
    axes.margins(x=0.06, y=0.12)
