"""Rows of a sensor's column that are no readings: repeated by a logger, or of a sensor that is stuck."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.notes import Note
from dieseltwin.recordings.channels import MEASURED
from dieseltwin.recordings.held import own_readings

Rows = NDArray[np.int_]

STUCK_S = 30.0
"""The same reading for so long, while the engine's speed moves, is a stuck sensor."""

_MOVES = 0.25  # of the spread of an input over the recording, from which the engine can't have stood still beside it
_MOST_STUCK = 0.5  # of a channel's readings; beyond, it is no channel at all, and other checks say so


def held_unread(columns: dict[str, np.ndarray]) -> list[str]:
    """Mask the repeated rows of sensors that were read more slowly than the table goes; say so."""
    notes = []
    for name in (name for name in MEASURED if name in columns):
        read = own_readings(columns[name])
        if read is not None:
            every = columns[name].size / np.count_nonzero(read)
            columns[name] = np.where(read, columns[name], np.nan)
            notes.append(f"{name} is held: a new reading every {every:.3g} rows, the repeated ones count as missing")
    return notes


def stuck_unread(columns: dict[str, np.ndarray]) -> list[str]:
    """Mask the readings of sensors that are stuck for a while; say so.

    A stuck pressure looks like an offset that comes and goes. Only where speed or fuel move as well as elsewhere: an
    idling engine repeats the numbers of a coarse channel, and no flow through a shut valve stands still rightly.
    """
    notes: list[str] = []
    time = columns["time_s"]
    for name in (name for name in MEASURED if name in columns and name != "w_egr_kg_s"):
        values = columns[name]
        rows = np.flatnonzero(np.isfinite(values))
        if rows.size < 2:
            continue
        stuck = [part for part in _long_unchanged(time, values) if _moves(columns, part)]
        if not stuck or sum(np.isfinite(values[part]).sum() for part in stuck) > _MOST_STUCK * rows.size:
            continue
        columns[name] = values.copy()
        for part in stuck:
            columns[name][part] = np.nan
            notes.append(Note(f"{name} stands still from {time[part.start]:.0f} to {time[part.stop - 1]:.0f} s while "
                              "the engine moves: its sensor is stuck, and its readings there count as missing",
                              "frozen_channel", (name,)))  # fmt: skip
    return notes


def _long_unchanged(time: Array, values: Array) -> list[slice]:
    """Where the same reading stands for `STUCK_S` or longer."""
    firsts, lasts = same_readings(values)
    long = time[lasts] - time[firsts] >= STUCK_S
    return [slice(first, last + 1) for first, last in zip(firsts[long], lasts[long], strict=True)]


def _moves(columns: dict[str, np.ndarray], part: slice) -> bool:
    """Whether speed or fuel move in a part of a recording as they do in all of it."""
    inputs = [columns[name] for name in ("n_e_rpm", "u_delta_mg")]
    return any(np.nanstd(values[part]) > _MOVES * np.nanstd(values) for values in inputs)


def standstills(time: Array, values: Array, speed: Array) -> Array:
    """(n,) 1 where the same reading stands for `STUCK_S` or longer while the engine's speed moves, else 0.

    Args:
        time: (n,) [s]; values: (n,) with two readings or more; speed: (n,) of the engine.
    """
    out = np.zeros(time.size)
    for rows in _long_unchanged(time, values):
        out[rows] = float(np.nanstd(speed[rows]) > 0.0)
    return out


def same_readings(values: Array) -> tuple[Rows, Rows]:
    """First and last row of every stretch of one and the same reading, missing readings passed over."""
    rows = np.flatnonzero(np.isfinite(values))
    changes = np.flatnonzero(np.diff(values[rows]) != 0.0)
    return rows[np.r_[0, changes + 1]], rows[np.r_[changes, rows.size - 1]]
