"""Every quantity of an engine with terms as a table, and its simulation from inputs."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.engine._compiled import follow_oxygen
from dieseltwin.engine.effect_catalogue import EFFECTS
from dieseltwin.engine.extended_terms import (
    actuate_terms,
    along,
    amounts,
    conditions_of,
    effect_terms,
    simulate_terms,
)
from dieseltwin.engine.inputs import DEFAULT_STEP_S, Actuation, Inputs
from dieseltwin.engine.parameters import EngineParameters, constants, parameter_batch
from dieseltwin.engine.simulate import MEASURED, SETTLE_S, SETTLE_START, actuate_like, numpy_model


def extended_frame(
    states: np.ndarray, actuation: Actuation, parameters: EngineParameters, start_s: float | None = None
) -> pd.DataFrame:
    """Every quantity at given states, (n, 6), under the parameters' terms.

    Columns of `simulate.quantities_frame`, then p_es_pa, p_bc_pa, t_im_k, w_leak_im_kg_s, w_leak_em_kg_s,
    p_friction_w, t_em_static_k (without thermal inertia). Actuator terms are in `actuation`; sensor terms don't enter.
    """
    model, c = numpy_model(), constants(parameters)
    q, s = along(states, actuation, parameters, c, start_s)
    p_im, p_em, omega_t, x_r, T_1, _ = states.T
    inputs = actuation.inputs
    rows = slice(inputs.n_history, None)
    n_e = inputs.n_e_rpm[rows]
    start = float(actuation.time_s[0] if start_s is None else start_s)
    drift = amounts(parameters, ("injector_drift",), actuation.time_s, start, conditions_of(inputs))[0]
    fuel = inputs.u_delta_mg[rows] * (1.0 + drift) * (1.0 + s.u_delta)
    columns = {
        "time_s": actuation.time_s, "n_e_rpm": n_e, "u_delta_mg": inputs.u_delta_mg[rows],
        "u_egr_pct": inputs.u_egr_pct[rows], "u_vgt_pct": inputs.u_vgt_pct[rows],
        "p_im_pa": p_im, "p_em_pa": p_em, "omega_t_rad_s": omega_t,
        "u_egr1_pct": actuation.u_egr1, "u_egr2_pct": actuation.u_egr2, "u_vgt_act_pct": actuation.u_vgt,
        "w_egr_kg_s": q.W_egr, "t_em_k": q.T_em, "w_c_kg_s": q.W_c, "w_t_kg_s": q.W_t, "w_ei_kg_s": q.W_ei,
        "w_eo_kg_s": q.W_eo, "w_f_kg_s": q.W_f, "t_e_k": q.T_e, "t_1_k": T_1, "x_r": x_r, "eta_c": q.eta_c,
        "eta_tm": q.eta_tm, "eta_vol": q.eta_vol, "phi_c": q.Phi_c, "f_vgt_pi_t": q.F_vgt_Pi_t, "f_egr": q.f_egr,
        "p_t_eta_m_w": q.P_t_eta_m, "p_c_w": q.P_c, "t_c_k": q.T_c,
        "lambda": model.air_fuel_ratio(q.W_c, q.W_f, c), "egr_fraction": model.egr_fraction(q.W_c, q.W_egr),
        "torque_nm": model.torque(fuel, n_e, p_im, p_em, c),
        "p_es_pa": q.p_es, "p_bc_pa": q.p_bc, "t_im_k": q.T_im, "w_leak_im_kg_s": q.W_leak_im,
        "w_leak_em_kg_s": q.W_leak_em, "p_friction_w": q.P_f, "t_em_static_k": q.T_em_static,
    }  # fmt: skip
    return pd.DataFrame({name: np.broadcast_to(value, n_e.shape) for name, value in columns.items()})


def settle_terms(
    n_e_rpm: float, u_delta_mg: float, u_egr_pct: float, u_vgt_pct: float, parameters: EngineParameters
) -> np.ndarray:
    """`simulate.settle` under the parameters' terms (onsets counted from 0 s, so not yet acting), shape (3,)."""
    values = (np.full(2, float(value)) for value in (n_e_rpm, u_delta_mg, u_egr_pct, u_vgt_pct))
    inputs = Inputs(np.array([0.0, SETTLE_S]), *values)
    actuation = actuate_terms(inputs, parameters)
    result = simulate_terms(actuation, parameter_batch(parameters), parameters, np.array(SETTLE_START), sensors=False)
    return result.states[0, -1, :3].copy()


def simulate_table(
    inputs: Inputs, parameters: EngineParameters, initial: np.ndarray | None = None, step_s: float = DEFAULT_STEP_S,
    oxygen: bool = True, start_s: float | None = None,
) -> pd.DataFrame:  # fmt: skip
    """`simulate.simulate` for parameters with terms: columns of `extended_frame`; sensor terms change the columns that
    sensors see. Inputs are taken as clipped already; start_s: the recording's start, None: the first row."""
    start = float(inputs.time_s[0] if start_s is None else start_s)
    actuation = actuate_terms(inputs, parameters, step_s, start)
    if initial is None:
        row = inputs.n_history
        at_rest = (getattr(inputs, name)[row] for name in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"))
        initial = settle_terms(*at_rest, parameters)
    initial = np.asarray(initial, dtype=np.float64)
    batch = parameter_batch(parameters)
    observed = simulate_terms(actuation, batch, parameters, initial, start_s=start)
    frame = extended_frame(observed.states[0], actuation, parameters, start)
    if oxygen:
        fine = actuate_like(actuation, actuation.inputs.resampled(step_s))
        states = simulate_terms(fine, batch, parameters, initial, start_s=start, sensors=False).states[0]
        q, _ = along(states, fine, parameters, start_s=start)
        flows = [np.ascontiguousarray(np.broadcast_to(v, fine.time_s.shape)) for v in
                 (states[:, 0], states[:, 1], q.T_em, q.W_c, q.W_egr, q.W_ei, q.W_f, q.W_eo)]  # fmt: skip
        intake, exhaust = follow_oxygen(fine.time_s, *flows, batch.values[:, 0].copy())
        at = np.concatenate([[0], np.cumsum(actuation.steps)])
        frame.insert(frame.columns.get_loc("lambda"), "x_oim", intake[at])
        frame.insert(frame.columns.get_loc("lambda"), "x_oem", exhaust[at])
    for term in effect_terms(parameters):
        column = EFFECTS[term.effect].site.removeprefix("sensor:")
        if column in MEASURED:
            frame[column] = observed.measured[0, :, MEASURED.index(column)]
    return frame
