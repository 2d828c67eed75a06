"""Curves to look into: panels that zoom, one cursor over all that share an axis.

The page carries the numbers as JSON and draws them with uPlot (MIT, `vendor/`, 50 kB); nothing is loaded. A still
figure stands in on paper and where no script runs.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.when import moments
from dieseltwin.report import quantities, style
from dieseltwin.report.circumstance_words import shown_day
from dieseltwin.report.over_time import extremes
from dieseltwin.report.results import Results
from dieseltwin.report.segment_axis import WIDTH_IN
from dieseltwin.report.style import AFTER, BEFORE, MEASURED

MOST_ROWS = 5000  # of a panel on the page: seven panels of four lines stay below a megabyte
DIGITS = 5
FEW = 500  # points of a panel up to which they are drawn large
CELLS = 3  # panels in a row of a figure where they share no axis
REPAIR = ("before (health alone)", "after (repaired)")
_VENDOR = Path(__file__).parent / "vendor"
_SCRIPT = Path(__file__).parent / "templates" / "interactive.js"


@dataclass(frozen=True)
class Line:
    """One line of a panel: label, colour, values (n,) [unit of the panel]; readings are dots."""

    label: str
    colour: str
    values: Array
    dots: bool = False


@dataclass(frozen=True)
class Panel:
    """One quantity over another, time where nothing else is said.

    Attributes:
        name: of its column, or a heading; unit: that is shown.
        x: (n,) ascending [s, or `axis_unit`].
        lines: readings first.
        axis, axis_unit: what x is.
    """

    name: str
    unit: str
    x: Array
    lines: tuple[Line, ...]
    axis: str = "time"
    axis_unit: str = "s"

    @property
    def title(self) -> Markup:
        """Symbol, meaning and unit as HTML; of what is no quantity of the nomenclature its name and unit."""
        unit = escape(self.unit or "–")
        if quantities.known(self.name) is None:
            return Markup("{} [{}]").format(self.name, unit)
        return Markup("{} {} [{}]").format(quantities.label(self.name), quantities.words(self.name), unit)


@dataclass(frozen=True)
class Mark:
    """A line at a place of the axis, or a band up to another, with what it means."""

    words: str
    at: float
    until: float | None = None

    @property
    def shaded(self) -> bool:
        """Whether it is a band."""
        return self.until is not None


@dataclass(frozen=True)
class Series:
    """Panels of a page, in the form that its template takes.

    Attributes:
        panels: in their order.
        linked: they share the axis, zoom together and have one cursor; else each has its own, side by side.
        marks: in all of them.
        drawn: the figure for paper, a file as well; None: the panels as they are.
        pictured: the panels as they are, where they were drawn already.
    """

    panels: tuple[Panel, ...]
    linked: bool = True
    marks: tuple[Mark, ...] = ()
    drawn: style.ReportFigure | None = None
    pictured: style.ReportFigure | None = None

    @property
    def data(self) -> Markup:
        """Axes, lines and their looks as JSON that may stand in a script element."""
        content = {"panels": [_plain(panel) for panel in self.panels], "linked": self.linked,
                   "marks": [{"at": mark.at, "until": mark.until, "words": mark.words} for mark in self.marks]}
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
        return Markup(text.replace("<", "\\u003c"))

    @property
    def still(self) -> style.ReportFigure:
        """The figure for paper."""
        return self.drawn or self.pictured or still(self)


def script() -> Markup:
    """uPlot and what makes the panels with it."""
    return Markup((_VENDOR / "uPlot.iife.min.js").read_text(encoding="utf-8") + _SCRIPT.read_text(encoding="utf-8"))


def look() -> Markup:
    """uPlot's style."""
    return Markup((_VENDOR / "uPlot.min.css").read_text(encoding="utf-8"))


def over(
    name: str, unit: str, axis: tuple[str, str], x: Array, lines: Sequence[Line]
) -> Panel:
    """A panel of what comes in any order of its axis (name and unit); points without a place are left out."""
    order = np.argsort(x, kind="stable")
    order = order[np.isfinite(x[order])]
    sorted_lines = tuple(Line(line.label, line.colour, line.values[order], line.dots) for line in lines)
    return Panel(name, unit, np.asarray(x, dtype=np.float64)[order], sorted_lines, *axis)


def repair_panels(
    time_s: Array, channels: Sequence[str], readings: Sequence[Array], before: Sequence[Array] | None,
    after: Sequence[Array], labels: tuple[str, str] = REPAIR, units: Sequence[str] | None = None,
) -> tuple[Panel, ...]:  # fmt: skip
    """A panel a channel: its readings (n,) [SI], and what the twin says before and after a repair.

    Args:
        time_s: (n,) [s].
        channels: names of columns.
        readings, before, after: (n,) each of every channel; `before` None where nothing was repaired.
        labels: of the two.
        units: of channels that the nomenclature doesn't know.
    """
    panels = []
    for j, name in enumerate(channels):
        lines = [_line(name, "reading", MEASURED, readings[j], dots=True)]
        if before is not None:
            lines.append(_line(name, labels[0], BEFORE, before[j]))
        lines.append(_line(name, "fit" if before is None else labels[1], AFTER, after[j]))
        unit = quantities.unit(name) or ("" if units is None else units[j])
        panels.append(Panel(name, unit, time_s, tuple(lines)))
    return tuple(panels)


