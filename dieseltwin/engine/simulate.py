"""Simulation of the engine: states of many parameter sets at once, or every quantity of one."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd

from dieseltwin.engine._compiled import LANES, follow_oxygen, integrate_block, integrate_one
from dieseltwin.engine.binding import Model, bind
from dieseltwin.engine.inputs import DEFAULT_STEP_S, Actuation, Inputs, actuate
from dieseltwin.engine.parameters import Constants, EngineParameters, ParameterBatch, constants, parameter_batch
from dieseltwin.errors import InputError

_MEASURED_AT = (0, 1, 2, 5, 6, 7)
_SETTLE_S = 120.0  # s of constant input until the slowest state (turbo speed, some seconds) rests
_SETTLE_START = (1.2e5, 1.3e5, 3000.0)  # Pa, Pa, rad/s: light load, inside the basin of every steady point


@dataclass(frozen=True)
class Observations:
    """Simulated states and sensor signals of B lanes at n sample times.

    Attributes:
        states: p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K]; shape (B, n, 5).
        measured: in the order of `MEASURED`; shape (B, n, 6).
    """

    states: np.ndarray
    measured: np.ndarray


def thread_count() -> int:
    """Threads for batches: DIESELTWIN_THREADS, or else the processors this process may use."""
    configured = os.environ.get("DIESELTWIN_THREADS")
    if configured:
        try:
            return max(1, int(configured))
        except ValueError:
            raise InputError(
                "DIESELTWIN_THREADS", got=repr(configured), allowed="a whole number of threads", do="set or unset it"
            ) from None
    return len(os.sched_getaffinity(0))


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="dieseltwin")


def simulate_states(
    actuation: Actuation | Sequence[Actuation],
    batch: ParameterBatch,
    initial: np.ndarray,
    *,
    threads: int | None = None,
    kernels: tuple[Callable[..., None], Callable[..., None]] = (integrate_block, integrate_one),
) -> Observations:
    """Simulate B parameter sets, eight lanes in lockstep and blocks of lanes on all cores.

    Args:
        actuation: one for all lanes, or one per lane; all on the same sample times and steps.
        batch: B parameter sets, with their terms. The actuator constants are those the actuation was made with.
        initial: p_im, p_em [Pa], omega_t [rad/s] at the first sample, shape (B, 3) or (3,).
        threads: threads to use (default `thread_count`); the result doesn't depend on it.
        kernels: for a block of lanes and for one lane; others than the exact engine's may want further rows of
            constants (`surrogates.map_compiled`).

    Returns:
        `Observations` of shapes (B, n, 5) and (B, n, 6). Sensor terms enter `measured`.

    Raises:
        InputError: shapes that don't fit each other; terms together with other kernels.
    """
    if batch.terms:
        if kernels[0] is not integrate_block:
            raise InputError("terms of the engine", "learned maps", "the exact maps", "take --maps exact, or no terms")
        from dieseltwin.engine.extended_terms import simulate_lanes

        return simulate_lanes(actuation, batch, initial, threads=threads)
    integrate_lanes, integrate_alone = kernels
    lanes = batch.size
    actuations = [actuation] if isinstance(actuation, Actuation) else list(actuation)
    if len(actuations) not in (1, lanes):
        raise InputError(
            "simulate_states", got=f"{len(actuations)} actuations", allowed=f"1 or {lanes}", do="give one per lane"
        )
    first = actuations[0]
    unique: list[Actuation] = []
    positions: dict[int, int] = {}
    for item in actuations:
        if id(item) not in positions:
            if item.grid.shape != first.grid.shape or not np.array_equal(item.steps, first.steps):
                raise InputError(
                    "simulate_states", got="different sample times", allowed="one time grid", do="group by grid"
                )
            positions[id(item)] = len(unique)
            unique.append(item)
    grid_of_lane = np.array([positions[id(item)] for item in actuations], dtype=np.int64)
    if grid_of_lane.size == 1:
        grid_of_lane = np.zeros(lanes, dtype=np.int64)
    grids = np.stack([item.grid for item in unique]) if len(unique) > 1 else first.grid[None]
    start = np.broadcast_to(np.asarray(initial, dtype=np.float64), (lanes, 3))
    time = first.time_s - first.time_s[0]

    out = np.empty((lanes, time.size, 8))
    if lanes == 1:
        integrate_alone(grids, grid_of_lane, first.steps, time, batch.values, np.ascontiguousarray(start), out)
        return Observations(out[..., :5], out[..., _MEASURED_AT])

    def run(begin: int) -> None:
        rows = np.minimum(
            np.arange(begin, begin + LANES), lanes - 1
        )  # a last block is filled with copies of its last lane
        block = out[begin : begin + LANES]
        target = block if block.shape[0] == LANES else np.empty((LANES, time.size, 8))
        integrate_lanes(
            grids,
            grid_of_lane[rows],
            first.steps,
            time,
            np.ascontiguousarray(batch.values[:, rows]),
            start[rows],
            target,
        )
        if target is not block:
            block[:] = target[: block.shape[0]]

    begins = range(0, lanes, LANES)
    threads = thread_count() if threads is None else threads
    if threads > 1 and len(begins) > 1:
        list(_pool(threads).map(run, begins))
    else:
        for begin in begins:
            run(begin)
    return Observations(out[..., :5], out[..., _MEASURED_AT])


def settle(
    n_e_rpm: float, u_delta_mg: float, u_egr_pct: float, u_vgt_pct: float, parameters: EngineParameters
) -> np.ndarray:
    """States at rest p_im, p_em [Pa], omega_t [rad/s] at a constant operating point, shape (3,).

    The engine is not stable everywhere (light load, high speed); there it returns a state on the limit cycle.
    """
    time = np.array([0.0, _SETTLE_S])
    n_e, u_delta, u_egr, u_vgt = (np.full(2, float(value)) for value in (n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct))
    inputs = Inputs(time, n_e, u_delta, u_egr, u_vgt)
    result = simulate_states(actuate(inputs, parameters), parameter_batch(parameters), np.array(_SETTLE_START))
    return result.states[0, -1, :3].copy()


@lru_cache(maxsize=1)
def numpy_model() -> Model:
    """The equations over numpy arrays."""
    return bind("numpy")


def simulate(
    inputs: Inputs, parameters: EngineParameters, *, initial: np.ndarray | None = None, step_s: float = DEFAULT_STEP_S,
    oxygen: bool = True,
) -> pd.DataFrame:  # fmt: skip
    """Simulate one engine over its inputs; every quantity at the input's sample times.

    Args:
        inputs: inputs, with history where known; clipped to the engine's ranges.
        parameters: engine parameters; their terms are simulated, too, and sensor terms change the sensors' columns.
        initial: p_im, p_em [Pa], omega_t [rad/s] at the first sample, shape (3,); None: at rest at the first inputs.
        step_s: largest integration step [s].
        oxygen: also integrate the oxygen states (about twice the time).

    Returns:
        One row per sample (history left out), columns as in the reference traces, and x_oim, x_oem, lambda,
        egr_fraction, torque_nm; with terms further ones (`extended_frame.extended_frame`).
    """
    inputs = inputs.clipped(parameters)
    if parameters.terms:
        from dieseltwin.engine.extended_frame import simulate_table

        return simulate_table(inputs, parameters, initial, step_s, oxygen)
    actuation = actuate(inputs, parameters, step_s)
    if initial is None:
        row = inputs.n_history
        initial = settle(
            inputs.n_e_rpm[row], inputs.u_delta_mg[row], inputs.u_egr_pct[row], inputs.u_vgt_pct[row], parameters
        )
    batch = parameter_batch(parameters)
    states = simulate_states(actuation, batch, np.asarray(initial, dtype=np.float64)).states[0]
    frame = quantities_frame(states, actuation, parameters)
    if oxygen:
        frame["x_oim"], frame["x_oem"] = _oxygen(actuation, batch, initial, parameters, step_s)
        columns = list(frame)
        frame = frame[[c for c in columns if c not in _DRIVER_COLUMNS] + list(_DRIVER_COLUMNS)]
    return frame


_DRIVER_COLUMNS = ("x_oim", "x_oem", "lambda", "egr_fraction", "torque_nm")


def quantities_frame(states: np.ndarray, actuation: Actuation, parameters: EngineParameters) -> pd.DataFrame:
    """Every algebraic quantity at given states, shape (n, 5), as a table in the columns of the reference traces.

    With terms the columns of `extended_frame.extended_frame`.
    """
    if parameters.terms:
        from dieseltwin.engine.extended_frame import extended_frame

        return extended_frame(states, actuation, parameters)
    model, c = numpy_model(), constants(parameters)
    rows = slice(actuation.inputs.n_history, None)
    n_e, u_delta = actuation.inputs.n_e_rpm[rows], actuation.inputs.u_delta_mg[rows]
    p_im, p_em, omega_t, x_r, T_1 = states.T
    q = model.quantities(p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, actuation.u_egr, actuation.u_vgt, c)
    return pd.DataFrame(
        {
            "time_s": actuation.time_s, "n_e_rpm": n_e, "u_delta_mg": u_delta,
            "u_egr_pct": actuation.inputs.u_egr_pct[rows], "u_vgt_pct": actuation.inputs.u_vgt_pct[rows],
            "p_im_pa": p_im, "p_em_pa": p_em, "omega_t_rad_s": omega_t,
            "u_egr1_pct": actuation.u_egr1, "u_egr2_pct": actuation.u_egr2, "u_vgt_act_pct": actuation.u_vgt,
            "w_egr_kg_s": q.W_egr, "t_em_k": q.T_em, "w_c_kg_s": q.W_c, "w_t_kg_s": q.W_t, "w_ei_kg_s": q.W_ei,
            "w_eo_kg_s": q.W_eo, "w_f_kg_s": q.W_f, "t_e_k": q.T_e, "t_1_k": T_1, "x_r": x_r, "eta_c": q.eta_c,
            "eta_tm": q.eta_tm, "eta_vol": q.eta_vol, "phi_c": q.Phi_c, "f_vgt_pi_t": q.F_vgt_Pi_t, "f_egr": q.f_egr,
            "p_t_eta_m_w": q.P_t_eta_m, "p_c_w": q.P_c, "t_c_k": model.compressor_out_temperature(q.eta_c, q.Pi_c, c),
            "lambda": model.air_fuel_ratio(q.W_c, q.W_f, c), "egr_fraction": model.egr_fraction(q.W_c, q.W_egr),
            "torque_nm": model.torque(u_delta, n_e, p_im, p_em, c),
        }
    )  # fmt: skip


def _oxygen(
    actuation: Actuation, batch: ParameterBatch, initial: np.ndarray, parameters: EngineParameters, step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Oxygen mass fractions X_Oim, X_Oem [-] at the samples, each (n,).

    They don't feed back, so they are integrated behind the simulation, over its flows at every integration step.
    """
    fine_inputs = actuation.inputs.resampled(step_s)
    fine = actuate_like(actuation, fine_inputs)
    states = simulate_states(fine, batch, np.asarray(initial, dtype=np.float64)).states[0]
    c: Constants = constants(parameters)
    p_im, p_em, omega_t, x_r, T_1 = states.T
    q = numpy_model().quantities(
        p_im, p_em, omega_t, x_r, T_1, fine_inputs.n_e_rpm, fine_inputs.u_delta_mg, fine.u_egr, fine.u_vgt, c
    )
    intake, exhaust = follow_oxygen(
        fine.time_s, p_im, p_em, q.T_em, q.W_c, q.W_egr, q.W_ei, q.W_f, q.W_eo, batch.values[:, 0].copy()
    )
    at = np.concatenate([[0], np.cumsum(actuation.steps)])
    return intake[at], exhaust[at]


def actuate_like(actuation: Actuation, fine_inputs: Inputs) -> Actuation:
    """An actuation that also has samples at every integration step of `actuation`, with its actuator states."""
    steps = np.ones(fine_inputs.time_s.size - 1, dtype=np.int64)
    u_egr, u_vgt = actuation.grid[2, ::2], actuation.grid[3, ::2]
    return Actuation(fine_inputs.time_s, steps, fine_inputs, u_egr, u_egr, u_vgt, u_egr, actuation.grid)
