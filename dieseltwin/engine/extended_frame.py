"""Every quantity of an engine along its states as a table."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.engine.binding import Model, numpy_model
from dieseltwin.engine.extended_terms import Terms, along
from dieseltwin.engine.inputs import Actuation
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.parameters import EngineParameters, constants, parameter_batch
from dieseltwin.sensors import READ
from dieseltwin.symbols import SYMBOLS


def columns_along(
    states: np.ndarray, actuation: Actuation, terms: Terms, c: Constants, extended: bool, published: Model | None = None
) -> dict[str, np.ndarray]:
    """Every quantity at given states, (..., n, 6) or (..., n, 5) as in `extended_terms.along`: name -> (..., n).

    The columns of the reference traces; those of the extended model after them: p_es_pa, p_bc_pa, t_im_k,
    w_leak_im_kg_s, w_leak_em_kg_s, p_friction_w, t_em_static_k (without thermal inertia). Actuator terms are in
    `actuation`; sensor terms don't enter. Commands and engine speed are the inputs'; the torque is that of the mass
    that is really injected.

    Args:
        states: of one lane or of several.
        actuation: of all lanes, with the inputs.
        terms: of the engine.
        c: constants; arrays of shape (B, 1) for several lanes.
        extended: with the extended model and its columns; without it there are no terms.
        published: the equations without it over numpy arrays, for instance with learned maps; None: as written.
    """
    further: dict[str, Any] = {}
    q: Any
    if extended:
        q, _ = along(states, actuation, terms, c)
        further = {
            "p_es_pa": q.p_es, "p_bc_pa": q.p_bc, "t_im_k": q.T_im, "w_leak_im_kg_s": q.W_leak_im,
            "w_leak_em_kg_s": q.W_leak_em, "p_friction_w": q.P_f, "t_em_static_k": q.T_em_static,
        }  # fmt: skip
    else:
        q = (published or numpy_model()).quantities(*np.moveaxis(states[..., :5], -1, 0), *actuation.at_samples(), c)
    model = numpy_model()
    p_im, p_em, omega_t, x_r, T_1 = np.moveaxis(states[..., :5], -1, 0)
    rows = slice(actuation.inputs.n_history, None)
    n_e, u_delta = actuation.inputs.n_e_rpm[rows], actuation.inputs.u_delta_mg[rows]
    driver = model.driver_quantities(q, n_e, p_im, p_em, c)
    columns = {
        "time_s": actuation.time_s, "n_e_rpm": n_e, "u_delta_mg": u_delta,
        "u_egr_pct": actuation.inputs.u_egr_pct[rows], "u_vgt_pct": actuation.inputs.u_vgt_pct[rows],
        "p_im_pa": p_im, "p_em_pa": p_em, "omega_t_rad_s": omega_t,
        "u_egr1_pct": actuation.u_egr1, "u_egr2_pct": actuation.u_egr2, "u_vgt_act_pct": actuation.u_vgt,
        **{SYMBOLS[name].column: getattr(q, name) for name in READ}, "w_t_kg_s": q.W_t, "w_ei_kg_s": q.W_ei,
        "w_eo_kg_s": q.W_eo, "w_f_kg_s": q.W_f, "t_e_k": q.T_e, "t_1_k": T_1, "x_r": x_r, "eta_c": q.eta_c,
        "eta_tm": q.eta_tm, "eta_vol": q.eta_vol, "phi_c": q.Phi_c, "f_vgt_pi_t": q.F_vgt_Pi_t, "f_egr": q.f_egr,
        "p_t_eta_m_w": q.P_t_eta_m, "p_c_w": q.P_c, "t_c_k": q.T_c, "lambda": driver.air_fuel_ratio,
        "egr_fraction": driver.egr_fraction, "torque_nm": driver.torque, **further,
    }  # fmt: skip
    return {name: np.broadcast_to(value, p_im.shape) for name, value in columns.items()}


def extended_frame(states: np.ndarray, actuation: Actuation, parameters: EngineParameters) -> pd.DataFrame:
    """`columns_along` of one lane (n, 5 or 6) of an engine with its terms, as a table."""
    return pd.DataFrame(columns_along(states, actuation, parameters.terms, constants(parameters), True))


def lanes_along(
    states: np.ndarray, actuation: Actuation, parameters: EngineParameters, published: Model | None = None,
    **changed: np.ndarray,
) -> dict[str, np.ndarray]:  # fmt: skip
    """`columns_along` of K lanes (K, n, 5 or 6) of one engine, each with its own values (K,) of some parameters.

    published: see there.
    """
    c = Constants(*parameter_batch(parameters, size=len(states), **changed).values[:, :, None])
    return columns_along(states, actuation, parameters.terms, c, bool(parameters.terms), published)
