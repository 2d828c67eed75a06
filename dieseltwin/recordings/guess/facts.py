"""What a channel looks like: rate, range, holes, step, frozen or held. Nothing here knows what it could mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from dieseltwin.recordings.held import own_readings
from dieseltwin.recordings.importers.layout import told_unit, unit_in_name
from dieseltwin.recordings.importers.numeric_clocks import is_clock_name
from dieseltwin.recordings.importers.signals import RawChannels, Signal
from dieseltwin.recordings.time_units import SECONDS, likely_unit

GAP_STEPS = 3.0  # a pause longer than three usual steps is a gap
FEW_LEVELS = 0.5  # of the readings: a channel with fewer distinct values than that has a step to name
MOST_LEVELS = 20_000  # distinct values that are looked at for a step
EVEN = 0.02  # of the step: how well the levels fit a grid


@dataclass(frozen=True)
class Facts:
    """One channel in figures.

    Attributes:
        name, unit, spn, origin: as in the file.
        readings: number of values that are there.
        missing: share of values that are not [-].
        step_s: usual time between readings [s]; None without a clock.
        low, median, high: of the values [unit].
        gaps: how often a pause is longer than three steps, and `longest_gap_s` [s].
        frozen: one value throughout.
        resolution: smallest step between values [unit]; None where they are as good as continuous.
        levels: number of different values.
        held_rows: rows over which a reading is repeated; None where each row is its own.
    """

    name: str
    unit: str | None
    spn: int | None
    origin: str
    readings: int
    missing: float
    step_s: float | None
    low: float
    median: float
    high: float
    gaps: int
    longest_gap_s: float
    frozen: bool
    resolution: float | None
    levels: int
    held_rows: float | None


def signals_of(raw: RawChannels) -> dict[str, Signal]:
    """Every channel of numbers with its times: those of a table by its clock column (`clock_of`), None without one."""
    if raw.table is None:
        return dict(raw.signals)
    clock = clock_of(raw)
    times = None
    if clock is not None:
        times = raw.table[clock.name].to_numpy(dtype=np.float64) * clock.unit_s
    found = {}
    for column in raw.table.columns:
        values = raw.table[column]
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values):
            continue
        name = str(column)
        found[name] = Signal(name, raw.units.get(name) or unit_in_name(name), times, values.to_numpy(dtype=np.float64))
    return found


SPREADSHEET_DAYS = (3.6e4, 6.0e4)  # days since 1900 as spreadsheets count dates: 1998 to 2064


class Clock(NamedTuple):
    """The column of a table that is its time, and the size of its unit [s].

    `guessed_by` is its step where nothing but that says the unit, and it isn't taken as s.
    """

    name: str
    unit_s: float
    guessed_by: float | None = None


def clock_of(raw: RawChannels) -> Clock | None:
    """The column of a table that is its time; None where no column rises like one.

    Without a unit, seconds and milliseconds are told apart by which gives a sensible rate.
    """
    if raw.table is None:
        return None
    rising = []
    for column in raw.table.columns:
        values = raw.table[column]
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values) or len(values) < 2:
            continue
        steps = np.diff(values.to_numpy(dtype=np.float64))
        if not is_clock_name(str(column)):
            continue
        if np.isfinite(steps).all() and (steps >= 0).mean() > 0.98 and (steps > 0).any():
            repeats = bool((steps > 0).mean() <= 0.5)  # no clock of rows; where there is no other, the reader says so
            rising.append((repeats, str(column), float(np.median(steps[steps > 0]))))
    if not rising:
        return None
    _, name, step = min(rising, key=lambda item: (item[0], item[1] != "time_s", raw.names.index(item[1])))
    unit_s = told_unit(name, raw.units.get(name))
    if unit_s is not None:
        return Clock(name, unit_s)
    unit_s = likely_unit(step)
    days = SPREADSHEET_DAYS[0] < float(np.median(raw.table[name])) < SPREADSHEET_DAYS[1]
    told = unit_s == SECONDS["s"] or (unit_s == SECONDS["d"] and days)
    return Clock(name, unit_s, None if told else step)


def facts_of(signal: Signal) -> Facts:
    """The figures of one channel."""
    values = signal.values
    there = np.isfinite(values)
    readings = values[there]
    step, gaps, longest = None, 0, 0.0
    if signal.time_s is not None and np.count_nonzero(there) > 1:
        steps = np.diff(signal.time_s[there])
        step = float(np.median(steps))
        longest = float(steps.max())
        gaps = int(np.count_nonzero(steps > GAP_STEPS * step))
    held = own_readings(values)
    quantiles = np.quantile(readings, (0.0, 0.5, 1.0)) if readings.size else np.full(3, np.nan)
    return Facts(
        name=signal.name, unit=signal.unit, spn=signal.spn, origin=signal.origin, readings=int(readings.size),
        missing=1.0 - readings.size / max(values.size, 1), step_s=step, low=float(quantiles[0]),
        median=float(quantiles[1]), high=float(quantiles[2]), gaps=gaps, longest_gap_s=longest if gaps else 0.0,
        frozen=bool(readings.size > 1 and quantiles[0] == quantiles[2]), resolution=_resolution(readings),
        levels=int(np.unique(readings).size),
        held_rows=None if held is None else values.size / max(int(np.count_nonzero(held)), 1),
    )  # fmt: skip


def _resolution(readings: np.ndarray) -> float | None:
    """The grid that all values lie on, where they are few enough to have one."""
    levels = np.unique(readings)
    if not 2 <= levels.size <= min(MOST_LEVELS, FEW_LEVELS * readings.size):
        return None
    steps = np.diff(levels)
    smallest = float(steps.min())
    multiples = steps / smallest
    return smallest if np.all(np.abs(multiples - np.rint(multiples)) < EVEN * np.maximum(multiples, 1.0)) else None
