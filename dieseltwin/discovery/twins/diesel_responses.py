"""Responses of the engine to many small signals from what happens between one sample and the next.

Each of the signals along which maps may be off acts on three states and on the readings alone. So their responses are
those of a linear system that changes with time (Kailath, Linear Systems, 1980, chapter 9): its matrices come from
differences over single intervals, two runs of sixteen lanes, however many signals there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.twins.interface import Array, Lanes, repeated, some_lanes
from dieseltwin.engine.simulate import Observations

_STATES = 3  # p_im, p_em, omega_t; the others follow them within a sample
_STATE_DIFFERENCE = 1e-6  # of a state

Simulate = Callable[[Lanes, np.ndarray, Array], Observations]
"""Lanes, restarts (R,), states there (B, R, 3) -> trajectories."""


def sooner(lanes: Lanes) -> bool:
    """Whether `near` takes fewer lanes than there are."""
    return lanes.linear and lanes.size > 2 * (1 + _STATES + 2 * np.unique(np.asarray(lanes.lane_points)).size)


def near(lanes: Lanes, starts: np.ndarray, base: Observations, simulate: Simulate) -> Observations:
    """Trajectories of lanes that differ by small signals of their own, to first order.

    Args:
        lanes: B, alike but for `lane_points` and `lane_signals`.
        starts: (W,) first sample of each window.
        base: of a lane without a signal of its own.
        simulate: the engine.
    """
    points, of_lane = np.unique(np.asarray(lanes.lane_points), return_inverse=True)
    signals = np.asarray(lanes.lane_signals)
    sizes = np.array([np.abs(signals[of_lane == j]).max() for j in range(points.size)])
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    moved, seen = _matrices(some_lanes(lanes, slice(0, 1)), starts, base, simulate, points, sizes)
    driving = np.ascontiguousarray(signals.T)[:, None]  # (n, 1, B): lanes last, where all of them are one product
    begin, end = _STATES + of_lane, _STATES + points.size + of_lane
    push = moved[:-1, :, begin] * driving[:-1] + moved[:-1, :, end] * driving[1:]
    states = np.zeros((signals.shape[1], _STATES, lanes.size))
    ends = np.append(starts[1:], signals.shape[1])
    for step in range(int((ends - starts).max()) - 1):
        rows = (starts + step)[starts + step + 1 < ends]
        states[rows + 1] = moved[rows, :, :_STATES] @ states[rows] + push[rows]
    readings = seen[:, :, :_STATES] @ states
    readings += seen[:, :, _STATES + of_lane] * driving
    all_states = np.repeat(base.states, lanes.size, axis=0)
    all_states[..., :_STATES] += states.transpose(2, 0, 1)
    return Observations(all_states, base.measured + readings.transpose(2, 0, 1))


def _matrices(
    one: Lanes, starts: np.ndarray, base: Observations, simulate: Simulate, points: np.ndarray, sizes: Array
) -> tuple[Array, Array]:
    """Derivatives of the next sample's states and of the readings of every sample.

    Signals run linearly between samples, so that those at both ends of an interval count: (n, 3, 3 + P + P) with the
    states, the signals at its begin and those at its end; (n, C, 3 + P) of the readings.
    """
    n, count = base.measured.shape[1], points.size
    at = base.states[0, :, :_STATES]
    lanes = replace(
        repeated(one, 1 + _STATES + 2 * count),
        lane_points=np.concatenate([np.full(1 + _STATES, -1), points, points]),
        linear=False,
    )
    moved, seen = np.zeros((n, _STATES, _STATES + 2 * count)), np.zeros((n, base.measured.shape[2], _STATES + count))
    ends = np.append(starts[1:], n)
    for phase in (0, 1):  # intervals that begin at every other sample of a window, then the others
        first = np.concatenate([np.arange(a + phase, b, 2) for a, b in zip(starts, ends, strict=True)])
        restarts = np.union1d(starts, first)
        begins = np.isin(np.arange(n), first)
        signal = np.zeros((lanes.size, n))
        signal[1 + _STATES : 1 + _STATES + count] = sizes[:, None] * begins
        signal[1 + _STATES + count :] = sizes[:, None] * ~begins
        initial = np.repeat(at[None, restarts], lanes.size, axis=0)
        steps = _STATE_DIFFERENCE * at
        for j in range(_STATES):
            initial[1 + j, :, j] += steps[restarts, j]
        run = simulate(replace(lanes, lane_signals=signal), restarts, initial)
        readings = (run.measured[1:] - run.measured[0])[:, first]
        scale = np.concatenate([steps[first].T, np.broadcast_to(sizes[:, None], (count, first.size))])
        seen[first] = (readings[: _STATES + count] / scale[..., None]).transpose(1, 2, 0)
        inside = first[~np.isin(first + 1, np.append(starts, n))]
        change = (run.states[1:, :, :_STATES] - run.states[0, :, :_STATES])[:, inside + 1]
        scale = np.concatenate([steps[inside].T, *2 * [np.broadcast_to(sizes[:, None], (count, inside.size))]])
        moved[inside] = (change / scale[..., None]).transpose(1, 2, 0)
    return moved, seen
