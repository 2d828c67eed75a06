"""The history of an engine as a page: what has changed, when, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
import pandas as pd

from dieseltwin.engine import HEALTH
from dieseltwin.learning.alarm import Alarm, Course
from dieseltwin.learning.history import HEALTHY, Entry, TakenOut
from dieseltwin.notes import counted
from dieseltwin.report import quantities, style
from dieseltwin.report.discovery_words import display_unit, magnitude_words, site_words, unit_of
from dieseltwin.report.page import Page, Section, Table
from dieseltwin.report.trend import Trend, trend_figure

_LEAST_EVIDENCE = 1e-3  # shown; below, nothing speaks for a change
_SHOWN_SITES = 4
DAY = "%Y-%m-%d"


def sentence(entries: Sequence[Entry], course: Course, alarms_per_year: float) -> str:
    """One sentence: alarm or none, what, since when, how large, and how often such an alarm is false."""
    rate = f"{alarms_per_year:g} false alarms an engine and year at most"
    if not entries:
        return "The history holds no recording."
    span = f"{counted(len(entries), 'recording')}, {_days(entries[0].moment, entries[-1].moment)}"
    alarm, last = course.alarm, entries[-1].verdict
    if alarm is None:
        alone = ("" if last == HEALTHY else f"; but the last recording by itself shows {by_itself(entries[-1])}, "
                 "and one recording alone raises no alarm: record again")
        return (f"No alarm over {span}: the evidence for a change that matters is {course.evidence[-1]:.2g} where "
                f"{course.threshold:g} is an alarm ({rate}); wear of the health parameters is no alarm{alone}.")
    size = magnitude_words(alarm.name, alarm.size, alarm.std, alarm.unit, extra=False)
    or_others = f" or {', '.join(alarm.others)}" if alarm.others else ""
    why = f"{100 * alarm.share:.0f} % of the evidence"
    if alarm.shown:
        why = f"{counted(alarm.shown, 'recording')} {'show' if alarm.shown > 1 else 'shows'} it alone; {why}"
    about = "" if alarm.name in entries[alarm.at].sizes else "about "
    way = "growing since" if alarm.grows else "there since"
    perhaps = ""
    if alarm.earliest.date() != alarm.latest.date():
        perhaps = f" (at the earliest {alarm.earliest:{DAY}}, at the latest {alarm.latest:{DAY}})"
    # the evidence adds up linear estimates, which a strong fault bends; a recording's verdict was refitted
    expected = last in (alarm.name, HEALTHY if alarm.gone is None else alarm.name)
    alone = "" if expected else f"; the last recording by itself shows {by_itself(entries[-1])}"
    return (
        f"Alarm with the recording of {entries[alarm.at].moment:{DAY}}: in {site_words(alarm.site)} something has "
        f"changed, most likely {alarm.name} ({why}){or_others}, {about}{size} by "
        f"then, {way} {alarm.since:{DAY}}{perhaps}{_afterwards(alarm, entries)}{alone}; {span}; {rate}. "
        "`dieseltwin discover` on these recordings together says what it is."
    )


def _afterwards(alarm: Alarm, entries: Sequence[Entry]) -> str:
    """What became of the effect after its alarm; nothing where no recording came after it."""
    if not np.isfinite(alarm.sizes[-1]) or alarm.at == len(entries) - 1:
        return ""
    now = magnitude_words(alarm.name, float(alarm.sizes[-1]), float(alarm.stds[-1]), alarm.unit, extra=False)
    if alarm.gone is None:
        return f", {'' if alarm.name in entries[-1].sizes else 'about '}{now} in the last recording"
    since = f"{entries[alarm.gone].moment:{DAY}}"
    return f"; since the recording of {since} it isn't there any more ({now} in the last one)"


def without(taken_out: Sequence[TakenOut], with_them: Course) -> str:
    """What was taken out of the history, what it would say with that, and for which the rate of false alarms holds."""
    them = "it" if len(taken_out) == 1 else "them"
    they = "it" if len(taken_out) == 1 else "they"
    says = ", an alarm" if with_them.alarm is not None else ", no alarm"
    return (f"Taken out: {'; '.join(map(str, taken_out))}. With {them} the evidence comes to "
            f"{np.max(with_them.evidence):.3g} at most{says}. The rate of false alarms holds with {them}; without "
            f"{them} only if what {they} showed was no reason to take {them} out.")  # fmt: skip


def _days(first: datetime, last: datetime) -> str:
    """From one day to another, or the one day."""
    return f"{first:{DAY}} to {last:{DAY}}" if first.date() != last.date() else f"{first:{DAY}}"


def table(entries: Sequence[Entry], course: Course) -> pd.DataFrame:
    """One row a recording, SI units in the names."""
    rows = []
    for entry, evidence in zip(entries, course.evidence, strict=True):
        row = {"date": entry.date, "date_from": entry.date_from, "recording": entry.path, "sha256": entry.sha256,
               "hours": entry.hours, "p_amb_pa": entry.p_amb_pa, "t_amb_k": entry.t_amb_k}  # fmt: skip
        for j, name in enumerate(HEALTH):
            row |= {f"{name}_since": entry.since[j], f"{name}_since_std": entry.since_std[j]}
        for site, (effect, distance) in strongest(entry).items():
            row |= {f"score:{site}": distance, f"effect:{site}": effect}
        for name, (size, std) in entry.sizes.items():
            row |= {f"size:{name}": size, f"size_std:{name}": std}
        rows.append({**row, "evidence": evidence, "verdict": entry.verdict})
    return pd.DataFrame(rows)


def strongest(entry: Entry) -> dict[str, tuple[str, float]]:
    """Site -> its effect whose estimate is most standard deviations from zero, and how many."""
    best: dict[str, tuple[str, float]] = {}
    for score in entry.scores:
        distance = score.estimate / score.std
        if score.site not in best or abs(distance) > abs(best[score.site][1]):
            best[score.site] = (score.name, distance)
    return dict(sorted(best.items()))


def health(entries: Sequence[Entry], course: Course) -> style.ReportFigure | None:
    """Health parameters since the reference, with intervals; None without a recording."""
    if not entries:
        return None
    panels = [
        Trend(f"{quantities.symbol(name)} since the reference [%]", [100.0 * (e.since[j] - 1.0) for e in entries],
              [100.0 * e.since_std[j] for e in entries], 0.0)
        for j, name in enumerate(HEALTH)
    ]  # fmt: skip
    caption = "Change of the health parameters since the reference with 90 % intervals; a line marks an alarm."
    return trend_figure("health", "Health since the reference", caption, panels, *_when(entries, course))


def evidence(entries: Sequence[Entry], course: Course) -> style.ReportFigure | None:
    """Evidence of a change after each recording, and the effects that show most or are the alarm's; None without."""
    if not entries:
        return None
    levels = np.log10(np.maximum(course.evidence, _LEAST_EVIDENCE))
    panels = [Trend("evidence of a change, log10", list(levels), level=float(np.log10(course.threshold)), line=True)]
    caption = "Evidence of a change that matters besides health, dashed: alarm."
    shown = _leading(entries) if course.alarm is None else course.alarm.others
    if (alarm := course.alarm) is not None:
        unit, factor = display_unit(alarm.name, alarm.unit)
        panels.append(Trend(f"{alarm.name.replace('_', ' ')} [{unit or '–'}]", list(factor * alarm.sizes),
                            list(factor * alarm.stds), 0.0))  # fmt: skip
        caption += (" The size of what the alarm is about, with 90 % intervals: each recording's own refit where that "
                    "names it, else the estimate against the recordings before.")  # fmt: skip
    if shown:
        caption += (f" The effects that {'show most' if alarm is None else 'it may be as well'}, each estimated in "
                    "each recording beside its health alone, with 90 % intervals.")  # fmt: skip
    for name in shown:
        found = [next((score for score in entry.scores if score.name == name), None) for entry in entries]
        panels.append(
            Trend(
                f"{name.replace('_', ' ')} [standard deviations]",
                [np.nan if score is None else score.estimate / score.std for score in found],
                [np.nan if score is None else 1.0 for score in found], 0.0,
            )
        )  # fmt: skip
    return trend_figure("evidence", "Evidence of a change", caption, panels, *_when(entries, course))


