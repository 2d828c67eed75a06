"""Composition of the published equations with the effects they leave out, and with signals at its insertion points.

With all magnitudes and signals zero the result is that of `model.quantities`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from dieseltwin.engine.array_namespace import Array, maximum, minimum, where, with_ambient_pressure, with_charge
from dieseltwin.engine.cylinder import (
    cylinder_inflow,
    cylinder_outflow,
    eta_vol,
    exhaust_manifold_temperature,
    exhaust_to_intake_ratio,
    fuel_flow,
)
from dieseltwin.engine.effect_laws import (
    clogged_share,
    cooler_temperature_rise,
    friction_power,
    leak_flow,
    mixing_temperature_rise,
    residual_volumetric_factor,
    restricted_inlet_pressure,
    restricted_outlet_pressure,
)
from dieseltwin.engine.egr import egr_area, egr_flow, egr_flow_factor, egr_pressure_ratio, f_egr
from dieseltwin.engine.manifolds import exhaust_pressure_rate, intake_pressure_rate
from dieseltwin.engine.model import cylinder_sweep
from dieseltwin.engine.parameters import Constants
from dieseltwin.engine.turbocharger import (
    F_vgt_Pi_t,
    Phi_c,
    compressor_flow,
    compressor_out_temperature,
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


class Magnitudes(NamedTuple):
    """Magnitudes of the effects inside the right-hand side, in the units of `effects.EFFECTS`.

    `exhaust_thermal_inertia` isn't used by the equations themselves: a lag needs the step (see `Gas`). `egr_clogging`
    is k t [-], not k.
    """

    boost_leak: Any
    exhaust_leak: Any
    back_pressure: Any
    air_filter_restriction: Any
    charge_cooler_loss: Any
    egr_heating: Any
    bearing_friction: Any
    exhaust_thermal_inertia: Any
    egr_valve_leak: Any
    egr_clogging: Any
    vgt_offset: Any
    injector_drift: Any
    compressor_efficiency_loss: Any
    turbine_efficiency_loss: Any
    compressor_flow_loss: Any
    volumetric_efficiency_residual: Any
    blow_by: Any


class Signals(NamedTuple):
    """Signals at the insertion points: relative on maps, flows, temperatures, pressures and u_delta, added elsewhere.

    Added are intake_balance, exhaust_balance [kg/s into the manifold], shaft_power [W], u_egr, u_vgt [% of position],
    egr_opening [-, share of the largest area, beside f_egr].
    """

    eta_vol: Any
    W_eo: Any
    T_e: Any
    T_em: Any
    f_egr: Any
    W_t: Any
    eta_tm: Any
    p_es: Any
    W_c: Any
    eta_c: Any
    p_bc: Any
    T_im: Any
    intake_balance: Any
    exhaust_balance: Any
    shaft_power: Any
    u_delta: Any
    u_egr: Any
    u_vgt: Any
    egr_opening: Any


class Gas(NamedTuple):
    """Gas in the exhaust manifold: T [K] that heats the EGR (start of a fixed point), and T_em = gain T_static + carry.

    Without thermal inertia gain is 1 and carry 0. With it, gain 0 and carry the lagged temperature; or both from the
    lag's exact solution over part of a step.
    """

    T: Any
    gain: Any
    carry: Any


class IntakeSide(NamedTuple):
    """What is known before the cylinder: compressor, charge temperature, flows (units as in `ExtendedQuantities`)."""

    u_delta: Any
    u_egr: Any
    u_vgt: Any
    p_bc: Any
    Pi_c: Any
    Phi_c: Any
    W_c: Any
    eta_c: Any
    P_c: Any
    T_c: Any
    T_im: Any
    f_egr: Any
    A_egr: Any
    Psi_egr: Any
    eta_vol: Any
    W_ei: Any
    W_f: Any
    W_eo: Any


class ExtendedQuantities(NamedTuple):
    """All algebraic quantities of the extended model, SI units; the first 23 are those of `model.Quantities`."""

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
    T_em_static: Any
    p_es: Any
    p_bc: Any
    T_im: Any
    T_c: Any
    W_leak_im: Any
    W_leak_em: Any
    P_f: Any


def compressor_flow_from(p_bc: Array, p_im: Array, omega_t: Array, factor: Array, c: Constants) -> Array:
    """Compressor flow W_c [kg/s] that draws from p_bc [Pa], times a factor."""
    inlet = with_ambient_pressure(c, p_bc)
    return factor * compressor_flow(
        Phi_c(c.T_amb, compressor_pressure_ratio(p_im, inlet), omega_t, inlet), omega_t, inlet
    )


def inlet_defect(
    p_bc: Array, p_im: Array, omega_t: Array, factor: Array, scale: Array, m: Magnitudes, c: Constants
) -> Array:
    """By how much p_bc [Pa] misses the filter's law for the flow it gives rise to."""
    W_c = compressor_flow_from(p_bc, p_im, omega_t, factor, c)
    return scale * restricted_inlet_pressure(m.air_filter_restriction, W_c, c.p_amb) - p_bc


