"""Every quantity of an engine along its states as a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.extended_terms import along
from dieseltwin.engine.inputs import Actuation
from dieseltwin.engine.parameters import EngineParameters, constants


def published_frame(states: np.ndarray, actuation: Actuation, q: Any, parameters: EngineParameters) -> pd.DataFrame:
    """Columns of the reference traces from states (n, 5 or more) and the quantities along them.

    Commands and engine speed are the inputs'; the torque is that of the mass that is really injected.
    """
    model, c = numpy_model(), constants(parameters)
    p_im, p_em, omega_t, x_r, T_1 = states[:, :5].T
    rows = slice(actuation.inputs.n_history, None)
    n_e, u_delta = actuation.inputs.n_e_rpm[rows], actuation.inputs.u_delta_mg[rows]
    driver = model.driver_quantities(q, n_e, p_im, p_em, c)
    columns = {
        "time_s": actuation.time_s, "n_e_rpm": n_e, "u_delta_mg": u_delta,
        "u_egr_pct": actuation.inputs.u_egr_pct[rows], "u_vgt_pct": actuation.inputs.u_vgt_pct[rows],
        "p_im_pa": p_im, "p_em_pa": p_em, "omega_t_rad_s": omega_t,
        "u_egr1_pct": actuation.u_egr1, "u_egr2_pct": actuation.u_egr2, "u_vgt_act_pct": actuation.u_vgt,
        "w_egr_kg_s": q.W_egr, "t_em_k": q.T_em, "w_c_kg_s": q.W_c, "w_t_kg_s": q.W_t, "w_ei_kg_s": q.W_ei,
        "w_eo_kg_s": q.W_eo, "w_f_kg_s": q.W_f, "t_e_k": q.T_e, "t_1_k": T_1, "x_r": x_r, "eta_c": q.eta_c,
        "eta_tm": q.eta_tm, "eta_vol": q.eta_vol, "phi_c": q.Phi_c, "f_vgt_pi_t": q.F_vgt_Pi_t, "f_egr": q.f_egr,
        "p_t_eta_m_w": q.P_t_eta_m, "p_c_w": q.P_c, "t_c_k": model.compressor_out_temperature(q.eta_c, q.Pi_c, c),
        "lambda": driver.air_fuel_ratio, "egr_fraction": driver.egr_fraction, "torque_nm": driver.torque,
    }  # fmt: skip
    return pd.DataFrame({name: np.broadcast_to(value, n_e.shape) for name, value in columns.items()})


def extended_frame(states: np.ndarray, actuation: Actuation, parameters: EngineParameters) -> pd.DataFrame:
    """Every quantity at given states, (n, 6) or (n, 5) as in `extended_terms.along`, under the parameters' terms.

    Columns of `published_frame`, then p_es_pa, p_bc_pa, t_im_k, w_leak_im_kg_s, w_leak_em_kg_s, p_friction_w,
    t_em_static_k (without thermal inertia). Actuator terms are in `actuation`; sensor terms don't enter.
    """
    q, _ = along(states, actuation, parameters.terms, constants(parameters))
    frame = published_frame(states, actuation, q, parameters)
    further = {
        "p_es_pa": q.p_es, "p_bc_pa": q.p_bc, "t_im_k": q.T_im, "w_leak_im_kg_s": q.W_leak_im,
        "w_leak_em_kg_s": q.W_leak_em, "p_friction_w": q.P_f, "t_em_static_k": q.T_em_static,
    }  # fmt: skip
    return frame.assign(**{name: np.broadcast_to(value, len(frame)) for name, value in further.items()})
