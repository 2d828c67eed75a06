"""What slow rows leave open of the engine's inputs, and what that does to the readings of a segment.

Rows of 1 or 2 Hz don't say what the inputs did in between. Straight lines taken as exact make a likelihood sure and
wrong; errors of a known size widen its intervals and let calm stretches count for more (`learned.ErrorDirections`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine import Inputs
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.shooting import Shooting, Simulator
from dieseltwin.recordings.reader import FULL_HZ, RATE_TOLERANCE

Array = NDArray[np.float64]

_NODES = 2  # between two rows: an input that jumps early and one that jumps late act differently
_AT = np.arange(1, _NODES + 1) / (_NODES + 1)
_BRIDGE = 4.0 * (np.minimum.outer(_AT, _AT) - np.outer(_AT, _AT))
"""Covariance of what an input does at the nodes beside a straight line, 1 in the middle: that of a Brownian bridge,
which is also that of a step at any time."""

_STEP = 0.1  # of a standard deviation: the EGR flow has a kink
_STEP_S = 0.025  # of integration [s]
_FORGOTTEN_S = 20.0  # until the turbo's speed has forgotten what an input did for a moment [s]
_TOGETHER = 128  # simulations; the inputs of one take 300 kB


def input_errors(problem: SegmentProblem, simulator: Simulator, unknowns: Array) -> Array:
    """Changes of the readings by what the inputs may have done between two rows, a standard deviation each.

    Args:
        problem: the segment.
        simulator: exact engine or one with learned maps.
        unknowns: (7,) logarithms about which to linearise.

    Returns:
        (M, n, C) changes of the readings [SI]; M is 0 where rows are fast enough to see the inputs move.
    """
    rows, every = problem.inputs, _NODES + 1
    if float(np.median(np.diff(rows.time_s))) <= RATE_TOLERANCE / FULL_HZ:
        return np.zeros((0, *problem.measured.shape))
    time = rows.time_s
    fine_s = np.interp(np.arange(every * (time.size - 1) + 1) / every, np.arange(time.size), time)
    columns = {name: np.interp(fine_s, time, values) for name, values in rows.columns.items()}
    before = every * rows.n_history
    nothing = np.full((fine_s.size - before, problem.measured.shape[1]), np.nan)

    def driven_by(inputs: dict[str, Any]) -> SegmentProblem:
        fine = Inputs(fine_s, **inputs, n_history=before, start_s=rows.start_s)
        return replace(problem, inputs=fine, measured=nothing, noise_draws=None)

    apart = min(int(np.ceil(_FORGOTTEN_S / float(np.median(np.diff(time))))), time.size - 1)  # moved in one simulation
    after = np.arange(problem.measured.shape[0]) + rows.n_history - np.arange(time.size - 1)[:, None]
    own = (after > 0) & (after <= apart)  # (intervals, n) rows in which an interval shows
    lanes: list[SegmentProblem] = []
    for name, values in columns.items():
        std = unseen(rows.columns[name])
        for first in range(apart):
            for node in range(1, every):
                moved = values.copy()
                moved[every * first + node :: every * apart] += _STEP * std[first::apart]
                lanes.append(driven_by({**columns, name: moved}))
    base = driven_by(columns)
    parts = [_moved((base, *lanes[k : k + _TOGETHER]), simulator, unknowns) for k in range(0, len(lanes), _TOGETHER)]
    changes = np.concatenate(parts)[:, ::every].reshape(len(columns), apart, _NODES, *problem.measured.shape) / _STEP
    single = changes[:, np.arange(time.size - 1) % apart] * own[:, None, :, None]
    found = np.einsum("cikab,kj->cijab", single, np.linalg.cholesky(_BRIDGE))
    return np.asarray(found.reshape(-1, *problem.measured.shape))


def _moved(problems: tuple[SegmentProblem, ...], simulator: Simulator, unknowns: Array) -> Array:
    """Readings (B - 1, n, C) of all problems but the first one, less those of the first [SI]."""
    lanes = np.broadcast_to(unknowns, (len(problems), unknowns.size))
    measured = Shooting(problems, simulator, _STEP_S).simulate(np.arange(len(problems)), lanes).measured
    return np.asarray(measured[1:] - measured[0])


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
