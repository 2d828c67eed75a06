"""Simulation of the engine: states of many parameter sets at once, or every quantity of one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd

from dieseltwin.engine._compiled import LANES, N_OUT, N_STATES, follow_oxygen, integrate_block, integrate_one
from dieseltwin.engine.actuation import actuate
from dieseltwin.engine.binding import Model, numpy_model
from dieseltwin.engine.extended_frame import columns_along
from dieseltwin.engine.extended_terms import along, at_rest, simulate_lanes, simulate_terms
from dieseltwin.engine.inputs import DEFAULT_STEP_S, Actuation, Inputs, actuate_like, grids_of
from dieseltwin.engine.observations import Observations, in_threads, observations, thread_count
from dieseltwin.engine.parameters import EngineParameters, ParameterBatch, constants, parameter_batch
from dieseltwin.engine.sensor_effects import slot_parts
from dieseltwin.engine.terms import SENSOR_SLOTS, effect_terms, law_terms
from dieseltwin.errors import InputError
from dieseltwin.sensors import MEASURED

__all__ = [
    "Observations", "numpy_model", "quantities_frame", "settle", "simulate", "simulate_states", "thread_count",
]  # fmt: skip

SETTLE_S = 120.0  # s of constant input until the slowest state (turbo speed, some seconds) rests
SETTLE_START = (1.2e5, 1.3e5, 3000.0)  # Pa, Pa, rad/s: light load, from where the published engine comes to rest
LOADED_START = (2.5e5, 3.0e5, 9000.0)  # Pa, Pa, rad/s: much load
STALLED = 0.1
"""Of p_im, by which a rest that begins loaded must lie higher to be the engine's. In 2 of 400 of the published engine's
operating points it lies 2 to 3 % higher; stalled compressors of other engines gave up 40 %."""
_BLOCK = 100_000  # steps of the oxygen's flows at a time
_DRIVER_COLUMNS = ("x_oim", "x_oem", "lambda", "egr_fraction", "torque_nm")


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
        `Observations` of shapes (B, n, 5) and (B, n, C). Sensor terms enter `measured`.

    Raises:
        InputError: shapes that don't fit each other; terms together with other kernels.
    """
    if batch.terms:
        if kernels[0] is not integrate_block:
            raise InputError("terms of the engine", "learned maps", "the exact maps", "take --maps exact, or no terms")
        return simulate_lanes(actuation, batch, initial, threads=threads)
    integrate_lanes, integrate_alone = kernels
    lanes = batch.size
    first, grids, grid_of_lane = grids_of(actuation, lanes)
    start = np.broadcast_to(np.asarray(initial, dtype=np.float64), (lanes, 3))
    time = first.time_s - first.time_s[0]

    out = np.empty((lanes, time.size, N_OUT))
    if lanes == 1:
        integrate_alone(grids, grid_of_lane, first.steps, time, batch.values, np.ascontiguousarray(start), out)
        return observations(out, N_STATES)

    def run(begin: int) -> None:
        rows = np.minimum(
            np.arange(begin, begin + LANES), lanes - 1
        )  # a last block is filled with copies of its last lane
        block = out[begin : begin + LANES]
        target = block if block.shape[0] == LANES else np.empty((LANES, time.size, N_OUT))
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
    in_threads(run, begins, threads)
    return observations(out, N_STATES)


