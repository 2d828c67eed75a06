"""Simulation of the extended model: effects, signals at insertion points, restarts; many lanes at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.engine._compiled import LANES
from dieseltwin.engine._compiled_extended import integrate_free, integrate_restricted
from dieseltwin.engine._compiled_rates import N_OUT, N_STATES
from dieseltwin.engine.effects import GAS_LAG, IMPLICIT, STATE_EFFECTS
from dieseltwin.engine.inputs import Actuation, grids_of
from dieseltwin.engine.map_corrections import NO_CORRECTIONS, MapCorrections
from dieseltwin.engine.observations import Observations, in_threads, observations, thread_count
from dieseltwin.engine.parameters import ParameterBatch
from dieseltwin.engine.quantities import POINTS
from dieseltwin.errors import InputError

MOST_PIECES = 512
"""Windows of lanes that one thread takes at once, at most: cores that others use, too, don't end together."""


@dataclass(frozen=True)
class Extension:
    """What is added to the published model in B lanes over n samples.

    Attributes:
        magnitudes: (len(STATE_EFFECTS), B) in the units of the catalogue; None: all 0.
        schedule: (len(STATE_EFFECTS), n) factor of the magnitudes, held over the interval after its sample, shared by
            the lanes; None: 1.
        schedules: (G, len(STATE_EFFECTS), n) several of them in its place, and
        schedule_of_lane: (B,) which of these is each lane's.
        signals: (len(POINTS), n) shared by the lanes, linear between samples; None: 0.
        lane_point: (B,) index into `POINTS` of one further signal per lane, -1 for none; None: none.
        lane_signal: (B, n) values of these further signals.
        restarts: (W,) ascending sample indices, the first 0, at which p_im, p_em, omega_t start anew.
        corrections: of the maps; None: none.
    """

    magnitudes: np.ndarray | None = None
    schedule: np.ndarray | None = None
    signals: np.ndarray | None = None
    lane_point: np.ndarray | None = None
    lane_signal: np.ndarray | None = None
    restarts: np.ndarray | Sequence[int] = (0,)
    schedules: np.ndarray | None = None
    schedule_of_lane: np.ndarray | None = None
    corrections: MapCorrections | None = None


def _checked(value: object, shape: tuple[int, ...], name: str, fill: float = 0.0) -> np.ndarray:
    if value is None:
        return np.full(shape, fill)
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"extension: {name}", f"shape {array.shape}", f"{shape}", "align it with lanes and samples")
    if not np.isfinite(array).all():
        raise InputError(f"extension: {name}", "values that are not finite", "finite numbers", "correct them")
    return array


