"""Results that were saved: their numbers read back for tables, trends and comparisons, in the units that are shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dieseltwin.api.folders import IDENTIFICATION as IDENTIFICATION
from dieseltwin.discovery.verdict.document import FILE_NAME, load_discrepancy
from dieseltwin.errors import InputError
from dieseltwin.least_squares import Z_90 as Z_90
from dieseltwin.notes import READING
from dieseltwin.report import quantities
from dieseltwin.report.discovery_words import magnitude_words, site_words
from dieseltwin.report.quantities import EMPTY
from dieseltwin.report.quantities import with_symbols as with_symbols
from dieseltwin.sealed import read_json


@dataclass(frozen=True)
class Level:
    """A health parameter of a result, in the unit that is shown.

    Attributes:
        name, unit, meaning: of the parameter; `symbol` is HTML.
        value, std: estimate and standard deviation [unit]; None where they can't be told.
        text: both as text, without the unit.
        change: against the engine's own value [-]; None where it isn't known.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    value: float | None
    std: float | None
    text: str
    change: float | None


@dataclass(frozen=True)
class Effect:
    """An effect that was found, as text."""

    name: str
    place: str
    size: str
    probability: str
    others: str
    law: str


@dataclass(frozen=True)
class Saved:
    """What a folder of `discover` or `identify` says.

    Attributes:
        kind: discover or identify.
        mismatch: whether physics is missing; None of an identification.
        about: the recording in a few words.
        levels: health parameters.
        effects: strongest first.
        doubts: what is doubtful, one sentence each.
        read: what was done to the file on reading, one sentence each; nothing that need be doubted.
    """

    kind: str
    mismatch: bool | None
    about: str
    levels: tuple[Level, ...]
    effects: tuple[Effect, ...]
    doubts: tuple[str, ...]
    read: tuple[str, ...] = ()


@dataclass(frozen=True)
class Difference:
    """One health parameter in two results, as text.

    Attributes:
        level: name, symbol and unit.
        one, other: estimates with standard deviations.
        change: of the other against the one.
        sure: how many standard deviations that is.
        beyond: whether it is more than `BEYOND` of them.
    """

    level: Level
    one: str
    other: str
    change: str
    sure: str
    beyond: bool


BEYOND = 3.0  # standard deviations from which two estimates are said to differ


def saved(folder: str | Path) -> Saved:
    """Read a result folder of `discover` or `identify`.

    Raises:
        InputError: it holds neither, or what it holds can't be read.
    """
    folder = Path(folder)
    if (folder / FILE_NAME).is_file():
        return _discovered(folder)
    if (folder / IDENTIFICATION).is_file():
        return _identified(folder)
    raise InputError(str(folder), "no result", f"a folder with {FILE_NAME} or {IDENTIFICATION}", "check the folder")


def differences(one: Saved, other: Saved) -> tuple[Difference, ...]:
    """The health parameters that both results have, side by side."""
    there = {level.name: level for level in other.levels}
    return tuple(_difference(level, there[level.name]) for level in one.levels if level.name in there)


def _difference(one: Level, other: Level) -> Difference:
    change = sure = EMPTY
    beyond = False
    if one.value and other.value is not None:
        change = quantities.percent(other.value / one.value - 1.0, signed=True)
        spread = math.hypot(one.std or 0.0, other.std or 0.0)
        if spread > 0.0:
            distance = abs(other.value - one.value) / spread
            sure, beyond = f"{distance:.1f}", distance > BEYOND
    return Difference(one, one.text, other.text, change, sure, beyond)


def _discovered(folder: Path) -> Saved:
    document = load_discrepancy(folder)
    levels = tuple(_level(name, entry.value, entry.std, entry.before if document.mismatch else None)
                   for name, entry in document.health.items())
    place = EMPTY if document.location is None else site_words(document.location.site)
    effects = tuple(
        Effect(effect.name, place,
               EMPTY if effect.magnitude is None
               else magnitude_words(effect.name, effect.magnitude, effect.std, effect.unit),
               quantities.probability(effect.probability),
               ", ".join(effect.equivalent_names) or EMPTY,
               effect.law or EMPTY)
        for effect in document.effects
    )  # fmt: skip
    about = f"{document.recording.duration_s:.0f} s, {len(document.recording.channels)} sensors"
    said = [(note.code, note.text) for note in document.warnings]
    return Saved("discover", document.mismatch, about, levels, effects, *_apart(said))


def _apart(said: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Doubts, and what was done on reading, of codes and texts."""
    read = tuple(text for code, text in said if code == READING)
    return tuple(text for code, text in said if code != READING), read


def _identified(folder: Path) -> Saved:
    path = folder / IDENTIFICATION
    wanted, do = "what `dieseltwin identify` wrote", "identify again"
    document = read_json(path, wanted, do)
    try:
        levels = tuple(_level(name, entry["mean"], entry["std"], None)
                       for name, entry in document["parameters"].items())
        about = f"method {document['method']}; segments: {len(document['segments'])}, runs: {len(document['runs'])}"
        said = [(str(warning.get("code")), str(warning["text"])) for warning in document.get("warnings", ())]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), f"{type(error).__name__} {error}", wanted, do) from None
    return Saved("identify", None, about, levels, (), *_apart(said))


def _level(name: str, value: float | None, std: float | None, before: float | None) -> Level:
    scale, unit = quantities.factor(name), quantities.unit(name)
    text = "not identifiable here"
    if value is not None:
        text = quantities.value_with_std(name, value, math.nan if std is None else std, with_unit=False)
    return Level(
        name, quantities.html_symbol(name), "" if unit == EMPTY else unit, quantities.words(name),
        None if value is None else value * scale, None if std is None else std * scale, text,
        None if before is None or not value else value / before - 1.0,
    )  # fmt: skip