def secant(x_0: Array, e_0: Array, x_1: Array, e_1: Array, low: Array, high: Array) -> Array:
    """Next iterate [Pa] of the secant method, limited; where the errors e [Pa] no longer differ, x_1 + e_1."""
    difference = e_0 - e_1
    usable = difference * difference > SECANT_LEAST
    step = where(usable, (x_1 - x_0) / where(usable, difference, 1.0), 1.0)
    return minimum(maximum(x_1 + e_1 * step, low), high)


SECANT_LEAST = 1e-12  # Pa2
INLET_GAIN = 3.0  # about twice d ln W_c/d ln p_bc, for the first step
OUTLET_GAIN = 1.0  # the same for the turbine


def inlet_pressure(p_im: Array, omega_t: Array, factor: Array, scale: Array, m: Magnitudes, c: Constants) -> Array:
    """Pressure before the compressor p_bc [Pa]: the filter's implicit law by the secant method, to 1e-6."""
    low, high = 0.4 * c.p_amb, 1.6 * c.p_amb
    x_0 = scale * c.p_amb
    e_0 = inlet_defect(x_0, p_im, omega_t, factor, scale, m, c)
    x_1 = x_0 + e_0 / (1.0 - INLET_GAIN * e_0 / x_0)
    e_1 = inlet_defect(x_1, p_im, omega_t, factor, scale, m, c)
    x_2 = secant(x_0, e_0, x_1, e_1, low, high)
    e_2 = inlet_defect(x_2, p_im, omega_t, factor, scale, m, c)
    x_3 = secant(x_1, e_1, x_2, e_2, low, high)
    e_3 = inlet_defect(x_3, p_im, omega_t, factor, scale, m, c)
    return secant(x_2, e_2, x_3, e_3, low, high)


def turbine_flow_to(
    p_es: Array, p_em: Array, T_em: Array, u_vgt: Array, factor: Array, c: Constants
) -> Array:
    """Turbine flow W_t [kg/s] that leaves into p_es [Pa], times a factor."""
    outlet = with_ambient_pressure(c, p_es)
    return factor * turbine_flow(F_vgt_Pi_t(u_vgt, turbine_pressure_ratio(p_em, outlet), c), p_em, T_em, c)


def outlet_defect(
    p_es: Array, p_em: Array, T_em: Array, u_vgt: Array, factor: Array, scale: Array, m: Magnitudes, c: Constants
) -> Array:
    """By how much p_es [Pa] misses the exhaust system's law for the flow it lets through."""
    W_t = turbine_flow_to(p_es, p_em, T_em, u_vgt, factor, c)
    return scale * restricted_outlet_pressure(m.back_pressure, W_t, T_em, c.p_amb) - p_es


