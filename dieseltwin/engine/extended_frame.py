"""Every quantity of an engine with terms as a table, and its simulation from inputs."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.engine._compiled import follow_oxygen
from dieseltwin.engine.extended_terms import along, conditions_of, simulate_terms
from dieseltwin.engine.inputs import DEFAULT_STEP_S, Actuation, Inputs, actuate
from dieseltwin.engine.parameters import EngineParameters, constants, parameter_batch
from dieseltwin.engine.sensor_effects import slot_parts
from dieseltwin.engine.simulate import actuate_like, numpy_model, settle
from dieseltwin.engine.terms import SENSOR_SLOTS, amounts, effect_terms
from dieseltwin.symbols import MEASURED


def extended_frame(states: np.ndarray, actuation: Actuation, parameters: EngineParameters) -> pd.DataFrame:
    """Every quantity at given states, (n, 6) or (n, 5) as in `extended_terms.along`, under the parameters' terms.

    Columns of `simulate.quantities_frame`, then p_es_pa, p_bc_pa, t_im_k, w_leak_im_kg_s, w_leak_em_kg_s,
    p_friction_w, t_em_static_k (without thermal inertia). Actuator terms are in `actuation`; sensor terms don't enter.
    """
    model, c = numpy_model(), constants(parameters)
    q, s = along(states, actuation, parameters.terms, c)
    p_im, p_em, omega_t, x_r, T_1 = states[:, :5].T
    inputs = actuation.inputs
    rows = slice(inputs.n_history, None)
    n_e = inputs.n_e_rpm[rows]
    start, conditions = inputs.recording_start_s, conditions_of(actuation)
    drift = amounts(parameters.terms, ("injector_drift",), actuation.time_s, start, conditions)[0]
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


def simulate_table(
    inputs: Inputs, parameters: EngineParameters, initial: np.ndarray | None = None, step_s: float = DEFAULT_STEP_S,
    oxygen: bool = True,
) -> pd.DataFrame:  # fmt: skip
    """`simulate.simulate` for parameters with terms: columns of `extended_frame`; sensor terms change the columns that
    sensors see. Inputs are taken as clipped already."""
    actuation = actuate(inputs, parameters, step_s)
    if initial is None:
        row = inputs.n_history
        initial = settle(
            inputs.n_e_rpm[row], inputs.u_delta_mg[row], inputs.u_egr_pct[row], inputs.u_vgt_pct[row], parameters
        )
    initial = np.asarray(initial, dtype=np.float64)
    batch = parameter_batch(parameters)
    observed = simulate_terms(actuation, batch, initial)
    frame = extended_frame(observed.states[0], actuation, parameters)
    if oxygen:
        fine = actuate_like(actuation, actuation.inputs.resampled(step_s))
        states = simulate_terms(fine, batch, initial, sensors=False).states[0]
        q, _ = along(states, fine, parameters.terms, constants(parameters))
        flows = [np.ascontiguousarray(np.broadcast_to(v, fine.time_s.shape)) for v in
                 (states[:, 0], states[:, 1], q.T_em, q.W_c, q.W_egr, q.W_ei, q.W_f, q.W_eo)]  # fmt: skip
        intake, exhaust = follow_oxygen(fine.time_s, *flows, batch.values[:, 0].copy())
        at = np.concatenate([[0], np.cumsum(actuation.steps)])
        frame.insert(frame.columns.get_loc("lambda"), "x_oim", intake[at])
        frame.insert(frame.columns.get_loc("lambda"), "x_oem", exhaust[at])
    for term in effect_terms(parameters.terms):
        if term.slot in SENSOR_SLOTS:
            column = slot_parts(term.slot)[0]
            frame[column] = observed.measured[0, :, MEASURED.index(column)]
    return frame
