"""A recording as windows: rows of its running pieces one after another, and where each window starts."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.errors import InputError
from dieseltwin.recordings.held import between_readings, rows_between_readings
from dieseltwin.recordings.reader import HISTORY_S, Recording

_SPEED_SPAN = 0.03  # of the smoothed reading; its noise is 0.5 %, its sensor's tolerance the same
_SLOW_SPEED_SPAN = 0.1  # where the reading comes less often than the rows: the turbo moves between two
_UNSEEN_SPEED_SPAN = 0.4
_SMOOTHED = 7  # samples about a window's start for the first guess of its states


def window_of_rows(starts: np.ndarray, n: int) -> np.ndarray:
    """(n,) window that each row lies in, by the windows' first rows (W,)."""
    return np.searchsorted(starts, np.arange(n), side="right") - 1


def ends_of(starts: np.ndarray, n: int) -> np.ndarray:
    """(W,) first row behind each window of n rows."""
    return np.append(starts[1:], n)


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


def smoothed_at(
    starts: np.ndarray, pieces: np.ndarray, time: Array, values: Array, otherwise: Array
) -> Array:
    """Columns (n, k) at the windows' starts from straight lines through the samples about them, (W, k).

    Args:
        starts, pieces: first samples of the windows and of the pieces.
        time: (n,) [s].
        values: (n, k), NaN where missing; otherwise: (n, k) in their place where fewer than three are near.
    """
    out = otherwise[starts].copy()
    half = _SMOOTHED // 2
    for w, start in enumerate(starts):
        first = max(start - half, piece_start(pieces, start))
        near, t = values[first : start + half + 1], time[first : start + half + 1] - time[start]
        for j in range(values.shape[1]):
            good = np.isfinite(near[:, j])
            if good.sum() >= 3:
                out[w, j] = _line_at_zero(t[good].tobytes(), near[good, j].tobytes())
    return out


@lru_cache(maxsize=4096)
def _line_at_zero(times: bytes, values: bytes) -> float:
    """Where a straight line through some samples is at the time 0. Twins of one recording ask for the same ones."""
    return float(np.polyfit(np.frombuffer(times), np.frombuffer(values), 1)[1])


def piece_start(pieces: np.ndarray, row: int) -> int:
    return int(pieces[np.searchsorted(pieces, row, side="right") - 1])


def speed_span(readings: Array) -> float:
    """How far the turbo speed at a window's start may be from what its readings (n,) say there [-]."""
    if np.isfinite(between_readings(readings)).mean() < 0.5:
        return _UNSEEN_SPEED_SPAN
    return _SLOW_SPEED_SPAN if rows_between_readings(readings) > 1.0 else _SPEED_SPAN