def _leading(entries: Sequence[Entry]) -> list[str]:
    """Names of the effects whose estimates show most. After an alarm they would be those that a fault looks like, one
    by one: a boost leak of 30 mm2 as a turbine's loss of 90 standard deviations."""
    total: dict[str, float] = {}
    for entry in entries:
        for score in entry.scores:
            total[score.name] = total.get(score.name, 0.0) + score.estimate / score.std
    return sorted(total, key=lambda name: -abs(total[name]))[: _SHOWN_SITES - 1]


def _when(entries: Sequence[Entry], course: Course) -> tuple[list, list]:
    dates = [entry.moment for entry in entries]
    return dates, [] if course.alarm is None else [dates[course.alarm.at]]


def page(entries: Sequence[Entry], course: Course, said: str, taken_out: Sequence[TakenOut] = ()) -> Page:
    """What the page says; `said` is its headline."""
    figures = [figure for figure in (health(entries, course), evidence(entries, course)) if figure is not None]
    hours, shows = sum(entry.hours for entry in entries), bool(entries and entries[-1].shown.names)
    dates = " or its ".join(sorted({entry.date_from for entry in entries}))
    heads = ("date", "recording", "min", "kPa", "°C", *(f"{name} [%]" for name in HEALTH), "evidence", "by itself")
    rows = [
        (f"{entry.moment:{DAY}}", entry.path, f"{60.0 * entry.hours:.0f}", f"{1e-3 * entry.p_amb_pa:.1f}",
         f"{entry.t_amb_k - 273.15:.0f}", *_changes(entry), f"{value:.2g}", by_itself(entry))
        for entry, value in zip(entries, course.evidence, strict=True)
    ]  # fmt: skip
    words = ("Health is the change since the reference, ± one standard deviation. Dates are those of each recording's "
             f"{dates}.")
    return Page(
        title=_title(course.alarm, shows),
        about=f"{len(entries)} recordings · {hours:.3g} h of running engine",
        headline=quantities.with_symbols(said),
        alarm=course.alarm is not None or shows,
        sections=(
            Section("course", "Since the reference", tuple(figures)),
            Section("recordings", "Recordings", words=words,
                    tables=(Table(heads, rows, words=(0, 1, len(heads) - 1), long=(len(heads) - 1,)),
                            *_gone(taken_out))),
        ),
    )  # fmt: skip


