"""Times that are numbers: dates and times of day written as one number, clocks that show whole seconds, spans."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.recordings.channels import TIME
from dieseltwin.recordings.importers.clock import DAY_S, going_on, seconds_from_stamps, spread_evenly
from dieseltwin.recordings.importers.long_table import parts_of

_CLOCK_WORDS = ("time", "zeit", "stamp", "stempel", "sekunde", "second", "temps")
_CLOCK_NAMES = ("t", "s", "ts", "t_s", "x", "tout")
DATE_DIGITS = (14, 17)  # yyyymmddHHMMSS and the same with milliseconds, 20260329015800 or 20260329015800250
YEARS = (1990, 2100)
OF_DAY = (1.0, 1e3)  # HHMMSS in one number, with decimals, and with milliseconds behind
MINUTES = 0.5  # s by which the steps over full minutes may be off


def in_seconds(frame: pd.DataFrame, where: str) -> tuple[pd.DataFrame, dict[str, str], list[str]]:
    """The table with date stamps, spans of time and numbers that are stamps replaced by seconds from the first row.

    Rows between the steps of a clock without enough digits are spread evenly.

    Returns:
        The table, the unit of each replaced column, and notes.

    Raises:
        InputError: a stamp that is none.
    """
    spans = [str(name) for name in frame.columns if pd.api.types.is_timedelta64_dtype(frame[name])]
    if spans:
        frame = frame.assign(**{name: frame[name] / pd.Timedelta(seconds=1) for name in spans})
    frame, units, notes = seconds_from_stamps(frame, where)
    units = units | dict.fromkeys(spans, "s")
    clocks = [name for name in map(str, frame.columns) if name not in units and is_clock_name(name)
              and pd.api.types.is_numeric_dtype(frame[name]) and len(frame) > 1]  # fmt: skip
    for name in clocks:
        found = _of_digits(frame[name].to_numpy())
        if found is not None:
            values, text, changed = found
            frame, units[name] = frame.assign(**{name: values}), "s"
            notes = [*notes, f"{name} holds {text} as numbers; taken as s from the first row", *changed]
    if parts_of(frame) is not None:
        return frame, units, notes  # readings of several channels share a time there
    for name in dict.fromkeys([*units, *clocks]):
        values, spread = spread_evenly(frame[name].to_numpy(dtype=np.float64))
        if spread:
            frame, notes = frame.assign(**{name: values}), [*notes, *spread]
    return frame, units, notes


def is_clock_name(name: str) -> bool:
    """Whether a column is called like one of times."""
    text = name.lower().strip()
    bare = text.split("[")[0].split("(")[0].strip(" _")
    return name == TIME or bare in _CLOCK_NAMES or any(word in text for word in _CLOCK_WORDS)


def _of_digits(values: np.ndarray) -> tuple[np.ndarray, str, list[str]] | None:
    """Seconds from the first row (n,) of numbers whose digits are dates or times of day, what they are, and notes."""
    if not np.isfinite(values.astype(np.float64)).all():
        return None
    for digits in DATE_DIGITS:
        seconds = _of_dates(values, digits - 14)
        if seconds is not None:
            since, changed = going_on(seconds - seconds[0], float(seconds[0] % DAY_S))
            return since, "dates and times of day", changed
    for scale in OF_DAY:
        seconds = _of_times(values / scale)
        if seconds is not None:
            since, changed = going_on(seconds - seconds[0], float(seconds[0] % DAY_S))
            return since, "times of day", changed
    return None


def _of_dates(values: np.ndarray, behind: int) -> np.ndarray | None:
    """Seconds since 1970 (n,) of dates with `behind` digits behind the seconds; None where they are none."""
    unit = 10**behind
    if not (YEARS[0] * 1e10 * unit <= values.min() and values.max() < YEARS[1] * 1e10 * unit):
        return None
    whole = np.floor(values).astype(np.int64)
    fraction = (values - whole) + whole % unit if behind == 0 else whole % unit
    stamp = whole // unit
    day, of_day = stamp // 1_000_000, stamp % 1_000_000
    year, month, date = day // 10_000, day // 100 % 100, day % 100
    if not ((month >= 1) & (month <= 12) & (date >= 1) & (date <= 31)).all() or not _is_time(of_day):
        return None
    months = (year - 1970).astype("datetime64[Y]").astype("datetime64[M]") + (month - 1).astype("timedelta64[M]")
    days = (months.astype("datetime64[D]") + (date - 1).astype("timedelta64[D]")).astype(np.int64)
    seconds: np.ndarray = DAY_S * days + _of_hms(of_day) + fraction / unit
    return seconds


def _of_times(values: np.ndarray) -> np.ndarray | None:
    """Seconds (n,) of times of day HHMMSS, midnight crossed; None where the steps over full minutes don't say so.

    Numbers of seconds run through 60 to 99, and times of day jump from 59 to 100.
    """
    whole = np.floor(values).astype(np.int64)
    if values.min() < 0.0 or not _is_time(whole):
        return None
    minutes = np.diff(whole // 100)
    crossed = minutes != 0
    seconds = _of_hms(whole) + (values - whole)
    seconds += DAY_S * np.cumsum(np.r_[0.0, np.diff(seconds) < -0.5 * DAY_S])
    steps, usual = np.diff(seconds), float(np.median(np.diff(values)))
    if not crossed.any() or usual < 0.0 or (np.abs(steps[crossed] - usual) > np.maximum(MINUTES, usual)).any():
        return None
    return seconds


def _is_time(numbers: np.ndarray) -> bool:
    """Whether all of (n,) whole numbers HHMMSS are times of day."""
    hour, minute, second = numbers // 10_000, numbers // 100 % 100, numbers % 100
    return bool(((hour < 24) & (minute < 60) & (second < 60)).all())


def _of_hms(numbers: np.ndarray) -> np.ndarray:
    """Seconds (n,) of times of day HHMMSS."""
    return (3600.0 * (numbers // 10_000) + 60.0 * (numbers // 100 % 100) + numbers % 100).astype(np.float64)
