"""Composition of the equations: everything that follows from the states, the inputs and the constants."""

from __future__ import annotations

from typing import Any, NamedTuple

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.cylinder import (
    cylinder_inflow,
    cylinder_out_temperature,
    cylinder_outflow,
    eta_vol,
    exhaust_manifold_temperature,
    exhaust_to_intake_ratio,
    fuel_flow,
    intake_valve_closing_temperature,
    isobaric_volume_ratio,
    isochoric_pressure_ratio,
    residual_gas_fraction,
    specific_heat_of_combustion,
)
from dieseltwin.engine.egr import egr_area, egr_flow, egr_flow_factor, egr_pressure_ratio, f_egr
from dieseltwin.engine.manifolds import exhaust_pressure_rate, intake_pressure_rate
from dieseltwin.engine.parameters import Constants
from dieseltwin.engine.turbocharger import (
    F_vgt_Pi_t,
    Phi_c,
    compressor_flow,
    compressor_power,
    compressor_pressure_ratio,
    eta_c,
    eta_tm,
    isentropic_compressor_power,
    turbine_flow,
    turbine_power,
    turbine_pressure_ratio,
    turbo_speed_rate,
)


class Sweep(NamedTuple):
    """One sweep of the cylinder's fixed point: residual gas fraction [-] and temperatures [K]."""

    x_r: Any
    T_1: Any
    T_e: Any


class Quantities(NamedTuple):
    """All algebraic quantities of the model, SI units; rates dp_im, dp_em [Pa/s], domega_t [rad/s2]."""

    eta_vol: Any
    W_ei: Any
    W_f: Any
    W_eo: Any
    T_e: Any
    T_em: Any
    x_r_next: Any
    T_1_next: Any
    f_egr: Any
    W_egr: Any
    Pi_t: Any
    F_vgt_Pi_t: Any
    W_t: Any
    eta_tm: Any
    P_t_eta_m: Any
    Pi_c: Any
    Phi_c: Any
    W_c: Any
    eta_c: Any
    P_c: Any
    dp_im: Any
    dp_em: Any
    domega_t: Any


def cylinder_sweep(Pi_e: Array, W_ei: Array, W_f: Array, x_r: Array, T_1: Array, c: Constants) -> Sweep:
    """One sweep of the fixed point of x_r and T_1: equations A.13, A.11, A.12, A.10, A.7, A.9 in this order."""
    q_in = specific_heat_of_combustion(W_f, W_ei, x_r, c)
    x_p = isochoric_pressure_ratio(q_in, T_1, c)
    x_v = isobaric_volume_ratio(q_in, T_1, c)
    x_r_next = residual_gas_fraction(Pi_e, x_p, x_v, c)
    T_e = cylinder_out_temperature(Pi_e, x_p, q_in, T_1, c)
    return Sweep(x_r_next, intake_valve_closing_temperature(x_r_next, T_e, c), T_e)


def settle_cylinder(
    p_im: Array, p_em: Array, n_e: Array, u_delta: Array, x_r: Array, T_1: Array, c: Constants
) -> Sweep:
    """Two sweeps of the cylinder's fixed point from the start (x_r, T_1); a sweep contracts the error 20-fold."""
    W_ei = cylinder_inflow(eta_vol(p_im, n_e, c), p_im, n_e, c)
    W_f = fuel_flow(u_delta, n_e, c)
    Pi_e = exhaust_to_intake_ratio(p_em, p_im)
    first = cylinder_sweep(Pi_e, W_ei, W_f, x_r, T_1, c)
    return cylinder_sweep(Pi_e, W_ei, W_f, first.x_r, first.T_1, c)


def quantities(
    p_im: Array, p_em: Array, omega_t: Array, x_r: Array, T_1: Array,
    n_e: Array, u_delta: Array, u_egr: Array, u_vgt: Array, c: Constants,
) -> Quantities:  # fmt: skip
    """All algebraic quantities at given states and inputs; no fixed point is solved inside.

    Args:
        p_im, p_em: manifold pressures [Pa]; omega_t: turbo speed [rad/s].
        x_r: residual gas fraction [-]; T_1: temperature at intake valve closing [K].
        n_e: engine speed [rpm]; u_delta: injected mass [mg/cycle].
        u_egr, u_vgt: actuator positions u~_egr, u~_vgt behind dead time and lags [%].
        c: constants.

    All arguments broadcast against each other. `x_r_next`, `T_1_next` are the right-hand sides of A.10 and A.9: the
    fixed point is where they equal x_r and T_1.
    """
    volumetric = eta_vol(p_im, n_e, c)
    W_ei = cylinder_inflow(volumetric, p_im, n_e, c)
    W_f = fuel_flow(u_delta, n_e, c)
    W_eo = cylinder_outflow(W_f, W_ei)
    sweep = cylinder_sweep(exhaust_to_intake_ratio(p_em, p_im), W_ei, W_f, x_r, T_1, c)
    T_em = exhaust_manifold_temperature(sweep.T_e, W_eo, c)

    egr_opening = f_egr(u_egr, c)
    W_egr = egr_flow(egr_area(egr_opening, c), p_em, egr_flow_factor(egr_pressure_ratio(p_im, p_em, c), c), T_em, c)

    Pi_t = turbine_pressure_ratio(p_em, c)
    turbine_opening = F_vgt_Pi_t(u_vgt, Pi_t, c)
    W_t = turbine_flow(turbine_opening, p_em, T_em, c)
    turbine_efficiency = eta_tm(omega_t, T_em, Pi_t, c)
    P_t_eta_m = turbine_power(turbine_efficiency, W_t, T_em, Pi_t, c)

    Pi_c = compressor_pressure_ratio(p_im, c)
    flow_coefficient = Phi_c(c.T_amb, Pi_c, omega_t, c)
    W_c = compressor_flow(flow_coefficient, omega_t, c)
    compressor_efficiency = eta_c(W_c, Pi_c, c)
    P_c = compressor_power(isentropic_compressor_power(W_c, Pi_c, c), compressor_efficiency)

    return Quantities(
        volumetric, W_ei, W_f, W_eo, sweep.T_e, T_em, sweep.x_r, sweep.T_1, egr_opening, W_egr, Pi_t, turbine_opening,
        W_t, turbine_efficiency, P_t_eta_m, Pi_c, flow_coefficient, W_c, compressor_efficiency, P_c,
        intake_pressure_rate(W_c, W_egr, W_ei, c),
        exhaust_pressure_rate(W_eo, W_t, W_egr, T_em, c),
        turbo_speed_rate(P_t_eta_m, P_c, omega_t, c),
    )  # fmt: skip
