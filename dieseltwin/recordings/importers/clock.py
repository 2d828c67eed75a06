"""Date stamps into seconds: a column of dates or times of day becomes seconds from its first row."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import TIME
from dieseltwin.recordings.importers.layout import MONTHS, ZONES, is_date, is_stamp_text

DAY_S = 86400.0
SAMPLE = 20  # rows that decide whether a column holds stamps; a bad one among them is a bad stamp
HOUR_S = 3600.0
SECOND_HOUR, THIRD_HOUR = 2.0 * HOUR_S, 3.0 * HOUR_S  # the clocks of a country go forward to one of them
REPEATED = 0.3  # share of rows with the stamp of the row before, from which the clock shows no more digits
UNEVEN = 0.2  # by which the rows of two stamps may differ
_ZONE_NAME = re.compile(rf" ?\b({'|'.join(ZONES)})\b(?:([+-])(\d{{1,2}}):?(\d{{2}})?)?")
_SLASHED = re.compile(r"^(\d{1,2})/(\d{1,2})/(\d{2,4})")
_MINUTES = re.compile(r"(\d{1,3}):(\d{2}[.,]\d+)$")
_GERMAN_MONTHS = {"mär": "mar", "maer": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}
_YEAR_LAST = re.compile(r"^(?:[A-Za-z]{3} )?([A-Za-z]{3,9}) (\d{1,2}) (\S+)( \S+)? (\d{4})$")
_CLOCK_NAME = re.compile(r"time|zeit|stamp|datum|date|uhr", re.IGNORECASE)
_COLON_FRACTION = re.compile(r"(\d{1,2}:\d{2}:\d{2}):(\d{1,6})$")  # 12:00:00:250, hundredths or ms after a colon


def with_index(frame: pd.DataFrame) -> pd.DataFrame:
    """The table with its index as a column, where that has a name or holds dates or spans of time (then in s)."""
    index = frame.index
    if index.name is None and not isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex):
        return frame
    name = str(index.name or TIME)
    if name in frame:
        return frame
    if isinstance(index, pd.TimedeltaIndex):
        frame = frame.set_axis(index / pd.Timedelta(seconds=1))
    return frame.reset_index(names=name)


def with_clock(frame: pd.DataFrame, nameless: str) -> pd.DataFrame:
    """The table whose first column, called `nameless` for want of a name, is its time where it holds dates or times.

    pandas writes an index of dates so, and it is the time of a table in memory.
    """
    if TIME in frame or nameless not in stamped_columns(frame[frame.columns[:1]]):
        return frame
    return frame.rename(columns={nameless: TIME})


def stamped_columns(frame: pd.DataFrame) -> list[str]:
    """Names of the columns that hold dates or times of day."""
    found = []
    for name in frame.columns:
        column = frame[name]
        if pd.api.types.is_datetime64_any_dtype(column):
            found.append(str(name))
        elif column.dtype == object or pd.api.types.is_string_dtype(column):
            sample = column.dropna().head(SAMPLE)
            if len(sample) and sum(_is_stamp(value) for value in sample) > 0.5 * len(sample):
                found.append(str(name))
    return found


def _is_stamp(value: object) -> bool:
    if isinstance(value, str):
        return is_date(value)
    return isinstance(value, pd.Timestamp) or type(value).__name__ in ("datetime", "date", "time")


def seconds_from_stamps(frame: pd.DataFrame, where: str) -> tuple[pd.DataFrame, dict[str, str], list[str]]:
    """Replace date stamps by seconds from the first row.

    A column of dates beside one of times of day is taken together with it. Clocks that are put back or forward by an
    hour go on.

    Returns:
        The table, the unit of each replaced column, and notes.

    Raises:
        InputError: a stamp that is none.
    """
    stamped = stamped_columns(frame)
    if not stamped:
        _refuse_unknown_clock(frame, where)
        return frame, {}, []
    frame = frame.copy()
    kinds = {name: _kind(frame[name]) for name in stamped}
    dates = [name for name in stamped if kinds[name] == "date"]
    times = [name for name in stamped if kinds[name] == "time"]
    units: dict[str, str] = {}
    notes: list[str] = []

    def replace_by(name: str, seconds: np.ndarray, note: str) -> None:
        frame[name], units[name] = seconds, "s"
        notes.append(note)

    if dates and times:
        joined = frame[dates[0]].astype(str) + " " + frame[times[0]].astype(str)
        seconds, changed = _seconds(joined, f"{where}: columns {dates[0]} and {times[0]}")
        frame = frame.drop(columns=dates[0])
        replace_by(times[0], seconds, f"time is {dates[0]} and {times[0]} together, in s from the first row")
        notes.extend(changed)
        stamped = [name for name in stamped if name not in (dates[0], times[0])]
    for name in stamped:
        read = _of_day if kinds[name] == "time" else _seconds
        seconds, changed = read(frame[name], f"{where}: column {name}")
        replace_by(name, seconds, f"{name} holds date stamps; taken as s from the first row")
        notes.extend(changed)
    return frame, units, notes


def _refuse_unknown_clock(frame: pd.DataFrame, where: str) -> None:
    """A table whose only time is text that can't be read would else pass for settled points."""
    named = [str(name) for name in frame.columns if _CLOCK_NAME.search(str(name))]
    if any(pd.api.types.is_numeric_dtype(frame[name]) for name in named):
        return
    for name in named:
        cells = frame[name].dropna()
        if len(cells) and is_stamp_text(str(cells.iloc[0])):
            raise InputError(f"{where}: column {name}", repr(cells.iloc[0]), "seconds, or a date and time such as "
                             "2026-05-01 14:15:47.250", "export the time in seconds, or in this form")  # fmt: skip