def outlet_pressure(
    p_em: Array, T_em: Array, u_vgt: Array, factor: Array, scale: Array, m: Magnitudes, c: Constants
) -> Array:
    """Pressure behind the turbine p_es [Pa]: the exhaust system's implicit law by the secant method, to 1e-6."""
    low, high = 0.4 * c.p_amb, maximum(p_em, 1.6 * c.p_amb)
    x_0 = scale * c.p_amb
    e_0 = outlet_defect(x_0, p_em, T_em, u_vgt, factor, scale, m, c)
    x_1 = x_0 + e_0 / (1.0 + OUTLET_GAIN * e_0 / x_0)
    e_1 = outlet_defect(x_1, p_em, T_em, u_vgt, factor, scale, m, c)
    x_2 = secant(x_0, e_0, x_1, e_1, low, high)
    e_2 = outlet_defect(x_2, p_em, T_em, u_vgt, factor, scale, m, c)
    x_3 = secant(x_1, e_1, x_2, e_2, low, high)
    e_3 = outlet_defect(x_3, p_em, T_em, u_vgt, factor, scale, m, c)
    return secant(x_2, e_2, x_3, e_3, low, high)


def intake_side(
    p_im: Array, p_em: Array, omega_t: Array, T_gas: Array,
    n_e: Array, u_delta: Array, u_egr: Array, u_vgt: Array, m: Magnitudes, s: Signals, c: Constants,
) -> IntakeSide:  # fmt: skip
    """Everything before the cylinder; arguments as in `quantities_extended`, T_gas: `Gas.T` [K]."""
    fuel = u_delta * (1.0 + s.u_delta) * (1.0 + m.injector_drift)
    egr_position = u_egr + s.u_egr
    vgt_position = u_vgt + s.u_vgt + m.vgt_offset

    flow_factor = (1.0 + s.W_c) * (1.0 - m.compressor_flow_loss)
    p_bc = inlet_pressure(p_im, omega_t, flow_factor, 1.0 + s.p_bc, m, c)
    inlet = with_ambient_pressure(c, p_bc)
    Pi_c = compressor_pressure_ratio(p_im, inlet)
    flow_coefficient = Phi_c(c.T_amb, Pi_c, omega_t, inlet)
    W_c = flow_factor * compressor_flow(flow_coefficient, omega_t, inlet)
    compressor_efficiency = eta_c(W_c, Pi_c, c) * (1.0 + s.eta_c) * (1.0 - m.compressor_efficiency_loss)
    P_c = compressor_power(isentropic_compressor_power(W_c, Pi_c, c), compressor_efficiency)
    T_c = compressor_out_temperature(compressor_efficiency, Pi_c, c)

    opening = f_egr(egr_position, c) * (1.0 + s.f_egr) + m.egr_valve_leak + s.egr_opening
    A_egr = egr_area(opening, c) * clogged_share(m.egr_clogging)
    Psi_egr = egr_flow_factor(egr_pressure_ratio(p_im, p_em, c), c)
    W_egr = egr_flow(A_egr, p_em, Psi_egr, T_gas, c)
    cooled = c.T_im + cooler_temperature_rise(m.charge_cooler_loss, T_c, c.T_amb)
    T_im = (cooled + mixing_temperature_rise(m.egr_heating, T_gas, cooled, W_c, W_egr)) * (1.0 + s.T_im)

    charge = with_charge(c, T_im, c.eta_sc)
    volumetric = (
        eta_vol(p_im, n_e, c)
        * (1.0 + s.eta_vol)
        * residual_volumetric_factor(m.volumetric_efficiency_residual, p_im, p_em)
    )
    W_ei = cylinder_inflow(volumetric, p_im, n_e, charge)
    W_f = fuel_flow(fuel, n_e, c)
    W_eo = cylinder_outflow(W_f, W_ei * (1.0 - m.blow_by)) * (1.0 + s.W_eo)
    return IntakeSide(
        fuel, egr_position, vgt_position, p_bc, Pi_c, flow_coefficient, W_c, compressor_efficiency, P_c, T_c, T_im,
        opening, A_egr, Psi_egr, volumetric, W_ei, W_f, W_eo,
    )  # fmt: skip


def charge_constants(i: IntakeSide, s: Signals, c: Constants) -> Constants:
    """The constants as the cylinder sees them: T_im [K], and eta_sc [-] with the signal on T_e."""
    return with_charge(c, i.T_im, c.eta_sc * (1.0 + s.T_e))