def _title(alarm: Alarm | None, shows: bool) -> str:
    """The heading; `shows`: the last recording by itself shows something."""
    if alarm is None:
        return "No alarm, but the last recording shows something" if shows else "No change but wear"
    return "Alarm: the engine has changed" if alarm.gone is None else "The engine had changed, and what it was is gone"


def _gone(taken_out: Sequence[TakenOut]) -> tuple[Table, ...]:
    """What doesn't count any more, and why; no table without any."""
    rows = [(f"{out.entry.moment:{DAY}}", out.entry.path, out.day[:10], out.reason, by_itself(out.entry))
            for out in taken_out]  # fmt: skip
    heads = ("date", "recording", "taken out", "reason", "by itself")
    return (Table(heads, rows, words=(0, 1, 2, 3, 4), long=(3, 4), title="Taken out"),) if rows else ()


def by_itself(entry: Entry) -> str:
    """A recording's own verdict, with the sizes of what it names."""
    sizes = [magnitude_words(name, size, std, unit_of(name), extra=False) for name, (size, std) in entry.sizes.items()]
    return ", ".join([entry.verdict, *sizes])


def _changes(entry: Entry) -> list[str]:
    shown = zip(100.0 * (entry.since - 1.0), 100.0 * entry.since_std, strict=True)
    return [f"{change:+.1f} ± {std:.1f}" for change, std in shown]
