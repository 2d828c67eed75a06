"""Error codes of loggers among the readings: numbers that stand where there was no reading."""

from __future__ import annotations

import numpy as np

from dieseltwin.symbols import BY_COLUMN

ERROR_CODES = (-999.0, -9999.0, -99999.0, -32768.0)
"""What loggers write where there is no reading, in the unit that they write in."""
MOST_CODES = 0.5  # of the rows; a channel with more of them shows nothing


def without_codes(column: str, written: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """A column (n,) with what the logger wrote as an error code made missing, and a note.

    -999 Pa below the ambient is a reading, and no pressure is 999 bar below it: a code counts as one where no engine
    has the value that it stands for.

    Args:
        column: our name.
        written: (n,) in the logger's unit.
        values: (n,) the same in ours; with our own names the same numbers.
    """
    if column not in BY_COLUMN:
        return values, []
    return _without(column, written, values, BY_COLUMN[column].low, BY_COLUMN[column].high)


def without_outlying_codes(column: str, values: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """The same of a column whose range nobody knows: a code lies beyond all other values by more than their span."""
    others = values[np.isfinite(values) & ~np.isin(values, ERROR_CODES)]
    if not others.size:
        return values, []
    low, high = float(others.min()), float(others.max())
    return _without(column, values, values, 2.0 * low - high, 2.0 * high - low)


def _without(
    column: str, written: np.ndarray, values: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, list[str]]:
    coded = np.isin(written, ERROR_CODES) & ((values < low) | (values > high))
    codes = int(np.count_nonzero(coded))
    if not 0 < codes <= MOST_CODES * coded.size:
        return values, []
    note = f"{codes} values of {column} are an error code ({written[coded][0]:g}) and count as missing"
    return np.where(coded, np.nan, values), [note]
