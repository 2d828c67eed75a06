"""Date stamps into seconds: a column of dates or times of day becomes seconds from its first row."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.layout import is_date

DAY_S = 86400.0
SAMPLE = 20  # rows that decide whether a column holds stamps; a bad one among them is a bad stamp
_COLON_FRACTION = re.compile(r"(\d{1,2}:\d{2}:\d{2}):(\d{1,6})$")  # 12:00:00:250, hundredths or ms after a colon


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

    A column of dates beside one of times of day is taken together with it.

    Returns:
        The table, the unit of each replaced column, and notes.

    Raises:
        InputError: a stamp that is none.
    """
    stamped = stamped_columns(frame)
    if not stamped:
        return frame, {}, []
    frame = frame.copy()
    kinds = {name: _kind(frame[name]) for name in stamped}
    dates = [name for name in stamped if kinds[name] == "date"]
    times = [name for name in stamped if kinds[name] == "time"]
    units, notes = {}, []
    if dates and times:
        joined = frame[dates[0]].astype(str) + " " + frame[times[0]].astype(str)
        frame[times[0]] = _seconds(joined, f"{where}: columns {dates[0]} and {times[0]}")
        frame = frame.drop(columns=dates[0])
        notes.append(f"time is {dates[0]} and {times[0]} together, in s from the first row")
        units[times[0]] = "s"
        stamped = [name for name in stamped if name not in (dates[0], times[0])]
    for name in stamped:
        if kinds[name] == "time":
            frame[name] = _of_day(frame[name], f"{where}: column {name}")
        else:
            frame[name] = _seconds(frame[name], f"{where}: column {name}")
        notes.append(f"{name} holds date stamps; taken as s from the first row")
        units[name] = "s"
    return frame, units, notes


def first_stamp(frame: pd.DataFrame) -> datetime | None:
    """Date and time of the first row [UTC], where a column of date stamps says it; None without one."""
    for name in stamped_columns(frame):
        if _kind(frame[name]) in ("both", "date"):
            day_first = bool(re.match(r"\s*\d{1,2}\.", str(frame[name].dropna().iloc[0])))
            stamp = pd.to_datetime(str(frame[name].dropna().iloc[0]), errors="coerce", dayfirst=day_first, utc=True)
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
    has_day = bool(re.match(r"\s*\d{1,4}[-./]\d{1,2}[-./]\d{1,4}", first))
    return "both" if has_day and ":" in first else "date" if has_day else "time"


def _seconds(column: pd.Series, where: str) -> np.ndarray:
    if not pd.api.types.is_datetime64_any_dtype(column):
        text = column.astype(str).str.strip().str.replace(r"(:\d{2}),(\d+)", r"\1.\2", regex=True)
        text = text.str.replace(_COLON_FRACTION, r"\1.\2", regex=True)
        day_first = bool(text.str.match(r"\d{1,2}\.").any()) or bool(
            (text.str.extract(r"^(\d{1,2})/")[0].astype(float) > 12).any()
        )
        parsed = pd.to_datetime(text, errors="coerce", dayfirst=day_first, format="mixed", utc=True)
        _refuse_unread(parsed.isna().to_numpy() & column.notna().to_numpy(), column, where)
        column = parsed
    stamps = (
        column.to_numpy(dtype="datetime64[ns]")
        if column.dt.tz is None
        else column.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy(dtype="datetime64[ns]")
    )
    known = stamps[~np.isnat(stamps)]
    steps = (stamps - known[0]) / np.timedelta64(1, "ns")
    return np.where(np.isnat(stamps), np.nan, steps.astype(np.float64) * 1e-9)


def _of_day(column: pd.Series, where: str) -> np.ndarray:
    """Times of day in s from the first row, midnight crossed."""
    text = column.astype(str).str.strip().str.replace(",", ".", regex=False)
    text = text.str.replace(_COLON_FRACTION, r"\1.\2", regex=True)
    parsed = pd.to_timedelta(text.where(~text.str.contains("M", case=False)), errors="coerce")
    if text.str.contains(r"[AP]M", case=False).any():
        moments = pd.to_datetime(text, errors="coerce", format="mixed")
        parsed = moments - moments.dt.normalize()
    _refuse_unread(parsed.isna().to_numpy() & column.notna().to_numpy(), column, where)
    seconds = parsed.to_numpy(dtype="timedelta64[ns]") / np.timedelta64(1, "ns") * 1e-9
    days = np.cumsum(np.r_[0.0, np.diff(seconds) < -0.5 * DAY_S])
    return np.round(seconds + DAY_S * days - seconds[0], 9)  # stamps have no more digits


def _refuse_unread(bad: np.ndarray, column: pd.Series, where: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InputError(
            f"{where}, data row {row + 1}",
            repr(column.iloc[row]),
            "a date or time as in the other rows",
            "mend or drop this row",
        )
