"""Terms of an engine in the simulator: schedules, law terms along a trajectory, and every quantity as a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dieseltwin.engine.actuator_effects import actuate_with
from dieseltwin.engine.binding import Model
from dieseltwin.engine.effect_catalogue import ACTUATOR_EFFECTS, POINTS, STATE_EFFECTS
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.extended_model import ExtendedQuantities, Gas, Magnitudes, Signals
from dieseltwin.engine.inputs import DEFAULT_STEP_S, INPUT_COLUMNS, Actuation, Inputs, actuate
from dieseltwin.engine.parameters import Constants, EngineParameters, ParameterBatch, constants
from dieseltwin.engine.sensor_effects import SENSOR_EFFECTS, apply_sensor_effects
from dieseltwin.engine.simulate import MEASURED, Observations, numpy_model
from dieseltwin.engine.terms import LawTerm, Term

LAW_SWEEPS = 4
"""Simulations of the fixed point between a law term and the trajectory it depends on (the last changes 1e-4 of it)."""

Power = Callable[[Any, Any], Any]


def effect_terms(parameters: EngineParameters) -> tuple[Term, ...]:
    """The terms that are effects of the catalogue."""
    return tuple(term for term in parameters.terms if isinstance(term, Term))


def law_terms(parameters: EngineParameters) -> tuple[LawTerm, ...]:
    """The terms that are found laws."""
    return tuple(term for term in parameters.terms if isinstance(term, LawTerm))


def conditions_of(inputs: Inputs, whole: bool = False) -> dict[str, np.ndarray]:
    """The input columns over which regions are stated, (n,) each; with the history if `whole`."""
    rows = slice(0 if whole else inputs.n_history, None)
    return {name: getattr(inputs, name)[rows] for name in INPUT_COLUMNS}


def amounts(
    parameters: EngineParameters, names: Sequence[str], time_s: np.ndarray, start_s: float,
    conditions: Mapping[str, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Magnitude of each named effect at the samples, onset and region applied, (len(names), n) [its unit]."""
    out = np.zeros((len(names), time_s.size))
    for term in effect_terms(parameters):
        if term.effect in names:
            factor = term.factor(time_s, start_s, dict(conditions))
            out[list(names).index(term.effect)] += term.magnitude * factor
    return out


def actuate_terms(
    inputs: Inputs, parameters: EngineParameters, step_s: float | np.ndarray = DEFAULT_STEP_S,
    start_s: float | None = None,
) -> Actuation:  # fmt: skip
    """`inputs.actuate` under the parameters' actuator terms.

    Args:
        inputs: inputs with their history.
        parameters: with or without terms.
        step_s: largest integration step [s].
        start_s: the recording's start, from which `onset_s` counts; None: the first row of `inputs`.
    """
    if not any(term.effect in ACTUATOR_EFFECTS for term in effect_terms(parameters)):
        return actuate(inputs, parameters, step_s)
    start = inputs.time_s[0] if start_s is None else start_s
    rows = amounts(parameters, ACTUATOR_EFFECTS, inputs.time_s, start, conditions_of(inputs, whole=True))
    used = {name: row for name, row in zip(ACTUATOR_EFFECTS, rows, strict=True) if row.any()}
    magnitudes = {name: float(row.max()) for name, row in used.items()}
    schedules = {name: row / row.max() for name, row in used.items() if row.min() < row.max()}
    return actuate_with(inputs, parameters, magnitudes, schedules, step_s)


def extension_of(
    actuation: Actuation, parameters: EngineParameters, size: int, start_s: float | None = None,
    restarts: np.ndarray | Sequence[int] = (0,),
) -> Extension:  # fmt: skip
    """The parameters' effect terms as an extension of `size` lanes (law terms aside)."""
    start = actuation.time_s[0] if start_s is None else start_s
    schedule = amounts(parameters, STATE_EFFECTS, actuation.time_s, start, conditions_of(actuation.inputs))
    return Extension(np.ones((len(STATE_EFFECTS), size)), schedule, restarts=restarts, start_s=start)