def first_stamp(frame: pd.DataFrame) -> datetime | None:
    """Date and time of the first row [UTC], where a column of date stamps says it; None without one."""
    for name in stamped_columns(frame):
        if _kind(frame[name]) in ("both", "date"):
            text = frame[name].dropna().astype(str)
            text = _spelt_plainly(text if "/" in text.iloc[0] else text.head(1))  # only there all rows tell the day
            stamp = pd.to_datetime(text.iloc[0], errors="coerce", dayfirst=bool(day_first(text)), utc=True)
            if not pd.isna(stamp):
                return datetime.fromtimestamp(stamp.timestamp(), UTC)
    return None


def _kind(column: pd.Series) -> str:
    """'date', 'time' (of day), or 'both'."""
    if pd.api.types.is_datetime64_any_dtype(column):
        return "both"
    first = column.dropna().iloc[0]
    if not isinstance(first, str):
        return {"date": "date", "time": "time"}.get(type(first).__name__, "both")
    has_day = bool(re.match(rf"\s*\d{{1,4}}[-./]\d{{1,2}}[-./]\d{{1,4}}|.*\b({MONTHS})", first, re.IGNORECASE))
    return "both" if has_day and ":" in first else "date" if has_day else "time"


def _spelt_plainly(text: pd.Series) -> pd.Series:
    """Stamps (n,) with a point before the fraction, English months, the year in its place and zones as offsets."""
    text = text.str.strip().str.replace(r"(:\d{2}),(\d+)", r"\1.\2", regex=True)
    text = text.str.replace(_COLON_FRACTION, r"\1.\2", regex=True)
    if not text.head(SAMPLE).str.contains("[A-SU-Ya-su-y]", regex=True).any():  # but for the T and Z of ISO 8601
        return text
    text = text.str.replace(_YEAR_LAST, r"\2 \1 \5 \3\4", regex=True)
    for german, english in _GERMAN_MONTHS.items():
        text = text.str.replace(rf"\b{german}\b", english, case=False, regex=True)
    return text.str.replace(_ZONE_NAME, _offset, regex=True)


def _offset(found: re.Match[str]) -> str:
    """'CEST' -> '+02:00', 'GMT+1' -> '+01:00'."""
    name, sign, hours, minutes = found.groups()
    total = 60 * ZONES[name.upper()] + (0 if sign is None else int(f"{sign}1") * (60 * int(hours) + int(minutes or 0)))
    return f"{'-' if total < 0 else '+'}{abs(total) // 60:02d}:{abs(total) % 60:02d}"


def day_first(text: pd.Series) -> bool | None:
    """Whether stamps (n,) name the day before the month; None where nothing tells, as by 05/03/2026 in every row.

    With points the day is first. Of two readings that are both dates, rows take the one that keeps them together.
    """
    if text.str.match(r"\d{1,2}\.").any():
        return True
    dates = text.str.extract(_SLASHED).dropna().drop_duplicates().astype(int)
    if (dates[0] > 12).any() or (dates[1] > 12).any():
        return bool((dates[0] > 12).any())
    by_day, by_month = (_travelled(dates[2], month, day) for month, day in ((dates[1], dates[0]), (dates[0], dates[1])))
    if by_day == by_month and (dates[0] != dates[1]).any():
        return None
    return by_day < by_month


def _travelled(year: pd.Series, month: pd.Series, day: pd.Series) -> float:
    """Days that dates (n,) go forward and back in all."""
    dates = pd.to_datetime(pd.DataFrame({"year": year % 100 + 2000, "month": month, "day": day}))
    return float(dates.diff().abs().sum() / pd.Timedelta(days=1))


