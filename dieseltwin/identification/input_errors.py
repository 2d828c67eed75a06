"""What slow rows leave open of the engine's inputs, and what that does to the readings of a segment.

Rows of 1 or 2 Hz don't say what the inputs did in between. Straight lines taken as exact make a likelihood sure and
wrong; errors of a known size widen its intervals and let calm stretches count for more (`learned.ErrorDirections`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.engine import Inputs
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.shooting import Shooting, Simulator
from dieseltwin.recordings.between_rows import BRIDGE, DIFFERENCE, NODES, rows_are_slow, unseen, with_nodes

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
    rows, every = problem.inputs, NODES + 1
    if not rows_are_slow(rows.time_s):
        return np.zeros((0, *problem.measured.shape))
    time = rows.time_s
    fine_s = with_nodes(time)
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
                moved[every * first + node :: every * apart] += DIFFERENCE * std[first::apart]
                lanes.append(driven_by({**columns, name: moved}))
    base = driven_by(columns)
    parts = [_moved((base, *lanes[k : k + _TOGETHER]), simulator, unknowns) for k in range(0, len(lanes), _TOGETHER)]
    changes = np.concatenate(parts)[:, ::every] / DIFFERENCE
    changes = changes.reshape(len(columns), apart, NODES, *problem.measured.shape)
    single = changes[:, np.arange(time.size - 1) % apart] * own[:, None, :, None]
    found = np.einsum("cikab,kj->cijab", single, np.linalg.cholesky(BRIDGE))
    return np.asarray(found.reshape(-1, *problem.measured.shape))


def _moved(problems: tuple[SegmentProblem, ...], simulator: Simulator, unknowns: Array) -> Array:
    """Readings (B - 1, n, C) of all problems but the first one, less those of the first [SI]."""
    lanes = np.broadcast_to(unknowns, (len(problems), unknowns.size))
    measured = Shooting(problems, simulator, _STEP_S).simulate(np.arange(len(problems)), lanes).measured
    return np.asarray(measured[1:] - measured[0])