def discovery_series(found: Discovery) -> Series:
    """Readings, the fit of the health parameters alone and the repaired twin, channel by channel."""
    curves = found.curves
    before = list(curves.before.T) if found.document.mismatch else None
    panels = repair_panels(curves.time_s, curves.channels, list(curves.measured.T), before, list(curves.after.T))
    marks = (Mark(name, curves.start_s + at) for name, at in moments(found.document.location))
    return Series(panels, marks=(*marks, *_begins(found)))


def _begins(found: Discovery) -> list[Mark]:
    """Where each of several recordings begins on the axis on which they follow each other; none on one."""
    marks: list[Mark] = []
    time_s, row = found.curves.time_s, 0
    for one in found.document.recordings:
        if row < time_s.size:
            words = f"{'' if marks else 'the beginnings of '}{shown_day(one.date)} ({one.path})"
            marks.append(Mark(words, float(time_s[row])))
            row = int(np.searchsorted(time_s, time_s[row] + one.duration_s + 0.5))  # they are a second apart
    return marks


def results_series(results: Results) -> Series | None:
    """Readings and the twin of a single method; None for a comparison of methods, or without either."""
    if len(results.methods) != 1 or results.measured is None or results.methods[0].states is None:
        return None
    measured, states = results.measured, results.methods[0].states
    time_s = states["time_s"].to_numpy(dtype=np.float64)
    at = measured.set_index("time_s").reindex(states["time_s"])
    panels = []
    for name in (column for column in measured.columns if column in states.columns and column in results.sigma):
        readings = at[name].to_numpy(dtype=np.float64)
        if np.isfinite(readings).any():
            twin = states[name].to_numpy(dtype=np.float64)
            lines = (_line(name, "reading", MEASURED, readings, dots=True), _line(name, "twin", AFTER, twin))
            panels.append(Panel(name, quantities.unit(name), time_s, lines))
    if not panels:
        return None
    return Series(tuple(panels))


def _line(name: str, label: str, colour: str, values: Array, dots: bool = False) -> Line:
    return Line(label, colour, quantities.shown(name, values), dots)


def _plain(panel: Panel) -> dict[str, object]:
    rows = extremes(panel.lines[0].values, MOST_ROWS)
    return {
        "name": panel.name, "unit": panel.unit, "axis": panel.axis, "axis_unit": panel.axis_unit,
        "x": _numbers(panel.x[rows], 7),
        "lines": [{"label": line.label, "colour": line.colour, "dots": line.dots, "y": _numbers(line.values[rows])}
                  for line in panel.lines],
    }  # fmt: skip


def _numbers(values: Array, digits: int = DIGITS) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values.tolist()]


READINGS = ("readings", "Readings and twin over time", "Readings and the twin over the whole recording. On a screen "
            "these panels zoom and show every number.")  # fmt: skip


@style.styled
def still(series: Series, told: tuple[str, str, str] = READINGS) -> style.ReportFigure:
    """The same panels as a figure, for paper; `told`: its name, title and caption."""
    count, columns = len(series.panels), 1 if series.linked else min(len(series.panels), CELLS)
    rows = -(-count // columns)
    told_above = sum(quantities.known(panel.name) is None for panel in series.panels)
    height = 1.25 * rows + 0.3 * told_above + 0.7 if series.linked else 3.0 * rows + 0.5
    figure = Figure(figsize=(WIDTH_IN, height))
    every = np.atleast_1d(figure.subplots(rows, columns, sharex=series.linked)).ravel()
    for axes in every[count:]:
        axes.remove()
    for axes, panel in zip(every[:count], series.panels, strict=True):
        _draw(axes, panel, series)
        if axes is every[count - 1] or not series.linked:
            axes.set_xlabel(f"{panel.axis} [{panel.axis_unit}]" if panel.axis_unit else panel.axis)
    _legend(figure, series.panels)
    name, title, words = told
    return style.ReportFigure(name, title, words, figure, kind="png")


def _draw(axes: Axes, panel: Panel, series: Series) -> None:
    size = 1.6 if panel.x.size > FEW else 4.0
    for line in panel.lines:
        look = {"marker": ".", "linestyle": "none", "markersize": size} if line.dots else {"linewidth": 1.0}
        axes.plot(panel.x, line.values, color=line.colour, **look)
    unit = f"[{panel.unit or '–'}]"
    if quantities.known(panel.name) is not None:
        axes.set_ylabel(f"{quantities.symbol(panel.name)} {unit}")
    else:
        axes.set_title(style.plain_text(f"{panel.name} {unit}").replace("; ", "\n"), fontsize=8.5)
    for mark in series.marks:
        if mark.until is None:
            axes.axvline(mark.at, color=style.TRUTH, linestyle="--", linewidth=0.9)
        else:
            axes.axvspan(mark.at, mark.until, color=style.BAND_OF_TRUTH, linewidth=0, zorder=0)


def _legend(figure: Figure, panels: Sequence[Panel]) -> None:
    handles = [artist for artist, _ in zip(figure.axes[0].get_lines(), panels[0].lines, strict=False)]
    labels = [line.label for line in panels[0].lines]
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), markerscale=3)
