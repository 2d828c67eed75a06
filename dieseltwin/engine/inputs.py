"""Inputs of the model over time, and what holds the actuator states that follow from them alone (`actuation`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.symbols import INPUT_COLUMNS

DEFAULT_STEP_S = 0.0125
"""Largest integration step [s]: RK4 then errs by at most 0.01 % of a column's mean (see benchmarks/simulator.py)."""

STEP_TOLERANCE = 1e-3  # of a step: time stamps far from zero (epoch time) are rounded by 1e-7 s


@dataclass(frozen=True)
class Inputs:
    """Engine inputs at their sample times; linear in between, the first value holds before the first time.

    Attributes:
        time_s: sample times [s], strictly increasing, shape (n,).
        n_e_rpm: engine speed [rpm], (n,).
        u_delta_mg: injected mass [mg/cycle], (n,).
        u_egr_pct, u_vgt_pct: commanded positions [%], (n,).
        n_history: number of leading rows that lie before the segment. They drive dead times and actuator lags only;
            the states start at row `n_history`.
        start_s: start of the recording that they were cut from, from which drifts and onsets of terms count [s];
            None: the first row.
        recorded_s: when the rows were recorded [s], (n,), where gaps between them are closed in `time_s`; None: then.
        u_flap_pct: position of an exhaust flap [%], (n,), or None.
    """

    time_s: np.ndarray
    n_e_rpm: np.ndarray
    u_delta_mg: np.ndarray
    u_egr_pct: np.ndarray
    u_vgt_pct: np.ndarray
    n_history: int = 0
    start_s: float | None = None
    u_flap_pct: np.ndarray | None = None
    recorded_s: np.ndarray | None = None

    def __post_init__(self) -> None:
        time = np.ascontiguousarray(self.time_s, dtype=np.float64)
        object.__setattr__(self, "time_s", time)
        for name in self.columns:
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.shape != time.shape:
                raise InputError(
                    f"inputs: {name}",
                    got=f"shape {values.shape}",
                    allowed=f"{time.shape} as time_s",
                    do="align the columns",
                )
            if not np.isfinite(values).all():
                raise InputError(
                    f"inputs: {name}",
                    got="values that are not finite",
                    allowed="finite numbers",
                    do="fill or cut the gaps",
                )
            object.__setattr__(self, name, values)
        if time.size - self.n_history < 2 or self.n_history < 0:
            raise InputError(
                "inputs",
                got=f"{time.size - self.n_history} rows",
                allowed="two rows or more",
                do="give a longer recording",
            )
        if not (np.diff(time) > 0).all():
            raise InputError(
                "inputs: time_s", got="time stamps that don't increase", allowed="strictly increasing", do="sort or cut"
            )

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Input column -> (n,), history included, the optional ones where there are any."""
        found = {name: getattr(self, name) for name in INPUT_COLUMNS}
        return found if self.u_flap_pct is None else {**found, "u_flap_pct": self.u_flap_pct}

    @property
    def recording_start_s(self) -> float:
        """`start_s`, or the first row's time [s]."""
        return float(self.clock_s[0] if self.start_s is None else self.start_s)

    @property
    def clock_s(self) -> np.ndarray:
        """Times of the rows on the recording's clock, gaps included [s], (n,)."""
        return self.time_s if self.recorded_s is None else self.recorded_s

    @property
    def segment_time_s(self) -> np.ndarray:
        """Sample times of the segment itself [s], shape (n - n_history,)."""
        return self.time_s[self.n_history :]

    def clipped(self, parameters: EngineParameters) -> Inputs:
        """The inputs saturated to the engine's ranges, as the published simulation does on entry."""
        ranges = parameters.input_ranges.items()
        return replace(self, **{name: np.clip(getattr(self, name), *limits) for name, limits in ranges})

    def resampled(self, step_s: float) -> Inputs:
        """The same piecewise linear inputs with samples at most `step_s` apart (old samples kept); no history."""
        rows = slice(self.n_history, None)
        time = self.time_s[rows]
        steps = steps_between(time, step_s)
        number = np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)  # of a step behind its sample
        fine = np.append(number * np.repeat(np.diff(time) / steps, steps) + np.repeat(time[:-1], steps), time[-1])
        columns = {name: np.interp(fine, time, values[rows]) for name, values in self.columns.items()}
        recorded = None if self.recorded_s is None else np.interp(fine, time, self.recorded_s[rows])
        return Inputs(fine, **columns, start_s=self.recording_start_s, recorded_s=recorded)


