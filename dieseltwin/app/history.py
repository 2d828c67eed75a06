"""What was found of an engine over time: its verdicts, the trend of its health, and what calls for a look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dieseltwin.api.saved import BEYOND, Z_90, Level, Saved, differences
from dieseltwin.app.desk import Analysis, Desk
from dieseltwin.settings.names import listed

WIDTH, HEIGHT, MARGIN = 320.0, 120.0, 14.0


@dataclass(frozen=True)
class Past:
    """One verdict on an engine."""

    analysis: Analysis
    verdict: Saved
    recording: str


@dataclass(frozen=True)
class Mark:
    """A point of a trend in the coordinates of its drawing."""

    x: float
    y: float
    low: float
    high: float
    words: str


@dataclass(frozen=True)
class Trend:
    """A health parameter over the verdicts on an engine.

    Attributes:
        level: the newest.
        marks: oldest first, with 90 % intervals.
        top, bottom: values at the ends of the drawing, as text.
    """

    level: Level
    marks: tuple[Mark, ...]
    top: str
    bottom: str


def history_of(desk: Desk, engine: str) -> list[Past]:
    """The finished verdicts on an engine, oldest first."""
    found = []
    for analysis in reversed(desk.analyses()):
        job = analysis.job
        if job.engine != engine or job.kind not in ("discover", "identify") or analysis.state.status != "done":
            continue
        verdict = desk.verdict(job)
        if verdict is not None:
            kept = [desk.store.recording(key) for key in job.recordings]
            names = ["a recording that was taken away" if one is None else one.name for one in kept]
            found.append(Past(analysis, verdict, listed(names)))
    return found


def alarms_of(past: Sequence[Past]) -> list[str]:
    """What calls for a look: something left out in the newest discovery, and health that moved since the first one."""
    found = []
    discovered = [item for item in past if item.verdict.mismatch is not None]
    if discovered and discovered[-1].verdict.mismatch:
        outcome = discovered[-1].analysis.outcome
        found.append("Something is left out." if outcome is None else outcome.sentence)
    for kind in ("discover", "identify"):
        alike = [item for item in past if item.verdict.kind == kind]
        if len(alike) < 2:
            continue
        for row in differences(alike[0].verdict, alike[-1].verdict):
            if row.beyond:
                found.append(f"{row.level.meaning.capitalize()} ({row.level.name}) moved by {row.change} since "
                             f"{alike[0].recording}: {row.sure} standard deviations; {BEYOND:g} are allowed.")
    return found


def trends_of(past: Sequence[Past]) -> list[Trend]:
    """The trend of each health parameter that was told at least twice."""
    names = list(dict.fromkeys(level.name for item in past for level in item.verdict.levels))
    found = []
    for name in names:
        told = [(item, level) for item in past for level in item.verdict.levels
                if level.name == name and level.value is not None]
        if len(told) >= 2:
            found.append(_trend(told))
    return found


def _trend(told: Sequence[tuple[Past, Level]]) -> Trend:
    values = [(level.value or 0.0, Z_90 * (level.std or 0.0)) for _, level in told]
    low, high = min(v - h for v, h in values), max(v + h for v, h in values)
    span = (high - low) or abs(high) or 1.0
    low, high = low - 0.08 * span, high + 0.08 * span

    def y(value: float) -> float:
        return round(MARGIN + (high - value) / (high - low) * (HEIGHT - 2 * MARGIN), 1)

    step = (WIDTH - 2 * MARGIN) / (len(told) - 1)
    marks = [
        Mark(round(MARGIN + i * step, 1), y(value), y(value - half), y(value + half),
             f"{item.recording}: {level.text} {level.unit}")
        for i, ((item, level), (value, half)) in enumerate(zip(told, values, strict=True))
    ]  # fmt: skip
    return Trend(told[-1][1], tuple(marks), f"{high:.5g}", f"{low:.5g}")
