"""What slow rows leave open of the diesel engine's inputs, and what that does to the readings of each window."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from dieseltwin.discovery.twins.diesel_lanes import moving
from dieseltwin.discovery.twins.interface import Array, Lanes, some_lanes
from dieseltwin.engine import EngineParameters, Inputs
from dieseltwin.engine.actuation import actuate_lanes
from dieseltwin.engine.inputs import Actuation
from dieseltwin.recordings.between_rows import BRIDGE, DIFFERENCE, NODES, rows_are_slow, unseen, with_nodes

_TOGETHER = 8  # intervals of a window that are moved in one call; each has a simulation per node


class Driven(Protocol):
    """What is needed of `twins.diesel.EngineTwin`.

    Attributes:
        engine: its engine; channels: of the readings.
        inputs: at the rows; starts, pieces: first rows of the windows and of the pieces.
        steps_s: longest integration step [s] of every interval between rows.
    """

    engine: EngineParameters
    channels: tuple[str, ...]
    inputs: Inputs
    starts: np.ndarray
    pieces: np.ndarray
    steps_s: Array
    between_rows: bool

    def with_own_laws(self, lanes: Lanes) -> Lanes:
        """Lanes with the engine's own laws as signals."""
        ...

    def combined(self, lanes: Lanes) -> tuple[dict[str, Array], dict[str, Array]]:
        """Magnitudes and schedules of effects, the engine's own among them."""
        ...

    def driven(self, lanes: Lanes, actuations: list[Actuation]) -> Array:
        """Readings (B, n, C) of lanes that have actuators of their own."""
        ...


def covariance_between_rows(twin: Driven, lanes: Lanes) -> tuple[Array, ...]:
    """Covariance (r C, r C) of the readings of each window by what the inputs may have done between the rows.

    Windows start anew, so one simulation moves an interval of every window. An interval counts for the window in which
    it ends; what the one before a window's start did is remembered by the actuators.

    Args:
        twin: of the recording.
        lanes: one lane, about which to linearise.

    Returns:
        One of each window, readings row by row; none where rows are fast enough to see the inputs move.
    """
    if not (twin.between_rows or rows_are_slow(twin.inputs.time_s)):
        return ()
    lanes = twin.with_own_laws(lanes)
    edges = np.append(twin.starts, twin.inputs.time_s.size)
    rows = np.diff(edges)
    found = [np.zeros((size * len(twin.channels),) * 2) for size in rows]
    mixed = np.linalg.cholesky(BRIDGE).T
    for column, values in twin.inputs.columns.items():
        std = np.append(0.0, unseen(values))  # of the interval that ends at a row
        std[twin.pieces] = 0.0
        for first in range(0, int(rows.max()), _TOGETHER):
            intervals = range(first, min(first + _TOGETHER, int(rows.max())))
            changes = _changes(twin, lanes, column, [_ends(twin.starts, rows, k, std) for k in intervals])
            for w, (a, b) in enumerate(pairwise(edges)):
                own = changes[:, :, a:b].reshape(len(intervals), NODES, -1)
                moved = (mixed @ own).reshape(-1, own.shape[-1])
                found[w] += moved.T @ moved
    return tuple(found)


def _ends(starts: np.ndarray, rows: np.ndarray, k: int, std: Array) -> Array:
    """(n,) standard deviations of the intervals that end at the k-th row of a window, 0 for all others."""
    out = np.zeros_like(std)
    at = starts[rows > k] + k
    out[at] = std[at]
    return out


def _changes(twin: Driven, lanes: Lanes, column: str, stds: list[Array]) -> Array:
    """Changes (K, NODES, n, C) of the readings by each of the moves, a standard deviation each."""
    moves = [(std, node) for std in stds for node in range(1, NODES + 1)]
    many = some_lanes(lanes, np.zeros(1 + len(moves), dtype=np.int64))
    actuations = [_actuation(twin, lanes, column, None, 0)]
    actuations += [_actuation(twin, lanes, column, std, node) for std, node in moves]
    seen = twin.driven(many, actuations)
    changes = np.nan_to_num((seen[1:] - seen[0]) / DIFFERENCE, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(changes.reshape(len(stds), NODES, *seen.shape[1:]))


def _actuation(twin: Driven, lanes: Lanes, column: str, std: Array | None, node: int) -> Actuation:
    """Actuators with a column moved at one node of the intervals that end at rows, by a share of (n,) std [unit]."""
    every, inputs = NODES + 1, twin.inputs
    fine_s = with_nodes(inputs.time_s)
    columns: dict[str, Any] = {name: np.interp(fine_s, inputs.time_s, v) for name, v in inputs.columns.items()}
    if std is not None:
        columns[column][node::every] += DIFFERENCE * std[1:]
    magnitudes, schedules = twin.combined(lanes)
    moved = moving(magnitudes)
    held = {name: np.repeat(schedules[name], every)[: fine_s.size] for name in moved if name in schedules}
    steps_s = np.repeat(twin.steps_s, every)
    fine = actuate_lanes(Inputs(fine_s, **columns), twin.engine, moved, 1, held, steps_s)[0]
    rows = slice(None, None, every)  # the same grid, with the recording's rows as samples
    return replace(
        fine, time_s=inputs.time_s, steps=fine.steps.reshape(-1, every).sum(axis=1), inputs=inputs,
        u_egr1=fine.u_egr1[rows], u_egr2=fine.u_egr2[rows], u_vgt=fine.u_vgt[rows], u_egr=fine.u_egr[rows],
    )  # fmt: skip