def exhaust_side(
    i: IntakeSide, p_im: Array, p_em: Array, omega_t: Array, x_r: Array, T_1: Array, gas: Gas,
    m: Magnitudes, s: Signals, c: Constants,
) -> ExtendedQuantities:  # fmt: skip
    """Cylinder, exhaust manifold, turbine and balances behind `intake_side`; x_r [-], T_1 [K]."""
    charge = charge_constants(i, s, c)
    sweep = cylinder_sweep(exhaust_to_intake_ratio(p_em, p_im), i.W_ei, i.W_f, x_r, T_1, charge)
    static = exhaust_manifold_temperature(sweep.T_e, i.W_eo, c) * (1.0 + s.T_em)
    T_em = gas.gain * static + gas.carry
    W_egr = egr_flow(i.A_egr, p_em, i.Psi_egr, T_em, c)

    flow_factor = 1.0 + s.W_t
    p_es = outlet_pressure(p_em, T_em, i.u_vgt, flow_factor, 1.0 + s.p_es, m, c)
    Pi_t = turbine_pressure_ratio(p_em, with_ambient_pressure(c, p_es))
    turbine_opening = F_vgt_Pi_t(i.u_vgt, Pi_t, c)
    W_t = flow_factor * turbine_flow(turbine_opening, p_em, T_em, c)
    turbine_efficiency = eta_tm(omega_t, T_em, Pi_t, c) * (1.0 + s.eta_tm) * (1.0 - m.turbine_efficiency_loss)
    P_t_eta_m = turbine_power(turbine_efficiency, W_t, T_em, Pi_t, c)

    W_leak_im = leak_flow(m.boost_leak, p_im, i.T_im, c.p_amb, c.R_a, c.gamma_a, c.choking_a)
    W_leak_em = leak_flow(m.exhaust_leak, p_em, T_em, c.p_amb, c.R_e, c.gamma_e, c.choking_e)
    P_f = friction_power(m.bearing_friction, omega_t)
    return ExtendedQuantities(
        i.eta_vol, i.W_ei, i.W_f, i.W_eo, sweep.T_e, T_em, sweep.x_r, sweep.T_1, i.f_egr, W_egr, Pi_t, turbine_opening,
        W_t, turbine_efficiency, P_t_eta_m, i.Pi_c, i.Phi_c, i.W_c, i.eta_c, i.P_c,
        intake_pressure_rate(i.W_c - W_leak_im + s.intake_balance, W_egr, i.W_ei, charge),
        exhaust_pressure_rate(i.W_eo - W_leak_em + s.exhaust_balance, W_t, W_egr, T_em, c),
        turbo_speed_rate(P_t_eta_m - P_f + s.shaft_power, i.P_c, omega_t, c),
        static, p_es, i.p_bc, i.T_im, i.T_c, W_leak_im, W_leak_em, P_f,
    )  # fmt: skip


def quantities_extended(
    p_im: Array, p_em: Array, omega_t: Array, x_r: Array, T_1: Array, gas: Gas,
    n_e: Array, u_delta: Array, u_egr: Array, u_vgt: Array, m: Magnitudes, s: Signals, c: Constants,
) -> ExtendedQuantities:  # fmt: skip
    """All algebraic quantities of the extended model at given states and inputs.

    Args:
        p_im, p_em [Pa], omega_t [rad/s], x_r, T_1, n_e, u_delta, u_egr, u_vgt: as in `model.quantities`.
        gas: gas in the exhaust manifold.
        m: magnitudes of the effects; s: signals at the insertion points.
        c: constants.

    `x_r_next`, `T_1_next` (and T_em for `gas.T`, without thermal inertia) are fixed points as in `model.quantities`.
    """
    i = intake_side(p_im, p_em, omega_t, gas.T, n_e, u_delta, u_egr, u_vgt, m, s, c)
    return exhaust_side(i, p_im, p_em, omega_t, x_r, T_1, gas, m, s, c)
