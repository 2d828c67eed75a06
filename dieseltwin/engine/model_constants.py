"""The flat constants that the equations read: published parameters, and factors that depend on them alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.nozzle import choking_quotient


class Constants(NamedTuple):
    """The scalars that the equations read: published parameters and, last, factors that depend on them alone.

    Every field is a float, or an array or tensor that broadcasts against the states.
    """

    c_pa: Array
    c_va: Array
    c_pe: Array
    R_a: Array
    R_e: Array
    gamma_a: Array
    gamma_e: Array
    T_amb: Array
    p_amb: Array
    T_im: Array
    V_im: Array
    V_em: Array
    V_d: Array
    r_c: Array
    n_cyl: Array
    q_HV: Array
    eta_sc: Array
    x_cv: Array
    h_tot: Array
    d_pipe: Array
    l_pipe: Array
    n_pipe: Array
    c_vol1: Array
    c_vol2: Array
    c_vol3: Array
    A_egrmax: Array
    Pi_egropt: Array
    c_egr1: Array
    c_egr2: Array
    c_egr3: Array
    tau_egr1: Array
    tau_egr2: Array
    K_egr: Array
    tau_degr: Array
    A_vgtmax: Array
    K_t: Array
    c_f1: Array
    c_f2: Array
    c_vgt1: Array
    c_vgt2: Array
    tau_vgt: Array
    tau_dvgt: Array
    J_t: Array
    R_t: Array
    R_c: Array
    eta_tmmax: Array
    BSR_opt: Array
    c_m1: Array
    c_m2: Array
    c_m3: Array
    omega_tlin: Array
    c_mlin: Array
    eta_cmax: Array
    a_1: Array
    a_2: Array
    a_3: Array
    W_copt: Array
    pi_copt: Array
    c_pi: Array
    c_omega_psi1: Array
    c_omega_psi2: Array
    c_omega_psi3: Array
    c_omega_phi1: Array
    c_omega_phi2: Array
    c_omega_phi3: Array
    c_psi2: Array
    c_phi2: Array
    AF_s: Array
    gamma_cyl: Array
    eta_igch: Array
    c_fric1: Array
    c_fric2: Array
    c_fric3: Array
    p_cmap: Array
    T_cmap: Array
    k_cflow: Array
    k_cspeed: Array
    inverse_gamma_a: Array
    compression_heating: Array
    pipe_area: Array
    turbine_exponent: Array
    wheel_volume: Array
    u_egr_vertex: Array
    otto_efficiency: Array
    choking_a: Array
    choking_e: Array
    flow_correction: Array
    speed_correction: Array


CONSTANT_NAMES = Constants._fields
"""Order of the rows of every array that holds constants."""

DERIVED = Constants._fields[Constants._fields.index("inverse_gamma_a") :]
PUBLISHED = tuple(name for name in CONSTANT_NAMES if name not in DERIVED)


def derived(v: Mapping[str, Array]) -> dict[str, Array]:
    """Factors of parameters alone, computed once instead of at every right-hand side."""
    return {
        "inverse_gamma_a": 1.0 / v["gamma_a"],
        "compression_heating": v["r_c"] ** (v["gamma_a"] - 1.0),  # T_2/T_1 of the isentropic compression
        "pipe_area": math.pi * v["d_pipe"] * v["l_pipe"] * v["n_pipe"],  # m2
        "turbine_exponent": 1.0 - 1.0 / v["gamma_e"],
        "wheel_volume": math.pi * v["R_c"] ** 3,  # m3
        "u_egr_vertex": -v["c_egr2"] / (2.0 * v["c_egr1"]),  # %
        "otto_efficiency": 1.0 - v["r_c"] ** (1.0 - v["gamma_cyl"]),
        "choking_a": choking_quotient(v["gamma_a"]),
        "choking_e": choking_quotient(v["gamma_e"]),
        "flow_correction": ((v["T_amb"] / v["T_cmap"]) ** 0.5 * v["p_cmap"] / v["p_amb"]) ** v["k_cflow"],
        "speed_correction": (v["T_cmap"] / v["T_amb"]) ** (0.5 * v["k_cspeed"]),
    }
