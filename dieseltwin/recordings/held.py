"""Channels slower than the table they stand in: rows in which they were really read, and the step of their numbers.

A logger repeats a slow channel until its next reading. A repeated row is no reading: counted as one, it says that the
engine stood still, and hides the noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array

_FEWEST_CHANGES = 8  # by chance eight changes all fall on every second row once in 256 tries
_OFF_RASTER = 0.05  # of the gaps between changes may be off the raster: pauses, lost messages
_USUAL_GAP = 2.0  # periods: where most gaps are longer, the value moves seldom, and the raster can't be told
_LONGEST_LINE = 3.0  # periods
_LONGEST_HOLD = 100.0  # rows; beyond, a channel is frozen, not held
_MOSTLY_REPEATED = 0.5  # of the rows between two readings hold a number where a channel is held
_DIGITS = 6  # of a number; a step below is none
_SMALLEST_STEP = 1e-6  # of a channel's range: differences below are rounding


def own_readings(values: Array) -> NDArray[np.bool_] | None:
    """Rows in which a held channel was really read; None where every row is a reading of its own.

    The changes of a held channel are never nearer to each other than its period, which need not be a whole number of
    rows (2 Hz in rows of 5 Hz change after two and three rows in turn). Readings that repeat the number before are
    counted where the raster puts them.

    Args:
        values: (n,) one column, NaN where missing.

    Returns:
        (n,) True where it was read, or None.
    """
    rows = np.flatnonzero(np.isfinite(values))
    changes = rows[1:][np.diff(values[rows]) != 0.0]
    if changes.size < _FEWEST_CHANGES:
        return None
    gaps = np.diff(changes)
    least = float(np.quantile(gaps, _OFF_RASTER, method="lower"))
    if not 2.0 <= least <= _LONGEST_HOLD:
        return None
    period = float(gaps[(gaps >= least) & (gaps <= least + 1.0)].mean())
    counts = np.maximum(np.rint(gaps / period), 1.0)
    single = counts == 1.0
    period = float(gaps[single].mean()) if single.any() else period
    off = np.abs(gaps - counts * period) > 1.0
    if np.median(counts) > _USUAL_GAP or off[counts <= _USUAL_GAP].mean() > _OFF_RASTER:
        return None
    read = np.zeros(values.size, dtype=bool)
    read[changes] = True
    for start, gap, count in zip(changes[:-1], gaps, counts, strict=True):
        read[start + np.rint(gap * np.arange(1, int(count)) / count).astype(int)] = True
    before = changes[0] - period * np.arange(1, round(changes[0] / period) + 1)
    after = changes[-1] + period * np.arange(1, int((values.size - 1 - changes[-1]) / period) + 1)
    read[np.rint(np.concatenate([np.maximum(before, 0.0), after])).astype(int)] = True
    if np.isfinite(values[~read]).mean() <= _MOSTLY_REPEATED:
        return None  # nothing stands between the readings: the channel is slow, and says so
    return read & np.isfinite(values)


def between_readings(values: Array) -> Array:
    """A slow column (n,) with straight lines between its readings, at most three of its own periods long; others as
    they are."""
    every = rows_between_readings(values)
    if not 1.0 < every < np.inf:
        return values
    rows, at = np.flatnonzero(np.isfinite(values)), np.arange(values.size)
    after = np.clip(np.searchsorted(rows, at), 1, rows.size - 1)
    near = (rows[after] - rows[after - 1] <= _LONGEST_LINE * every) & (at >= rows[0]) & (at <= rows[-1])
    return np.where(near, np.interp(at, rows, values[rows]), values)


def rows_between_readings(values: Array) -> float:
    """Median distance of neighbouring readings of one column (n,), NaN where missing [rows]; inf with less than two."""
    rows = np.flatnonzero(np.isfinite(values))
    return float(np.median(np.diff(rows))) if rows.size > 1 else float("inf")


def number_step(values: Array) -> float:
    """Smallest difference between the numbers that a column (n,) holds [its unit]; 0 for fewer than two numbers."""
    numbers = np.unique(values[np.isfinite(values)])
    if numbers.size < 2:
        return 0.0
    steps = np.diff(numbers)
    return float(steps[steps > _SMALLEST_STEP * (numbers[-1] - numbers[0])].min())


def decimal_step(values: Array) -> float:
    """Largest of 1, 2 and 5 times a power of ten of which all numbers of a column (n,) are multiples [its unit].

    For a column that never moves, whose step no difference shows; 0 without numbers other than zero.
    """
    numbers = np.unique(values[np.isfinite(values)])
    largest = float(np.abs(numbers).max(initial=0.0))
    if largest == 0.0:
        return 0.0
    top = int(np.floor(np.log10(largest)))
    for step in (factor * 10.0**power for power in range(top, top - _DIGITS, -1) for factor in (5.0, 2.0, 1.0)):
        if (np.abs(numbers / step - np.rint(numbers / step)) < _SMALLEST_STEP).all():
            return step
    return 0.0