def _schedules(extension: Extension, lanes: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Schedules (G, len(STATE_EFFECTS), n) and each lane's index among them (B,)."""
    shape = (len(STATE_EFFECTS), n)
    if extension.schedules is None:
        return _checked(extension.schedule, shape, "schedule", 1.0)[None], np.zeros(lanes, dtype=np.int64)
    schedules = _checked(extension.schedules, (len(extension.schedules), *shape), "schedules")
    of_lane = np.asarray(extension.schedule_of_lane, dtype=np.int64)
    if of_lane.shape != (lanes,) or of_lane.min() < 0 or of_lane.max() >= len(schedules):
        raise InputError("extension: schedule_of_lane", f"{of_lane!r}", f"({lanes},) indices into schedules", "correct")
    return schedules, of_lane


def _input_of_kernel(value: np.ndarray | float) -> np.ndarray | float:
    """An array as all of them are given to the kernels: contiguous, and not to be written to.

    Any other layout is a type of its own, for which numba compiles the whole kernel again (4 to 20 s).
    """
    if not isinstance(value, np.ndarray):
        return value
    given = np.ascontiguousarray(value).view()
    given.flags.writeable = False
    return given


def _pieces(rows: np.ndarray, lagging: np.ndarray, restarts: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Pieces of some lanes as `_integrate_extended` takes them, (M, 5): windows, or a recording in one."""
    places = 2 * np.concatenate([[0], np.cumsum(steps)])[restarts]
    windows = np.stack([restarts, np.append(restarts[1:], steps.size + 1), places, np.arange(restarts.size)], axis=1)
    whole = np.array([[0, steps.size + 1, 0, 0]])
    return np.concatenate([
        np.column_stack([np.tile(lanes, len(parts)), np.repeat(parts, lanes.size, axis=0)])
        for lanes, parts in ((rows[lagging[rows]], whole), (rows[~lagging[rows]], windows))
    ]).astype(np.int64)  # fmt: skip


def simulate_extended(
    actuation: Actuation | Sequence[Actuation],
    batch: ParameterBatch,
    extension: Extension,
    initial: np.ndarray,
    threads: int | None = None,
    late: float = 1.0,
) -> Observations:
    """Simulate B parameter sets under effects and signals, eight windows abreast.

    Args:
        actuation: one for all lanes or one per lane (lanes may share one), all on the same sample times and steps.
        batch: B parameter sets.
        extension: what is added.
        initial: p_im, p_em [Pa], omega_t [rad/s] at each restart, (B, W, 3), or what broadcasts to it.
        threads: threads to use (default `simulate.thread_count`); the result doesn't depend on it.
        late: share of the third stage's rate, against the second's, in what the last stage starts from: 1 is RK4; with
            0.48 the order is three and steps may be almost twice as long before they are unstable.

    Returns:
        `Observations` with states (B, n, 6), those of `STATES` and the gas temperature that heats the EGR or lags
        [K], and measured (B, n, C) as usual. At a restart the pressures and the speed are the new ones; x_r and T_1
        settle there as at every sample, and a lagged gas temperature carries on (it is at rest at the first sample).

    Raises:
        InputError: shapes that don't fit each other, or values that are not finite.
    """
    lanes = batch.size
    first, grids, grid_of_lane = grids_of(actuation, lanes)
    time = first.time_s - first.time_s[0]
    n = time.size
    magnitudes = _checked(extension.magnitudes, (len(STATE_EFFECTS), lanes), "magnitudes")
    schedules, schedule_of_lane = _schedules(extension, lanes, n)
    signals = _checked(extension.signals, (len(POINTS), n), "signals")
    if extension.lane_point is None:
        lane_point, lane_signal = np.full(lanes, -1, dtype=np.int64), np.zeros((lanes, 1))
    else:
        lane_point = np.asarray(extension.lane_point, dtype=np.int64)
        if lane_point.shape != (lanes,) or lane_point.min() < -1 or lane_point.max() >= len(POINTS):
            raise InputError("extension: lane_point", f"{lane_point!r}", f"({lanes},) indices into POINTS", "correct")
        lane_signal = _checked(extension.lane_signal, (lanes, n), "lane_signal")
    restarts = np.asarray(extension.restarts, dtype=np.int64)
    if restarts.size == 0 or restarts[0] != 0 or (np.diff(restarts) <= 0).any() or restarts[-1] >= n:
        raise InputError("extension: restarts", f"{restarts!r}", f"ascending samples below {n}, first 0", "correct")
    initial = np.asarray(initial, dtype=np.float64)
    if initial.ndim == 2:
        initial = initial[:, None, :]
    starts = np.broadcast_to(initial, (lanes, restarts.size, 3))

    corrections = extension.corrections or NO_CORRECTIONS
    out = np.empty((lanes, n, N_OUT))
    implicit = [STATE_EFFECTS.index(name) for name in IMPLICIT]
    acting = (schedules[:, implicit] != 0.0).any(axis=2)[schedule_of_lane].T
    # Lanes with implicit laws run in a kernel of their own, half as fast.
    restricted = ((magnitudes[implicit] != 0.0) & acting).any(axis=0)
    lagging = magnitudes[STATE_EFFECTS.index(GAS_LAG)] != 0.0  # gas that lags carries its temperature over restarts
    threads = thread_count() if threads is None else threads
    inputs = [
        _input_of_kernel(array) for array in (
            grids, grid_of_lane, first.steps, time, batch.values, magnitudes, schedules, schedule_of_lane,
            signals, lane_point, lane_signal, restarts, starts, late, corrections.tables, corrections.low,
            corrections.per_unit,
        )
    ]  # fmt: skip

    def run(task: tuple[Callable[..., None], np.ndarray]) -> None:
        integrate, pieces = task
        integrate(*inputs, pieces, out)

    tasks = []
    for integrate, rows in (
        (integrate_free, np.flatnonzero(~restricted)), (integrate_restricted, np.flatnonzero(restricted))
    ):  # fmt: skip
        pieces = _pieces(rows, lagging, restarts, first.steps)
        shares = max(-(-len(pieces) // MOST_PIECES), min(threads, -(-len(pieces) // LANES)))
        tasks += [(integrate, share) for share in np.array_split(pieces, shares)] if shares else []
    in_threads(run, tasks, threads)
    return observations(out, N_STATES)
