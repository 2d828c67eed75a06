"""Laws of the effects that the published model leaves out: each one plain function of flows, pressures, temperatures.

Written over the primitives of `array_namespace` like the published equations, and bound with them (`binding.bind`).
Sources: isentropic nozzle, Heywood, Internal Combustion Engine Fundamentals, App. C; quadratic restrictions and the
effectiveness of a heat exchanger, Eriksson & Nielsen, Modeling and Control of Engines and Drivelines, ch. 7.
"""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum, minimum, positive_power, root

T_ES_REFERENCE = 700.0  # K, gas temperature at which the back-pressure coefficient is stated


def nozzle_flow_factor(Pi: Array, gamma: Array, choking: Array) -> Array:
    """Flow factor Psi [-] of an isentropic nozzle at the pressure quotient Pi (outer over inner): choked below
    `choking`, no back-flow above 1."""
    quotient = minimum(maximum(Pi, choking), 1.0)
    density = positive_power(quotient, 1.0 / gamma)  # density quotient
    return root(2.0 * gamma / (gamma - 1.0) * density * (density - quotient))


def leak_flow(area: Array, p: Array, T: Array, p_out: Array, R: Array, gamma: Array, choking: Array) -> Array:
    """Leak flow [kg/s] from p [Pa], T [K] to p_out [Pa] through an area [m2]."""
    return area * p / root(R * T) * nozzle_flow_factor(p_out / p, gamma, choking)


def restricted_inlet_pressure(k: Array, W_c: Array, p_amb: Array) -> Array:
    """Pressure before the compressor p_bc [Pa] behind a filter of k [Pa/(kg/s)^2], at least half of p_amb."""
    return maximum(p_amb - k * W_c * W_c, 0.5 * p_amb)


def restricted_outlet_pressure(k: Array, W_t: Array, T_em: Array, p_amb: Array) -> Array:
    """Pressure behind the turbine p_es [Pa] before an exhaust system of k [Pa/(kg/s)^2] at 700 K."""
    return p_amb + k * W_t * W_t * T_em / T_ES_REFERENCE


def cooler_temperature_rise(loss: Array, T_c: Array, T_amb: Array) -> Array:
    """Rise of T_im [K] by a charge cooler of effectiveness 1 - loss [-] behind a compressor at T_c [K]."""
    return loss * (T_c - T_amb)


def mixing_temperature_rise(f: Array, T_em: Array, T_im: Array, W_c: Array, W_egr: Array) -> Array:
    """Rise of T_im [K] by EGR that arrives at T_im + f (T_em - T_im), mixed by mass flows [kg/s]."""
    return f * (T_em - T_im) * W_egr / (W_c + W_egr)


def friction_power(c_f: Array, omega_t: Array) -> Array:
    """Power of the turbocharger's bearing friction P_f [W] with c_f [N m s]."""
    return c_f * omega_t * omega_t


def clogged_share(k_t: Array) -> Array:
    """Share of the EGR area that soot leaves open [-] at k t [-]."""
    return maximum(1.0 - k_t, 0.0)


def residual_volumetric_factor(k: Array, p_im: Array, p_em: Array) -> Array:
    """Factor on eta_vol [-] by residual gas that expands into the intake."""
    return 1.0 - k * (p_em / p_im - 1.0)
