"""Histories of many engines side by side: which of them calls for somebody, and why."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from dieseltwin.engine import HEALTH
from dieseltwin.learning.alarm import Alarm, Course
from dieseltwin.learning.history import Entry
from dieseltwin.least_squares import Z_90
from dieseltwin.notes import counted
from dieseltwin.report import quantities, style
from dieseltwin.report.discovery_words import magnitude_words
from dieseltwin.report.history import DAY, by_itself
from dieseltwin.report.page import Page, Section, Table
from dieseltwin.report.quantities import EMPTY

ALARM, LOOK, GONE, WELL, NOTHING = (
    "alarm", "last recording shows something", "was an alarm, is gone", "no change but wear", "no recording",
)  # fmt: skip
"""States of an engine, the most urgent first."""
STATES = (ALARM, LOOK, GONE, WELL, NOTHING)
_NAMED = 8  # engines in the sentence; all are in the table
_WIDTH_IN, _ROW_IN = 9.0, 2.6


@dataclass(frozen=True)
class OfEngine:
    """One engine's history.

    Attributes:
        name: of the engine; entries: its recordings by date; course: evidence after each, and the alarm.
    """

    name: str
    entries: tuple[Entry, ...]
    course: Course

    @property
    def state(self) -> str:
        """One of `STATES`."""
        if not self.entries:
            return NOTHING
        alarm = self.course.alarm
        if alarm is not None and alarm.gone is None:
            return ALARM
        if self.entries[-1].shown.names:
            return LOOK
        return WELL if alarm is None else GONE

    @property
    def words(self) -> str:
        """What it is about; empty where nothing calls for a look."""
        alarm, state = self.course.alarm, self.state
        if state == LOOK:
            return by_itself(self.entries[-1])
        return _alarm_words(alarm, self.entries) if alarm is not None and state in (ALARM, GONE) else ""


def _alarm_words(alarm: Alarm, entries: Sequence[Entry]) -> str:
    """What an alarm is about, its size in the last recording that tells it, and since when."""
    last = int(np.flatnonzero(np.isfinite(alarm.sizes))[-1])
    size = magnitude_words(alarm.name, float(alarm.sizes[last]), float(alarm.stds[last]), alarm.unit, extra=False)
    about = "" if alarm.name in entries[last].sizes else "about "
    way = "growing" if alarm.grows else "there"
    return f"{_names(alarm)}, {about}{size} on {entries[last].moment:{DAY}}, {way} since {alarm.since:{DAY}}"


def ordered(engines: Sequence[OfEngine]) -> list[OfEngine]:
    """The engines, those that call for somebody first; of one state by name."""
    return sorted(engines, key=lambda one: (STATES.index(one.state), one.name))


def sentence(engines: Sequence[OfEngine], alarms_per_year: float) -> str:
    """How many engines have an alarm, which, and how many alarms would be for nothing."""
    of_state = {state: [one for one in ordered(engines) if one.state == state] for state in STATES}
    alarmed, look = of_state[ALARM], of_state[LOOK]
    have = "have" if len(alarmed) > 1 else "has"
    said = f"{len(alarmed) or 'None'} of {counted(len(engines), 'engine')} {have} an alarm"
    if alarmed:
        said += f": {_named([f'{one.name} ({_names(one.course.alarm)})' for one in alarmed])}"
    if look:
        names = _named([f"{one.name} ({one.entries[-1].verdict})" for one in look])
        said += f"; without an alarm, the last recording alone shows something of {len(look)}: {names}"
    if of_state[GONE]:
        said += f"; what was an alarm is gone of {_named([one.name for one in of_state[GONE]])}"
    if of_state[NOTHING]:
        said += f"; {len(of_state[NOTHING])} without a recording"
    expected = alarms_per_year * len(engines)
    return (f"{said}. At {alarms_per_year:g} false alarms an engine and year at most, up to {expected:.2g} a year "
            "among so many engines are for nothing.")  # fmt: skip


def _names(alarm: Alarm | None) -> str:
    """What an alarm may be about."""
    return "" if alarm is None else " or ".join([alarm.name, *alarm.others])


def _named(items: Sequence[str]) -> str:
    more = len(items) - _NAMED
    return ", ".join(items[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def table(engines: Sequence[OfEngine]) -> pd.DataFrame:
    """One row an engine, SI units in the names: its recordings, its state, the alarm, and its health by the last."""
    rows = []
    for one in ordered(engines):
        alarm = one.course.alarm
        row: dict[str, object] = {"engine": one.name, "state": one.state, "about": one.words,
                                  "recordings": len(one.entries)}  # fmt: skip
        if one.entries:
            last = one.entries[-1]
            row |= {"first": one.entries[0].date, "last": last.date, "hours": sum(e.hours for e in one.entries),
                    "evidence": float(one.course.evidence[-1]), "last_verdict": last.verdict}  # fmt: skip
            for j, name in enumerate(HEALTH):
                row |= {f"{name}_since": last.since[j], f"{name}_since_std": last.since_std[j]}
        if alarm is not None:
            row |= {"alarm_on": one.entries[alarm.at].date, "effect": alarm.name, "since": alarm.since.isoformat(),
                    "size": float(alarm.sizes[-1]), "size_std": float(alarm.stds[-1]), "unit": alarm.unit}  # fmt: skip
        rows.append(row)
    return pd.DataFrame(rows)


@style.styled
def health(engines: Sequence[OfEngine]) -> style.ReportFigure | None:
    """Health of every engine by its last recording, since its reference; None without a recording."""
    shown = [one for one in ordered(engines) if one.entries]
    if not shown:
        return None
    figure = Figure(figsize=(_WIDTH_IN, 2.0 * _ROW_IN + 0.4))
    for axes, (j, name) in zip(figure.subplots(2, 2).reshape(-1), enumerate(HEALTH), strict=True):
        for k, one in enumerate(shown):
            last = one.entries[-1]
            colour = style.BEFORE if one.state == ALARM else style.AFTER
            axes.errorbar([k + 1], [100.0 * (last.since[j] - 1.0)], yerr=[100.0 * Z_90 * last.since_std[j]], fmt="o",
                          color=colour, capsize=3, markersize=4)  # fmt: skip
        axes.axhline(0.0, color=style.MEASURED, linewidth=1.0, linestyle="--")
        axes.set_title(f"{quantities.symbol(name)} since the reference [%]", fontweight="normal", fontsize=10)
        axes.set_xlabel("engine [row of the table]")
        axes.xaxis.get_major_locator().set_params(integer=True)
    caption = ("Change of each engine's health since its own reference, by its last recording, with 90 % intervals; "
               "another colour marks an alarm. Engines are numbered by the rows of the table.")  # fmt: skip
    return style.ReportFigure("health", "Health of the fleet", caption, figure)


def page(engines: Sequence[OfEngine], said: str, links: Mapping[str, str]) -> Page:
    """What the page says.

    Args:
        engines: of the fleet; said: its headline.
        links: name -> address of the page of an engine's own history.
    """
    levels = [Markup(f"{quantities.label(name)} [%]") for name in HEALTH]
    heads = ("engine", "state", "about", "recordings", "last", "evidence", *levels)
    rows = [_row(one, links.get(one.name)) for one in ordered(engines)]
    alarmed = any(one.state == ALARM for one in engines)
    figure = health(engines)
    return Page(
        title="Engines with an alarm" if alarmed else "No engine has an alarm",
        about=f"{counted(len(engines), 'engine')} · {sum(len(one.entries) for one in engines)} recordings",
        headline=quantities.with_symbols(said), alarm=any(one.state in (ALARM, LOOK) for one in engines),
        sections=(
            Section("engines", "Engines", words="Health is the change since each engine's reference by its last "
                    "recording, ± one standard deviation.",
                    tables=(Table(heads, rows, words=(0, 1, 2, 4), long=(2,)),)),
            Section("health", "Health", () if figure is None else (figure,)),
        ),
    )  # fmt: skip


def _row(one: OfEngine, link: str | None) -> tuple[str | Markup, ...]:
    name = one.name if link is None else Markup('<a href="{}">{}</a>').format(link, one.name)
    if not one.entries:
        return (name, one.state, EMPTY, "0", EMPTY, EMPTY, *([EMPTY] * len(HEALTH)))
    last = one.entries[-1]
    changes = [f"{100.0 * (value - 1.0):+.1f} ± {100.0 * std:.1f}".replace("-", "−")
               for value, std in zip(last.since, last.since_std, strict=True)]  # fmt: skip
    return (name, one.state, one.words or EMPTY, str(len(one.entries)), f"{last.moment:{DAY}}",
            f"{one.course.evidence[-1]:.2g}", *changes)  # fmt: skip
