"""How the size of an effect goes over time: since when, until when, gone in between, at once or growing."""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import Array

Spans = tuple[tuple[float, float], ...]
"""Parts of the time, from the first to before the second of each [s], in order."""
_LEAST_S = 1.0  # that growing takes


def course(
    time_s: Array,
    onset_s: float | None = None,
    until_s: float | None = None,
    grown_s: float | None = None,
    gone_s: Spans = (),
) -> Array:
    """(n,) share of its size that an effect has.

    Args:
        time_s: (n,) [s].
        onset_s: since when [s]; None: from the start.
        until_s: before when [s]; None: to the end.
        grown_s: it grows evenly from nothing at the onset to its whole size at this time, which it keeps [s]; None: its
            size is the same all along.
        gone_s: spans in between in which it is gone, each from its first time to before its second [s].
    """
    share = np.ones(time_s.shape)
    if grown_s is not None:
        first = float(time_s[0]) if onset_s is None else onset_s
        share = np.clip((time_s - first) / growing_s(first, grown_s), 0.0, 1.0)
    if onset_s is not None:
        share[time_s < onset_s] = 0.0
    if until_s is not None:
        share[time_s >= until_s] = 0.0
    for gone, again in gone_s:
        share[(time_s >= gone) & (time_s < again)] = 0.0
    return share


def growing_s(first_s: float, grown_s: float) -> float:
    """How long an effect grows [s]."""
    return max(grown_s - first_s, _LEAST_S)