def simulate_terms(
    actuation: Actuation,
    batch: ParameterBatch,
    parameters: EngineParameters,
    initial: np.ndarray,
    *,
    restarts: np.ndarray | Sequence[int] = (0,),
    start_s: float | None = None,
    sensors: bool = True,
    threads: int | None = None,
) -> Observations:
    """Simulate B parameter sets under the parameters' terms, sensor terms on the readings included.

    Args:
        actuation: by `actuate_terms`, one for all lanes.
        batch: B parameter sets.
        parameters: gives the terms.
        initial, restarts, threads: as in `simulate_extended`.
        start_s: the recording's start, from which onsets and drifts count; None: the first sample.
        sensors: apply sensor terms to `measured`.

    Law terms enter as signals that are iterated with the trajectory, lane by lane (`LAW_SWEEPS` simulations).
    """
    extension = extension_of(actuation, parameters, batch.size, start_s, restarts)
    laws = law_terms(parameters)
    if laws:
        observed = _simulate_laws(actuation, batch, parameters, extension, initial, threads)
    else:
        observed = simulate_extended(actuation, batch, extension, initial, threads)
    if sensors and any(term.effect in SENSOR_EFFECTS for term in effect_terms(parameters)):
        conditions = conditions_of(actuation.inputs)
        rows = amounts(parameters, SENSOR_EFFECTS, actuation.time_s, extension.start_s or 0.0, conditions)
        ones = {name: np.ones(batch.size) for name, row in zip(SENSOR_EFFECTS, rows, strict=True) if row.any()}
        schedules = dict(zip(SENSOR_EFFECTS, rows, strict=True))
        measured = apply_sensor_effects(observed.measured, actuation.time_s, ones, schedules, MEASURED)
        observed = replace(observed, measured=measured)
    return observed


def _simulate_laws(
    actuation: Actuation, batch: ParameterBatch, parameters: EngineParameters, extension: Extension,
    initial: np.ndarray, threads: int | None,
) -> Observations:  # fmt: skip
    points = {law.point for law in law_terms(parameters)}
    if len(points) == 1:  # all lanes together: a lane has one signal of its own
        at = POINTS.index(points.pop())
        for _ in range(LAW_SWEEPS):
            states = simulate_extended(actuation, batch, extension, initial, threads).states
            signal = _law_signals(states, actuation, batch.constants(), parameters, extension)[at]
            own = np.full(batch.size, at)
            extension = replace(extension, lane_point=own, lane_signal=np.ascontiguousarray(signal))
        return simulate_extended(actuation, batch, extension, initial, threads)
    starts = np.asarray(initial, dtype=np.float64)
    lanes = []
    for lane in range(batch.size):
        one = ParameterBatch(batch.values[:, [lane]])
        start = starts if starts.ndim < 2 else starts[[min(lane, starts.shape[0] - 1)]]
        own_extension = replace(extension, magnitudes=np.ones((len(STATE_EFFECTS), 1)))
        for _ in range(LAW_SWEEPS):
            states = simulate_extended(actuation, one, own_extension, start, threads).states
            signals = _law_signals(states, actuation, one.constants(), parameters, extension)[:, 0]
            own_extension = replace(own_extension, signals=np.ascontiguousarray(signals))
        lanes.append(simulate_extended(actuation, one, own_extension, start, threads))
    return Observations(np.concatenate([o.states for o in lanes]), np.concatenate([o.measured for o in lanes]))


def _law_signals(
    states: np.ndarray, actuation: Actuation, c: Constants, parameters: EngineParameters, extension: Extension
) -> np.ndarray:
    """Signals of the law terms along trajectories (B, n, 6): (len(POINTS), B, n)."""
    _, s = along(states, actuation, parameters, c, start_s=extension.start_s)
    return np.stack([np.broadcast_to(value, states.shape[:2]) for value in s])


def signals_of(
    laws: Sequence[LawTerm], factors: Sequence[Any], variables: Mapping[str, Any], power: Power = np.power
) -> Signals:
    """Signals of law terms at given variables; factors: onset and region of each law."""
    values: dict[str, Any] = dict.fromkeys(POINTS, 0.0)
    for law, factor in zip(laws, factors, strict=True):
        values[law.point] = values[law.point] + factor * law.signal(variables, power)
    return Signals(**values)


