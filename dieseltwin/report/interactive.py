"""Readings over time to look into: panels that zoom together, with one cursor over all of them.

The page carries the numbers as JSON and draws them with uPlot (MIT, `vendor/`, 50 kB); nothing is loaded. A still
figure stands in on paper and where no script runs.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.report import quantities, style
from dieseltwin.report.extremes import extremes
from dieseltwin.report.results import Results
from dieseltwin.report.segment_axis import WIDTH_IN

MOST_ROWS = 5000  # of a panel on the page: seven panels of four lines stay below a megabyte
DIGITS = 5
MEASURED, BEFORE, AFTER = "#8a8a8a", "#D55E00", "#0072B2"
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
    """One quantity over time.

    Attributes:
        name: of its column; unit: that is shown.
        time_s: (n,) [s].
        lines: readings first.
    """

    name: str
    unit: str
    time_s: Array
    lines: tuple[Line, ...]

    @property
    def title(self) -> str:
        """Symbol, meaning and unit as HTML."""
        words = quantities.words(self.name)
        meaning = "" if words == self.name else f" {words}"
        return f"{quantities.html_symbol(self.name)}{meaning} [{self.unit or '–'}]"


@dataclass(frozen=True)
class Series:
    """The panels of a page, in the form that its template takes."""

    panels: tuple[Panel, ...]

    @property
    def titles(self) -> list[Markup]:
        """Of the panels."""
        return [Markup(panel.title) for panel in self.panels]  # from the nomenclature or cleaned by it

    @property
    def data(self) -> Markup:
        """Times, lines and their looks as JSON that may stand in a script element."""
        return Markup(json.dumps([_plain(panel) for panel in self.panels], allow_nan=False, separators=(",", ":")
                                 ).replace("<", "\\u003c"))  # fmt: skip

    @property
    def script(self) -> Markup:
        """uPlot and what makes the panels with it."""
        return Markup((_VENDOR / "uPlot.iife.min.js").read_text(encoding="utf-8")
                      + _SCRIPT.read_text(encoding="utf-8"))

    @property
    def style(self) -> Markup:
        """uPlot's style."""
        return Markup((_VENDOR / "uPlot.min.css").read_text(encoding="utf-8"))


def discovery_series(found: Discovery) -> Series:
    """Readings, the fit of the health parameters alone and the repaired twin, channel by channel."""
    curves = found.curves
    panels = []
    for j, name in enumerate(curves.channels):
        lines = [_line(name, "reading", MEASURED, curves.measured[:, j], dots=True)]
        if found.document.mismatch:
            lines.append(_line(name, "before (health alone)", BEFORE, curves.before[:, j]))
        lines.append(_line(name, "after (repaired)" if found.document.mismatch else "fit", AFTER, curves.after[:, j]))
        panels.append(Panel(name, quantities.unit(name), curves.time_s, tuple(lines)))
    return Series(tuple(panels))


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
    return Series(tuple(panels)) if panels else None


def _line(name: str, label: str, colour: str, values: Array, dots: bool = False) -> Line:
    return Line(label, colour, quantities.shown(name, values), dots)


def _plain(panel: Panel) -> dict[str, object]:
    rows = extremes(panel.lines[0].values, MOST_ROWS)
    return {
        "name": panel.name, "unit": panel.unit, "t": _numbers(panel.time_s[rows], 7),
        "lines": [{"label": line.label, "colour": line.colour, "dots": line.dots, "y": _numbers(line.values[rows])}
                  for line in panel.lines],
    }  # fmt: skip


def _numbers(values: Array, digits: int = DIGITS) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values.tolist()]


@style.styled
def still(series: Series) -> style.ReportFigure:
    """The same panels as a figure, for paper."""
    figure = Figure(figsize=(WIDTH_IN, 1.25 * len(series.panels) + 0.7))
    axes_of = np.atleast_1d(figure.subplots(len(series.panels), 1, sharex=True))
    for axes, panel in zip(axes_of, series.panels, strict=True):
        for line in panel.lines:
            look = {"marker": ".", "linestyle": "none", "markersize": 1.6} if line.dots else {"linewidth": 1.0}
            axes.plot(panel.time_s, line.values, color=line.colour, **look)
        axes.set_ylabel(f"{quantities.symbol(panel.name)} [{panel.unit or '–'}]")
    axes_of[-1].set_xlabel("time [s]")
    _legend(figure, series.panels)
    words = "Readings and the twin over the whole recording. On a screen these panels zoom and show every number."
    return style.ReportFigure("readings", "Readings and twin over time", words, figure, kind="png")


def _legend(figure: Figure, panels: Sequence[Panel]) -> None:
    handles = [artist for artist, _ in zip(figure.axes[0].get_lines(), panels[0].lines, strict=True)]
    labels = [line.label for line in panels[0].lines]
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), markerscale=5)
