"""What the inputs may have done between slow rows: how far from a straight line, judged by the recording itself.

Straight lines taken as exact make a likelihood sure and wrong. Errors of a known size, simulated at a few nodes between
two rows, belong to the covariance of the readings (`identification.input_errors`, `discovery.twins.diesel_between`).
"""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.recordings.reader import FULL_HZ, RATE_TOLERANCE

NODES = 2
"""Between two rows: an input that jumps early and one that jumps late act differently."""

_AT = np.arange(1, NODES + 1) / (NODES + 1)
BRIDGE = 4.0 * (np.minimum.outer(_AT, _AT) - np.outer(_AT, _AT))
"""Covariance of what an input does at the nodes beside a straight line, 1 in the middle: that of a Brownian bridge,
which is also that of a step at any time."""

_SURELY_SEEN_S = 0.09  # between two rows

DIFFERENCE = 0.1
"""Of a standard deviation, for responses: the EGR flow has a kink."""


def rows_are_slow(time_s: Array) -> bool:
    """Whether rows (n,) [s] are too slow to see the inputs move."""
    return float(np.median(np.diff(time_s))) > RATE_TOLERANCE / FULL_HZ


def rows_may_be_slow(time_s: Array) -> bool:
    """Whether inputs may move between rows (n,) [s] that are fast enough for engines that are driven calmly."""
    return float(np.max(np.diff(time_s), initial=0.0)) > _SURELY_SEEN_S


def with_nodes(time_s: Array) -> Array:
    """Times of rows (n,) [s] with those of the nodes between them, (m,) [s]."""
    every = NODES + 1
    at = np.arange(every * (time_s.size - 1) + 1) / every
    return np.asarray(np.interp(at, np.arange(time_s.size), time_s))


def unseen(values: Array) -> Array:
    """How far a channel may be from a straight line in the middle between two rows, (n - 1,) standard deviations.

    It bends there as it does at the two rows. How much of that, the channel says itself: each row is foretold by the
    same rule from every second row.

    Args:
        values: (n,) the channel.
    """
    bend = np.zeros(values.size)
    bend[1:-1] = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    wide = np.zeros(values.size)
    wide[2:-2] = values[2:-2] - 0.5 * (values[:-4] + values[4:])
    foretold = 0.5 * float((wide[2:-4] ** 2 + wide[4:-2] ** 2).sum())
    share = float((bend[3:-3] ** 2).sum()) / foretold if foretold > 0.0 else 1.0
    return np.asarray(np.sqrt(0.5 * min(share, 1.0) * (bend[:-1] ** 2 + bend[1:] ** 2)))
