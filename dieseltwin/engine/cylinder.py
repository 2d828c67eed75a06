"""Cylinder: flows, exhaust temperature through the limited-pressure cycle, torque (paper, appendix A.I "Cylinder")."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, exp, maximum, minimum, positive_power, root
from dieseltwin.engine.model_constants import Constants

X_R_MAX = 1.0  # limiter: residual gas fraction in [0, 1]
T_1_MIN = 273.0  # K, limiter of the published simulation
W_EO_MIN = 1e-6  # kg/s, limiter: keeps the exponent of the pipe's heat loss finite at standstill


def eta_vol(p_im: Array, n_e: Array, c: Constants) -> Array:
    """Volumetric efficiency eta_vol [-] (A.6) from p_im [Pa] and n_e [rpm]. Empirical map N_1."""
    return c.c_vol1 * root(p_im) + c.c_vol2 * root(n_e) + c.c_vol3


def cylinder_inflow(eta_vol: Array, p_im: Array, n_e: Array, c: Constants) -> Array:
    """Mass flow into the cylinders W_ei [kg/s] (A.3)."""
    return eta_vol * p_im * n_e * c.V_d / (120.0 * c.R_a * c.T_im)


def fuel_flow(u_delta: Array, n_e: Array, c: Constants) -> Array:
    """Fuel mass flow W_f [kg/s] (A.5) from u_delta [mg/cycle] and n_e [rpm]."""
    return 1e-6 / 120.0 * u_delta * n_e * c.n_cyl


def cylinder_outflow(W_f: Array, W_ei: Array) -> Array:
    """Mass flow out of the cylinders W_eo [kg/s] (A.4)."""
    return W_f + W_ei


def exhaust_to_intake_ratio(p_em: Array, p_im: Array) -> Array:
    """Pressure quotient over the cylinder Pi_e [-] (A.8)."""
    return p_em / p_im


def specific_heat_of_combustion(W_f: Array, W_ei: Array, x_r: Array, c: Constants) -> Array:
    """Specific energy of the charge q_in [J/kg] (A.13)."""
    return W_f * c.q_HV / (W_ei + W_f) * (1.0 - x_r)


def isochoric_pressure_ratio(q_in: Array, T_1: Array, c: Constants) -> Array:
    """Pressure quotient of the constant-volume combustion x_p [-] (A.11)."""
    return 1.0 + q_in * c.x_cv / (c.c_va * T_1 * c.compression_heating)


def isobaric_volume_ratio(q_in: Array, T_1: Array, c: Constants) -> Array:
    """Volume quotient of the constant-pressure combustion x_v [-] (A.12)."""
    return 1.0 + q_in * (1.0 - c.x_cv) / (c.c_pa * (q_in * c.x_cv / c.c_va + T_1 * c.compression_heating))


def residual_gas_fraction(Pi_e: Array, x_p: Array, x_v: Array, c: Constants) -> Array:
    """Residual gas fraction x_r [-] (A.10, printed again as A.14), limited to [0, 1]."""
    x_r = positive_power(Pi_e, c.inverse_gamma_a) * positive_power(x_p, -c.inverse_gamma_a) / (c.r_c * x_v)
    return minimum(maximum(x_r, 0.0), X_R_MAX)


def cylinder_out_temperature(Pi_e: Array, x_p: Array, q_in: Array, T_1: Array, c: Constants) -> Array:
    """Temperature behind the cylinders T_e [K] (A.7)."""
    expansion = positive_power(Pi_e, 1.0 - c.inverse_gamma_a) / c.compression_heating
    heat = q_in * ((1.0 - c.x_cv) / c.c_pa + c.x_cv / c.c_va) + T_1 * c.compression_heating
    return c.eta_sc * expansion * positive_power(x_p, c.inverse_gamma_a - 1.0) * heat


def intake_valve_closing_temperature(x_r: Array, T_e: Array, c: Constants) -> Array:
    """Temperature at intake valve closing after mixing T_1 [K] (A.9), not below 273 K."""
    return maximum(x_r * T_e + (1.0 - x_r) * c.T_im, T_1_MIN)


def exhaust_manifold_temperature(T_e: Array, W_eo: Array, c: Constants) -> Array:
    """Gas temperature in the exhaust manifold T_em [K] (A.15): pipe with its wall at T_amb."""
    return c.T_amb + (T_e - c.T_amb) * exp(-c.h_tot * c.pipe_area / (maximum(W_eo, W_EO_MIN) * c.c_pe))


def torque(u_delta: Array, n_e: Array, p_im: Array, p_em: Array, c: Constants) -> Array:
    """Engine torque M_e [N m] (Wahlström & Eriksson 2011, Eqs. 16-19): indicated less pumping and friction work."""
    W_ig = 1e-6 * u_delta * c.n_cyl * c.q_HV * c.eta_igch * c.otto_efficiency
    W_p = c.V_d * (p_em - p_im)
    speed = n_e / 1000.0
    W_fric = c.V_d * 1e5 * (c.c_fric1 * speed * speed + c.c_fric2 * speed + c.c_fric3)
    return (W_ig - W_p - W_fric) / (4.0 * PI)


PI = 3.141592653589793
