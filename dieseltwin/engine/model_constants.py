"""The flat constants that the equations read: published parameters, and factors that depend on them alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from dieseltwin.engine.nozzle import choking_quotient


class Constants(NamedTuple):
    """The scalars that the equations read: published parameters and, last, factors that depend on them alone.

    Every field is a float, or an array or tensor that broadcasts against the states.
    """

    c_pa: Any
    c_va: Any
    c_pe: Any
    R_a: Any
    R_e: Any
    gamma_a: Any
    gamma_e: Any
    T_amb: Any
    p_amb: Any
    T_im: Any
    V_im: Any
    V_em: Any
    V_d: Any
    r_c: Any
    n_cyl: Any
    q_HV: Any
    eta_sc: Any
    x_cv: Any
    h_tot: Any
    d_pipe: Any
    l_pipe: Any
    n_pipe: Any
    c_vol1: Any
    c_vol2: Any
    c_vol3: Any
    A_egrmax: Any
    Pi_egropt: Any
    c_egr1: Any
    c_egr2: Any
    c_egr3: Any
    tau_egr1: Any
    tau_egr2: Any
    K_egr: Any
    tau_degr: Any
    A_vgtmax: Any
    K_t: Any
    c_f1: Any
    c_f2: Any
    c_vgt1: Any
    c_vgt2: Any
    tau_vgt: Any
    tau_dvgt: Any
    J_t: Any
    R_t: Any
    R_c: Any
    eta_tmmax: Any
    BSR_opt: Any
    c_m1: Any
    c_m2: Any
    c_m3: Any
    omega_tlin: Any
    c_mlin: Any
    eta_cmax: Any
    a_1: Any
    a_2: Any
    a_3: Any
    W_copt: Any
    pi_copt: Any
    c_pi: Any
    c_omega_psi1: Any
    c_omega_psi2: Any
    c_omega_psi3: Any
    c_omega_phi1: Any
    c_omega_phi2: Any
    c_omega_phi3: Any
    c_psi2: Any
    c_phi2: Any
    AF_s: Any
    gamma_cyl: Any
    eta_igch: Any
    c_fric1: Any
    c_fric2: Any
    c_fric3: Any
    inverse_gamma_a: Any
    compression_heating: Any
    pipe_area: Any
    turbine_exponent: Any
    wheel_volume: Any
    u_egr_vertex: Any
    otto_efficiency: Any
    choking_a: Any
    choking_e: Any


CONSTANT_NAMES = Constants._fields
"""Order of the rows of every array that holds constants."""

DERIVED = Constants._fields[Constants._fields.index("inverse_gamma_a") :]
PUBLISHED = tuple(name for name in CONSTANT_NAMES if name not in DERIVED)


def derived(v: Mapping[str, Any]) -> dict[str, Any]:
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
    }