def _seconds(column: pd.Series, where: str) -> tuple[np.ndarray, list[str]]:
    """Dates with times (n,) in s from the first row, and what was done about the clock."""
    notes: list[str] = []
    if not pd.api.types.is_datetime64_any_dtype(column):
        text = _spelt_plainly(column.astype(str))
        first = day_first(text)
        if first is None:
            notes.append(f"{text[column.notna()].iloc[0]} is read with the month first: no row tells it from the "
                         "day")  # fmt: skip
        parsed = pd.to_datetime(text, errors="coerce", dayfirst=bool(first), format="mixed", utc=True)
        _refuse_unread(parsed.isna().to_numpy() & column.notna().to_numpy(), column, where)
        local = not text.head(SAMPLE).str.contains(r"(?:Z|[+-]\d{2}:?\d{2})$", regex=True).any()
        column = parsed
    else:
        local = column.dt.tz is None
    stamps = (
        column.to_numpy(dtype="datetime64[ns]")
        if column.dt.tz is None
        else column.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")
    )
    known = stamps[~np.isnat(stamps)]
    steps = (stamps - known[0]) / np.timedelta64(1, "ns")
    seconds = np.where(np.isnat(stamps), np.nan, steps.astype(np.float64) * 1e-9)
    if not local:
        return seconds, notes
    since, changed = going_on(seconds, float((known[0] - known[0].astype("datetime64[D]")) / np.timedelta64(1, "s")))
    return since, [*notes, *changed]


def _of_day(column: pd.Series, where: str) -> tuple[np.ndarray, list[str]]:
    """Times of day (n,) in s from the first row, midnight crossed, and what was done about the clock."""
    text = column.astype(str).str.strip().str.replace(",", ".", regex=False)
    text = text.str.replace(_COLON_FRACTION, r"\1.\2", regex=True).str.replace(_ZONE_NAME, "", regex=True)
    if text.str.match(_MINUTES).all():
        parts = text.str.extract(_MINUTES).astype(float)
        seconds, period = (60.0 * parts[0] + parts[1]).to_numpy(), HOUR_S
    else:
        parsed = pd.to_timedelta(text.where(~text.str.contains("M", case=False)), errors="coerce")
        if text.str.contains(r"[AP]M", case=False).any():
            moments = pd.to_datetime(text, errors="coerce", format="mixed")
            parsed = moments - moments.dt.normalize()
        _refuse_unread(parsed.isna().to_numpy() & column.notna().to_numpy(), column, where)
        seconds, period = parsed.to_numpy(dtype="timedelta64[ns]") / np.timedelta64(1, "ns") * 1e-9, DAY_S
    turns = np.cumsum(np.r_[0.0, np.diff(seconds) < -0.5 * period])
    since = np.round(seconds + period * turns - seconds[0], 9)  # stamps have no more digits
    return going_on(since, float(seconds[0])) if period == DAY_S else (since, [])


def going_on(seconds: np.ndarray, began: float) -> tuple[np.ndarray, list[str]]:
    """Seconds (n,) of a local clock as if it hadn't been put back or forward by an hour, and notes.

    Args:
        seconds: from the first row [s].
        began: time of day of the first row [s].
    """
    steps = np.diff(seconds)
    if steps.size < 2 or not np.isfinite(steps).all():
        return seconds, []
    usual = float(np.median(np.abs(steps)))
    near = max(2.0 * usual, 1.0)
    back = np.abs(steps + HOUR_S - usual) <= near
    after = (began + seconds[1:]) % DAY_S
    changes = np.minimum(np.abs(after - SECOND_HOUR), np.abs(after - THIRD_HOUR)) <= near
    forward = (np.abs(steps - HOUR_S - usual) <= near) & changes
    if not back.any() and not forward.any():
        return seconds, []
    added = HOUR_S * np.cumsum(np.r_[0.0, back.astype(float) - forward.astype(float)])
    rows = [int(row) + 2 for row in np.flatnonzero(back | forward)]
    text = f"the clock is put {'back' if back.any() else 'forward'} by an hour at data row {rows[0]}: taken as going on"
    return seconds + added, [text]


def spread_evenly(seconds: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Seconds (n,) whose clock shows each value in several rows, spread between its steps, and a note."""
    steps = np.diff(seconds)
    if steps.size < 2 or not np.isfinite(steps).all() or (steps < 0.0).any() or np.mean(steps == 0.0) < REPEATED:
        return seconds, []
    shown, first, counts = np.unique(seconds, return_index=True, return_counts=True)
    if shown.size < 4:
        return seconds, []
    tick, rows = float(np.median(np.diff(shown))), float(np.median(counts[1:-1]))
    uneven = np.ptp(counts[1:-1]) > max(1.0, UNEVEN * rows)
    if uneven or np.mean(np.abs(np.diff(shown) - tick) > 1e-6 * tick) > 0.05:
        return seconds, []
    rank = np.arange(seconds.size) - np.repeat(first, counts)
    share = np.repeat(np.maximum(counts, rows), counts)
    late = np.where(np.repeat(np.arange(shown.size), counts) == 0, rows - counts[0], 0.0).clip(min=0.0)
    note = f"the clock steps by {tick:.3g} s, {rows:.0f} rows each: they are spread evenly in between"
    return seconds + tick * (rank + late) / share, [note]


def _refuse_unread(bad: np.ndarray, column: pd.Series, where: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InputError(
            f"{where}, data row {row + 1}",
            repr(column.iloc[row]),
            "a date or time as in the other rows",
            "mend or drop this row",
        )
