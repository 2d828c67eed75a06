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
from dieseltwin.inner import kernel

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
    states, measured = np.repeat(base.states, lanes.size, axis=0), np.repeat(base.measured, lanes.size, axis=0)
    _march(moved, seen, np.ascontiguousarray(signals), of_lane, starts, states, measured)
    return Observations(states, measured)


@kernel(error_model="numpy")
def _march(moved, seen, signals, of_lane, starts, states, measured):  # type: ignore[no-untyped-def]
    """Add to `states` (B, n, S) and `measured` (B, n, C), those of no signal, what the lanes' signals (B, n) change."""
    count, (lanes, n) = (moved.shape[2] - _STATES) // 2, signals.shape
    is_start = np.zeros(n, dtype=np.bool_)
    is_start[starts] = True
    x, before = np.zeros(_STATES), np.zeros(_STATES)
    for lane in range(lanes):
        begin, signal = _STATES + of_lane[lane], signals[lane]
        end = begin + count
        for k in range(n):
            if k == 0 or is_start[k]:
                x[:] = 0.0
            else:
                before[:] = x
                for i in range(_STATES):
                    row = moved[k - 1, i]
                    x[i] = row[begin] * signal[k - 1] + row[end] * signal[k]
                    for j in range(_STATES):
                        x[i] += row[j] * before[j]
            for i in range(_STATES):
                states[lane, k, i] += x[i]
            for c in range(measured.shape[2]):
                row = seen[k, c]
                measured[lane, k, c] += row[begin] * signal[k]
                for j in range(_STATES):
                    measured[lane, k, c] += row[j] * x[j]


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
