"""Parameters of the plant: the published set as plain scalars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class Constants(NamedTuple):
    """Parameters of the plant as scalars [SI, speed in rpm, positions in %]."""

    c_pa: float
    c_va: float
    c_pe: float
    R_a: float
    R_e: float
    gamma_a: float
    gamma_e: float
    T_amb: float
    p_amb: float
    T_im: float
    V_im: float
    V_em: float
    V_d: float
    r_c: float
    n_cyl: float
    q_HV: float
    eta_sc: float
    x_cv: float
    h_tot: float
    d_pipe: float
    l_pipe: float
    n_pipe: float
    c_vol0: float
    c_vol1: float
    c_vol2: float
    A_egrmax: float
    Pi_egropt: float
    c_egr0: float
    c_egr1: float
    c_egr2: float
    A_vgtmax: float
    K_t: float
    c_f1: float
    c_f2: float
    c_vgt1: float
    c_vgt2: float
    J_t: float
    R_t: float
    R_c: float
    eta_tmmax: float
    BSR_opt: float
    c_m0: float
    c_m1: float
    c_m2: float
    omega_tlin: float
    c_mlin: float
    eta_cmax: float
    Q_c0: float
    Q_c1: float
    Q_c2: float
    W_copt: float
    pi_copt: float
    c_pi: float
    c_omega_psi0: float
    c_omega_psi1: float
    c_omega_psi2: float
    c_omega_phi0: float
    c_omega_phi1: float
    c_omega_phi2: float
    c_psi2: float
    c_phi2: float


def plant_constants(parameters: Mapping[str, Any]) -> Constants:
    """Scalars from a published parameter set by name; vectors are taken apart."""
    flat: dict[str, float] = {}
    for name, value in parameters.items():
        if isinstance(value, tuple | list):
            flat.update({f"{name}{k}": float(v) for k, v in enumerate(value) if not isinstance(v, str | tuple | dict)})
        elif isinstance(value, int | float):
            flat[name] = float(value)
    flat.update(c_psi2=float(parameters["c_psi2"]), c_phi2=float(parameters["c_phi2"]))
    return Constants(*(flat[name] for name in Constants._fields))