def law_variables(
    q: ExtendedQuantities, states: Mapping[str, Any], c: Constants
) -> dict[str, Any]:
    """Variables that a law may depend on; states: p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, u_egr, u_vgt, t."""
    p_im, p_em = states["p_im"], states["p_em"]
    return {
        **states, "p_amb": c.p_amb, "T_amb": c.T_amb, "T_im": q.T_im, "T_em": q.T_em, "T_e": q.T_e, "T_c": q.T_c,
        "p_es": q.p_es, "p_bc": q.p_bc, "W_c": q.W_c, "W_t": q.W_t, "W_egr": q.W_egr, "W_ei": q.W_ei, "W_eo": q.W_eo,
        "W_f": q.W_f, "Pi_c": q.Pi_c, "Pi_t": q.Pi_t, "Pi_egr": p_im / p_em, "Pi_e": p_em / p_im,
    }  # fmt: skip


def quantities_under(
    model: Model, states: Mapping[str, Any], gas: Gas, m: Magnitudes, laws: Sequence[LawTerm], factors: Sequence[Any],
    c: Constants, power: Power = np.power, sweeps: int = LAW_SWEEPS,
) -> tuple[ExtendedQuantities, Signals]:  # fmt: skip
    """`quantities_extended` with law terms evaluated on its own quantities.

    Args:
        model: equations of any backend.
        states: p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K], n_e [rpm], u_delta [mg/cycle], u_egr, u_vgt [% of
            position], t [s since the recording's start].
        gas, m, c: as in `quantities_extended`.
        laws, factors: law terms and where they act.
        power: raises to a power in the backend.
        sweeps: of the fixed point between laws and quantities.
    """
    order = ("p_im", "p_em", "omega_t", "x_r", "T_1")
    inputs = ("n_e", "u_delta", "u_egr", "u_vgt")
    arguments = (*(states[n] for n in order), gas, *(states[n] for n in inputs), m)
    s = Signals(*([0.0] * len(POINTS)))
    q = model.quantities_extended(*arguments, s, c)
    for _ in range(sweeps if laws else 0):
        s = signals_of(laws, factors, law_variables(q, states, c), power)
        q = model.quantities_extended(*arguments, s, c)
    return q, s


def along(
    states: np.ndarray, actuation: Actuation, parameters: EngineParameters, c: Constants | None = None,
    start_s: float | None = None,
) -> tuple[ExtendedQuantities, Signals]:  # fmt: skip
    """All quantities and law signals along trajectories (..., n, 6) under the parameters' terms.

    c: constants, arrays of shape (B, 1) for several lanes; default those of `parameters`.
    """
    c = constants(parameters) if c is None else c
    start = float(actuation.time_s[0] if start_s is None else start_s)
    rows = slice(actuation.inputs.n_history, None)
    conditions = conditions_of(actuation.inputs)
    m = Magnitudes(*amounts(parameters, STATE_EFFECTS, actuation.time_s, start, conditions))
    m = m._replace(egr_clogging=m.egr_clogging * np.maximum(actuation.time_s - start, 0.0))
    laws = law_terms(parameters)
    factors = [law.factor(actuation.time_s, start, conditions) for law in laws]
    p_im, p_em, omega_t, x_r, T_1, T_gas = np.moveaxis(states, -1, 0)
    inert = m.exhaust_thermal_inertia > 0.0
    named = {
        "p_im": p_im, "p_em": p_em, "omega_t": omega_t, "x_r": x_r, "T_1": T_1,
        "n_e": actuation.inputs.n_e_rpm[rows], "u_delta": actuation.inputs.u_delta_mg[rows],
        "u_egr": actuation.u_egr, "u_vgt": actuation.u_vgt, "t": actuation.time_s - start,
    }  # fmt: skip
    gas = Gas(T_gas, np.where(inert, 0.0, 1.0), np.where(inert, T_gas, 0.0))
    return quantities_under(numpy_model(), named, gas, m, laws, factors, c)
