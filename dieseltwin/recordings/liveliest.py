"""The liveliest stretches of a long recording, spread over all of it: judged in bounded time and memory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording

STRETCH_S = 120.0
"""Length of a stretch [s]: ten windows of discovery, of which the first seconds of one are lost to the actuators."""

_MOST_ROWS_TIMES_RECORDINGS = 400_000  # in one verdict: 25 recordings of two minutes at 5 Hz take 8 GB
_PLACES = 8  # a share of the recording is searched for its liveliest stretch at so many places
_WORTH_IT = 1.25  # times the minutes wanted: less isn't cut


def liveliest(recording: Recording, minutes: float) -> Recording:
    """The recording without the rows between its liveliest stretches; as it is where it is hardly longer than asked.

    The time with the engine running is cut into equal shares, and each gives the two minutes in which the inputs vary
    most: so nothing that comes or goes in the course of hours is missed, and standing still isn't judged.

    Args:
        recording: of any length.
        minutes: of driving that are wanted.
    """
    pieces = recording.pieces()
    time = recording.time_s
    running = recording.running_s
    if running <= _WORTH_IT * 60.0 * minutes:
        return recording
    count = max(1, round(60.0 * minutes / STRETCH_S))
    share = running / count
    kept = np.zeros(time.size, dtype=bool)
    inputs = np.stack([recording.columns[name] for name in INPUTS])
    rows = np.concatenate([np.arange(piece.start, piece.stop) for piece in pieces])
    inputs /= np.maximum(np.nanstd(inputs[:, rows], axis=1, keepdims=True), 1e-12)
    begun = np.concatenate([[0.0], np.cumsum([float(time[p.stop - 1] - time[p.start]) for p in pieces])])
    for k in range(count):
        best: tuple[float, slice] | None = None
        for place in np.linspace(k * share, (k + 1) * share - STRETCH_S, _PLACES):
            at = int(np.searchsorted(begun, place, side="right")) - 1
            piece = pieces[at]
            start = min(float(time[piece.start]) + place - begun[at], float(time[piece.stop - 1]) - STRETCH_S)
            first, last = np.searchsorted(time, (max(start, float(time[piece.start])), start + STRETCH_S))
            found = slice(int(first), min(int(last), piece.stop))
            if found.stop - found.start < 2:
                continue
            variety = float(np.nanvar(inputs[:, found], axis=1).sum()) * (found.stop - found.start)
            if best is None or variety > best[0]:
                best = variety, found
        if best is not None:
            kept[best[1]] = True
    columns = {name: v[kept] for name, v in recording.columns.items()}
    return replace(recording, time_s=time[kept], columns=columns, cut_from_s=recording.start_s)


def minutes_of(recording: Recording, count: int, most: float) -> float:
    """Minutes of one of several recordings [min] that memory bears: each has unknowns of its own at all rows of all.

    Raises:
        InputError: so many recordings that less than a stretch of each would be left.
    """
    if count == 1:
        return most
    step_s = float(np.median(np.diff(recording.time_s)))
    minutes = _MOST_ROWS_TIMES_RECORDINGS * step_s / 60.0 / count**2
    if minutes < STRETCH_S / 60.0:
        fitting = math.isqrt(int(_MOST_ROWS_TIMES_RECORDINGS * step_s / STRETCH_S))
        raise InputError("recordings", f"{count} recordings in one verdict",
                         f"{fitting} at most with readings every {step_s:.2g} s",
                         "judge them in parts, or keep them in a history (`dieseltwin watch`)")  # fmt: skip
    return min(most, minutes)
