"""Random operating points with the exact values of the six maps: laboratory data without a simulation."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.engine import bind, constants, we2011

AMBIENTS = {"case_i": (-65.0, -1e4), "case_ii": (-65.0, 2.11e4), "case_iii": (-28.0, -1e4), "case_iv": (15.0, 2.11e4)}


def operating_points(n: int, seed: int, *, delta_t_amb_k: float = 0.0, delta_p_amb_pa: float = 0.0) -> pd.DataFrame:
    """n rows with the columns that the maps' training needs, spread like a recording's but independent."""
    rng = np.random.default_rng(seed)
    base = we2011.PARAMETERS
    p_amb, t_amb = base.p_amb + delta_p_amb_pa, base.T_amb + delta_t_amb_k
    c = constants(base)._replace(p_amb=p_amb, T_amb=t_amb)
    model = bind("numpy")
    omega_t = np.exp(rng.uniform(np.log(1500.0), np.log(11000.0), n))
    boost = np.clip((omega_t / 11000.0) ** 2 * rng.uniform(1.3, 2.2, n), 0.0, None)
    p_im = p_amb * (1.0 + boost)
    p_em = p_im * rng.uniform(1.01, 1.3, n)
    opening = np.clip(rng.uniform(-5.0, 105.0, n), 0.0, 100.0)
    frame = pd.DataFrame(
        {
            "n_e_rpm": rng.uniform(600.0, 1850.0, n), "p_im_pa": p_im, "p_em_pa": p_em, "omega_t_rad_s": omega_t,
            "u_egr1_pct": opening, "u_egr2_pct": opening, "u_vgt_act_pct": rng.uniform(20.0, 95.0, n),
            "p_amb_pa": p_amb, "t_amb_k": t_amb,
        }
    )  # fmt: skip
    Pi_t, Pi_c = model.turbine_pressure_ratio(p_em, c), model.compressor_pressure_ratio(p_im, c)
    # the temperature that gives blade speed ratios of 0.35-1.1, within what exhaust gas can have
    wanted = (c.R_t * omega_t / rng.uniform(0.35, 1.1, n)) ** 2 / (2.0 * c.c_pe * model.turbine_expansion(Pi_t, c))
    frame["t_em_k"] = np.clip(wanted, 320.0, 1100.0)
    frame["phi_c"] = model.Phi_c(t_amb, Pi_c, omega_t, c)
    frame["w_c_kg_s"] = model.compressor_flow(frame["phi_c"].to_numpy(), omega_t, c)
    frame["eta_vol"] = model.eta_vol(p_im, frame["n_e_rpm"].to_numpy(), c)
    frame["f_egr"] = model.f_egr(opening, c)
    frame["f_vgt_pi_t"] = model.F_vgt_Pi_t(frame["u_vgt_act_pct"].to_numpy(), Pi_t, c)
    frame["eta_tm"] = model.eta_tm(omega_t, frame["t_em_k"].to_numpy(), Pi_t, c)
    frame["eta_c"] = model.eta_c(frame["w_c_kg_s"].to_numpy(), Pi_c, c)
    return frame


def laboratory(n: int, seed: int) -> dict[str, pd.DataFrame]:
    """The four training cases."""
    return {
        name: operating_points(n, seed + k, delta_t_amb_k=t, delta_p_amb_pa=p)
        for k, (name, (t, p)) in enumerate(AMBIENTS.items())
    }