def settle(
    n_e_rpm: float, u_delta_mg: float, u_egr_pct: float, u_vgt_pct: float, parameters: EngineParameters,
    u_flap_pct: float | None = None, elapsed_s: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """States at rest p_im, p_em [Pa], omega_t [rad/s] at a constant operating point, shape (3,).

    Terms act as they do `elapsed_s` [s] after the recording's start: what begins or grows later isn't there yet.
    The engine is not stable everywhere (light load, high speed); there it returns a state on the limit cycle. Where
    speed lines are flat there may be two rests: without boost the exhaust lacks the air that would give boost. An
    engine is run at the one with boost. Of two rests under laws, which stand still on the way there (`at_rest`), an
    exported engine may find another, as its laws act all the way.
    """
    time = np.array([0.0, SETTLE_S])
    n_e, u_delta, u_egr, u_vgt = (np.full(2, float(value)) for value in (n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct))
    inputs = Inputs(time, n_e, u_delta, u_egr, u_vgt, start_s=0.0, recorded_s=np.full(2, elapsed_s),
                    u_flap_pct=None if u_flap_pct is None else np.full(2, u_flap_pct))  # fmt: skip
    actuation, batch = actuate(inputs, parameters), parameter_batch(parameters)

    def rest_from(start: tuple[float, float, float]) -> np.ndarray:
        if law_terms(parameters.terms):
            return at_rest(actuation, batch, np.array(start))
        return simulate_states(actuation, batch, np.array(start)).states[0, -1, :3].copy()

    light, loaded = rest_from(SETTLE_START), rest_from(LOADED_START)
    return loaded if loaded[0] > (1.0 + STALLED) * light[0] else light


def settle_first(inputs: Inputs, parameters: EngineParameters) -> np.ndarray:
    """States at rest at the first row of a segment (after its history), shape (3,)."""
    first = {name: float(values[inputs.n_history]) for name, values in inputs.columns.items()}
    return settle(first.pop("n_e_rpm"), first.pop("u_delta_mg"), first.pop("u_egr_pct"), first.pop("u_vgt_pct"),
                  parameters, elapsed_s=float(inputs.clock_s[inputs.n_history]) - inputs.recording_start_s, **first)


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
        egr_fraction, torque_nm; with terms further ones (`extended_frame.columns_along`).
    """
    inputs = inputs.clipped(parameters)
    actuation = actuate(inputs, parameters, step_s)
    if initial is None:
        initial = settle_first(inputs, parameters)
    initial = np.asarray(initial, dtype=np.float64)
    laws = bool(law_terms(parameters.terms))
    if oxygen or laws:
        fine = actuate_like(actuation, inputs.resampled(step_s))
        at_steps = _simulated(fine, parameters, initial)
    if laws:  # between rows of 0.2 s a law is far from linear: 1 % of lambda
        rows = fine.row_starts
        observed = Observations(at_steps.states[:, rows], at_steps.measured[:, rows])
    else:
        observed = _simulated(actuation, parameters, initial)
    frame = quantities_frame(observed.states[0], actuation, parameters)
    if oxygen:
        frame["x_oim"], frame["x_oem"] = _oxygen(fine, at_steps.states[0], parameters)
        after = list(frame)[list(frame).index("torque_nm") + 1 : -2]
        before = [c for c in frame if c not in (*_DRIVER_COLUMNS, *after)]
        frame = frame[[*before, *_DRIVER_COLUMNS, *after]]
    for term in effect_terms(parameters.terms):
        if term.slot in SENSOR_SLOTS:
            column = slot_parts(term.slot)[0]
            frame[column] = observed.measured[0, :, MEASURED.index(column)]
    return frame


def _simulated(actuation: Actuation, parameters: EngineParameters, initial: np.ndarray) -> Observations:
    """One engine's states (1, n, 5), with terms (1, n, 6), and readings under its sensor terms (1, n, C)."""
    batch = parameter_batch(parameters)
    if parameters.terms:
        return simulate_terms(actuation, batch, initial)
    return simulate_states(actuation, batch, initial)


def quantities_frame(
    states: np.ndarray, actuation: Actuation, parameters: EngineParameters, published: Model | None = None
) -> pd.DataFrame:
    """Every algebraic quantity at given states, shape (n, 5), as a table in the columns of the reference traces.

    With terms all columns of `extended_frame.columns_along`; `published`: see there.
    """
    extended, c = bool(parameters.terms), constants(parameters)
    return pd.DataFrame(columns_along(states, actuation, parameters.terms, c, extended, published))


def _oxygen(fine: Actuation, states: np.ndarray, parameters: EngineParameters) -> tuple[np.ndarray, np.ndarray]:
    """Oxygen mass fractions X_Oim, X_Oem [-] at the rows of a recording, each (rows,).

    They don't feed back, so they are integrated behind the simulation, over its flows at every integration step.

    Args:
        fine: with samples at the integration steps; states: there, (n, 5 or 6).
        parameters: of the engine.
    """
    flows = [np.empty(fine.time_s.shape) for _ in range(8)]
    for rows, values in _oxygen_flows(fine, states, parameters):
        for flow, value in zip(flows, values, strict=True):
            flow[rows] = value
    intake, exhaust = follow_oxygen(fine.time_s, *flows, parameter_batch(parameters).values[:, 0].copy())
    return intake[fine.row_starts], exhaust[fine.row_starts]


def _oxygen_flows(
    fine: Actuation, states: np.ndarray, parameters: EngineParameters
) -> Iterator[tuple[slice, tuple[np.ndarray, ...]]]:
    """Rows, and there p_im, p_em [Pa], T_em [K], W_c, W_egr, W_ei, W_f, W_eo [kg/s].

    In blocks where no term remembers: each of the some fifty quantities at every step of a day is memory by gigabytes.
    """
    c = constants(parameters)
    if parameters.terms:
        q, _ = along(states, fine, parameters.terms, c)
        yield slice(None), (states[:, 0], states[:, 1], q.T_em, q.W_c, q.W_egr, q.W_ei, q.W_f, q.W_eo)
        return
    inputs = fine.at_samples()
    for begin in range(0, len(states), _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        q = numpy_model().quantities(*states[rows].T, *(value[rows] for value in inputs), c)
        yield rows, (states[rows, 0], states[rows, 1], q.T_em, q.W_c, q.W_egr, q.W_ei, q.W_f, q.W_eo)
