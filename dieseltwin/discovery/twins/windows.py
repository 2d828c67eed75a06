"""A recording as windows: rows of its running pieces one after another, and where each window starts."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.recordings.reader import HISTORY_S, Recording


def windows_of(recording: Recording, window_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of all pieces one after another, first sample of every window, first sample of every piece."""
    rows: list[np.ndarray] = []
    starts: list[int] = []
    pieces: list[int] = []
    at = 0
    for piece in recording.pieces():
        time = recording.time_s[piece]
        if time[-1] - time[0] < max(HISTORY_S, 0.5 * window_s):
            continue
        count = max(1, round((time[-1] - time[0]) / window_s))
        edges = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[:-1])
        pieces.append(at)
        starts.extend(int(at + e) for e in edges)
        rows.append(np.arange(piece.start, piece.stop))
        at += piece.stop - piece.start
    if not rows:
        raise InputError(
            f"{recording.path or 'recording'}", "no stretch with the engine running", f"{window_s:g} s in one piece",
            "record longer",
        )  # fmt: skip
    return np.concatenate(rows), np.array(starts, dtype=np.int64), np.array(pieces, dtype=np.int64)


def without_gaps(time: Array, pieces: np.ndarray) -> Array:
    """Time stamps with the holes between pieces closed to one sample; the states start anew there anyway."""
    out = time - time[0]
    step = float(np.median(np.diff(time)))
    for start in pieces[1:]:
        out[start:] -= out[start] - out[start - 1] - step
    return out


def piece_start(pieces: np.ndarray, row: int) -> int:
    return int(pieces[np.searchsorted(pieces, row, side="right") - 1])
