"""Recordings among several that the others' explanation doesn't fit."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import JudgedRecording
from dieseltwin.notes import Note

_FAR_WORSE = 2.0  # times what is left in the others; six recordings of one engine, a leak in them or none, leave 1.2


def rows_of_each(time_s: Array, recordings: Sequence[JudgedRecording]) -> list[slice]:
    """Rows (n,) of each of several recordings on the axis on which they follow each other, a second apart."""
    begins = [0]
    for one in recordings[:-1]:
        begins.append(int(np.searchsorted(time_s, time_s[begins[-1]] + one.duration_s + 0.5)))
    return [slice(first, last) for first, last in pairwise([*begins, len(time_s)])]


def odd_recordings(found: Discovery) -> list[Note]:
    """A note on recordings that are explained far worse than the others: one of another engine among them, say."""
    curves, recordings = found.curves, found.document.recordings
    if not recordings:
        return []
    squares = ((curves.measured - curves.after) / curves.sigma) ** 2
    left = [float(np.sqrt(np.nanmean(squares[rows]))) for rows in rows_of_each(curves.time_s, recordings)]
    notes = []
    for r, (one, own) in enumerate(zip(recordings, left, strict=True)):
        others = float(np.median([*left[:r], *left[r + 1 :]]))
        if own > _FAR_WORSE * max(others, 1.0):
            notes.append(Note(
                f"{one.path} is explained far worse than the others ({own:.1f} times the noise is left, {others:.1f} "
                "in them): it may be of another engine, or a sensor may be off in it; judge it by itself, and the "
                "others without it", "wrong_engine"))  # fmt: skip
    return notes