def steps_between(time_s: np.ndarray, step_s: float | np.ndarray) -> np.ndarray:
    """Number of integration steps of at most `step_s` [s] between samples, shape (n - 1,)."""
    return np.maximum(np.ceil(np.diff(time_s) / step_s - STEP_TOLERANCE), 1.0).astype(np.int64)


@dataclass(frozen=True)
class Actuation:
    """Inputs with their actuator states, ready for the simulator; depends on the actuator constants only.

    Attributes:
        time_s: sample times of the segment [s], (n,).
        steps: integration steps per sample interval, (n - 1,).
        u_egr1, u_egr2, u_vgt: actuator states at the sample times [%], (n,).
        u_egr: valve position K_egr u_egr1 - (K_egr - 1) u_egr2 at the sample times [%], (n,).
        grid: n_e, u_delta, u~_egr, u~_vgt at every half integration step, (4, 2 N + 1).
        rows: which row of a coarser recording each sample lies in, (n,), where the samples are finer than the
            recording; None: the samples are its rows.
    """

    time_s: np.ndarray
    steps: np.ndarray
    inputs: Inputs
    u_egr1: np.ndarray
    u_egr2: np.ndarray
    u_vgt: np.ndarray
    u_egr: np.ndarray
    grid: np.ndarray = field(repr=False)
    rows: np.ndarray | None = field(default=None, repr=False)

    @property
    def row_starts(self) -> np.ndarray:
        """The sample at which each row of the recording lies, (rows,)."""
        return np.arange(self.time_s.size) if self.rows is None else np.flatnonzero(np.diff(self.rows, prepend=-1))

    @property
    def sample_columns(self) -> np.ndarray:
        """The columns of `grid` at the samples, (n,)."""
        return np.concatenate([[0], np.cumsum(2 * self.steps)])

    def at_samples(self) -> np.ndarray:
        """n_e, u_delta, u~_egr, u~_vgt at the samples, (4, n)."""
        return self.grid[:, self.sample_columns]


def half_step_times(time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Times of every half integration step, (2 N + 1,) [s]."""
    widths = np.repeat(np.diff(time) / (2 * steps), 2 * steps)
    starts = np.repeat(time[:-1], 2 * steps)
    offsets = np.arange(widths.size) - np.repeat(np.concatenate([[0], np.cumsum(2 * steps)[:-1]]), 2 * steps)
    return np.append(starts + offsets * widths, time[-1])


def actuate_like(actuation: Actuation, fine_inputs: Inputs) -> Actuation:
    """An actuation that also has samples at every integration step of `actuation`, with its actuator states."""
    steps = np.ones(fine_inputs.time_s.size - 1, dtype=np.int64)
    u_egr, u_vgt = actuation.grid[2, ::2], actuation.grid[3, ::2]
    rows = np.append(np.repeat(np.arange(actuation.steps.size), actuation.steps), actuation.steps.size)
    return Actuation(fine_inputs.time_s, steps, fine_inputs, u_egr, u_egr, u_vgt, u_egr, actuation.grid, rows)


def grids_of(actuation: Actuation | Sequence[Actuation], lanes: int) -> tuple[Actuation, np.ndarray, np.ndarray]:
    """The first actuation, the different grids (G, 4, 2 N + 1) and each lane's index among them (B,).

    Raises:
        InputError: neither one actuation nor one per lane, or other sample times or steps.
    """
    actuations = [actuation] if isinstance(actuation, Actuation) else list(actuation)
    if len(actuations) not in (1, lanes):
        raise InputError("simulation", f"{len(actuations)} actuations", f"1 or {lanes}", "give one per lane")
    first = actuations[0]
    unique = {id(item): item for item in actuations}
    for item in unique.values():
        if item.grid.shape != first.grid.shape or not np.array_equal(item.steps, first.steps):
            raise InputError("simulation", "different sample times", "one time grid", "group by grid")
    order = {key: position for position, key in enumerate(unique)}
    of_lane = np.array([order[id(item)] for item in actuations], dtype=np.int64)
    grids = np.stack([item.grid for item in unique.values()]) if len(unique) > 1 else first.grid[None]
    return first, grids, np.broadcast_to(of_lane, (lanes,)).copy()  # read-only, a kernel would be compiled again
