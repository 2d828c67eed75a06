"""Holes of the inputs: short ones are bridged when a recording is made, longer ones split it."""

from __future__ import annotations

import numpy as np

from dieseltwin.recordings.channels import INPUTS, OPTIONAL_INPUTS, TIME

LONGEST_GAP_S = 1.0
JITTER = 1.5  # steps: rows of 1 Hz that are 1.01 s apart are no gap


def longest_gap(time_s: np.ndarray) -> float:
    """The longest time between two rows (n,) of one piece [s]."""
    return max(LONGEST_GAP_S, JITTER * float(np.median(np.diff(time_s))))


def bridge_inputs(columns: dict[str, np.ndarray]) -> list[str]:
    """Fill holes of inputs that split nothing by straight lines; a sentence for each column.

    Args:
        columns: our column names -> (n,) [SI], time among them; replaced where they are bridged.
    """
    time, notes = columns[TIME], []
    for name in (name for name in (*INPUTS, *OPTIONAL_INPUTS) if name in columns):
        values = columns[name]
        there, missing = np.flatnonzero(np.isfinite(values)), np.flatnonzero(~np.isfinite(values))
        after = np.searchsorted(there, missing)  # number of the next row that is there
        inside = (after > 0) & (after < there.size)
        missing, after = missing[inside], after[inside]
        filled = missing[time[there[after]] - time[there[after - 1]] <= longest_gap(time)]
        if filled.size:
            columns[name] = values.copy()
            columns[name][filled] = np.interp(time[filled], time[there], values[there])
            notes.append(f"{filled.size} missing values of {name} are bridged by straight lines")
    return notes
