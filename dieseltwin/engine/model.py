"""Composition of the equations: everything that follows from the states, the inputs and the constants.

There is one composition. Effects enter it at the hooks (`hooks`), signals by `relative` and `added`. `binding.bind`
makes two models of it: `quantities_extended` with both, and `quantities`, the published model, where `without_effects`
stands in place of what they need.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dieseltwin.engine.array_namespace import Array, maximum, minimum, where, with_ambient_pressure, with_charge
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
    torque,
)
from dieseltwin.engine.egr import egr_area, egr_flow, egr_flow_factor, egr_pressure_ratio, f_egr
from dieseltwin.engine.hooks import (
    at_A_egr,
    at_egr_opening,
    at_eta_c,
    at_eta_sc,
    at_eta_tm,
    at_eta_vol,
    at_exhaust_balance,
    at_intake_balance,
    at_p_bc,
    at_p_es,
    at_shaft_power,
    at_T_em,
    at_T_im,
    at_u_delta,
    at_u_egr,
    at_u_vgt,
    at_W_c,
    at_W_eo,
    at_W_t,
)
from dieseltwin.engine.manifolds import air_fuel_ratio, egr_fraction, exhaust_pressure_rate, intake_pressure_rate
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.quantities import (
    Charge,
    DriverQuantities,
    Gas,
    IntakeSide,
    MapArguments,
    OperatingPoint,
    Quantities,
    Signals,
    Sweep,
)
from dieseltwin.engine.turbocharger import (
    F_vgt_Pi_t,
    Phi_c,
    blade_speed_ratio,
    compressor_flow,
    compressor_out_temperature,
    compressor_power,
    compressor_pressure_ratio,
    corrected_speed,
    energy_transfer_coefficient,
    eta_c,
    eta_tm,
    isentropic_compressor_power,
    turbine_flow,
    turbine_power,
    turbine_pressure_ratio,
    turbo_speed_rate,
)

Magnitudes = Any
"""A tuple with one field an effect inside the right-hand side (`effects.Magnitudes`); a drift's is rate times time."""

INLET_GAIN = -3.0  # about twice -d ln W_c/d ln p_bc, for the first step of `pressure_root`
OUTLET_GAIN = 1.0  # the same for the turbine
SECANT_LEAST = 1e-12  # Pa2


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


def relative(quantity: Array, signal: Array) -> Array:
    """A quantity under a relative signal [-]."""
    return quantity * (1.0 + signal)


def added(quantity: Array, signal: Array) -> Array:
    """A quantity under a signal that is added [its unit]."""
    return quantity + signal


def driven(x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> OperatingPoint:
    """The operating point with injected mass [mg/cycle] and actuator positions [%] as they really are.

    Of fuel there is no less than a hundredth of a milligram: none, but quotients of flows stay finite.
    """
    u_delta = at_u_delta(maximum(relative(x.u_delta, s.u_delta), 0.01), x, m, c)
    u_egr = at_u_egr(added(x.u_egr, s.u_egr), x, m, c)
    u_vgt = at_u_vgt(added(x.u_vgt, s.u_vgt), x, m, c)
    return OperatingPoint(x.p_im, x.p_em, x.omega_t, x.x_r, x.T_1, x.n_e, u_delta, u_egr, u_vgt)


def compressor_flow_from(p_bc: Array, x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Compressor flow W_c [kg/s] that draws from p_bc [Pa]."""
    inlet = with_ambient_pressure(c, p_bc)
    Pi_c = compressor_pressure_ratio(x.p_im, inlet)
    flow = compressor_flow(Phi_c(c.T_amb, Pi_c, x.omega_t, inlet), x.omega_t, inlet)
    return relative(at_W_c(flow, x, Pi_c, m, c), s.W_c)


def inlet_defect(p_bc: Array, x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """By how much p_bc [Pa] misses the law of what lies before the compressor, for the flow it gives rise to."""
    W_c = compressor_flow_from(p_bc, x, m, s, c)
    return relative(at_p_bc(c.p_amb, x, W_c, m, c), s.p_bc) - p_bc


def inlet_pressure(x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Pressure before the compressor p_bc [Pa]: solved, to 1e-6."""
    start = relative(c.p_amb, s.p_bc)
    return pressure_root(inlet_defect, start, INLET_GAIN, 0.4 * c.p_amb, 1.6 * c.p_amb, x, m, s, c)


def turbine_flow_to(p_es: Array, x: OperatingPoint, T_em: Array, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Turbine flow W_t [kg/s] that leaves into p_es [Pa]."""
    Pi_t = turbine_pressure_ratio(x.p_em, with_ambient_pressure(c, p_es))
    flow = turbine_flow(F_vgt_Pi_t(x.u_vgt, Pi_t, c), x.p_em, T_em, c)
    return relative(at_W_t(flow, x, Pi_t, T_em, m, c), s.W_t)


def outlet_defect(p_es: Array, x: OperatingPoint, T_em: Array, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """By how much p_es [Pa] misses the law of what lies behind the turbine, for the flow it lets through."""
    W_t = turbine_flow_to(p_es, x, T_em, m, s, c)
    return relative(at_p_es(c.p_amb, x, W_t, T_em, m, c), s.p_es) - p_es


def outlet_pressure(x: OperatingPoint, T_em: Array, m: Magnitudes, s: Signals, c: Constants) -> Array:
    """Pressure behind the turbine p_es [Pa]: solved, to 1e-6."""
    start = relative(c.p_amb, s.p_es)
    high = maximum(x.p_em, 1.6 * c.p_amb)
    return pressure_root(outlet_defect, start, OUTLET_GAIN, 0.4 * c.p_amb, high, x, T_em, m, s, c)


def pressure_root(
    defect: Callable[..., Array], start: Array, gain: float, low: Array, high: Array, *arguments: Any
) -> Array:
    """Pressure [Pa] at which `defect(pressure, *arguments)` [Pa] vanishes: four steps of the secant from `start`.

    gain: of the first step, relative to the defect over the pressure; low, high: limits [Pa].
    """
    x_0 = start
    e_0 = defect(x_0, *arguments)
    x_1 = x_0 + e_0 / (1.0 + gain * e_0 / x_0)
    e_1 = defect(x_1, *arguments)
    x_2 = secant(x_0, e_0, x_1, e_1, low, high)
    e_2 = defect(x_2, *arguments)
    x_3 = secant(x_1, e_1, x_2, e_2, low, high)
    e_3 = defect(x_3, *arguments)
    return secant(x_2, e_2, x_3, e_3, low, high)


def secant(x_0: Array, e_0: Array, x_1: Array, e_1: Array, low: Array, high: Array) -> Array:
    """Next iterate [Pa] of the secant method, limited; where the errors e [Pa] no longer differ, x_1 + e_1."""
    difference = e_0 - e_1
    usable = difference * difference > SECANT_LEAST
    step = where(usable, (x_1 - x_0) / where(usable, difference, 1.0), 1.0)
    return minimum(maximum(x_1 + e_1 * step, low), high)


def heating_egr_flow(A_egr: Array, p_em: Array, Psi_egr: Array, gas: Gas, c: Constants) -> Array:
    """EGR flow [kg/s] that decides the charge's temperature, at the gas temperature known so far."""
    return egr_flow(A_egr, p_em, Psi_egr, gas.T, c)


def stored(static: Array, gas: Gas) -> Array:
    """Gas temperature T_em [K] behind the manifold's thermal inertia."""
    return gas.gain * static + gas.carry


def intake_side(x: OperatingPoint, gas: Gas, m: Magnitudes, s: Signals, c: Constants) -> IntakeSide:
    """Everything before the cylinder; x: `driven`."""
    p_bc = inlet_pressure(x, m, s, c)
    inlet = with_ambient_pressure(c, p_bc)
    Pi_c = compressor_pressure_ratio(x.p_im, inlet)
    flow_coefficient = Phi_c(c.T_amb, Pi_c, x.omega_t, inlet)
    W_c = relative(at_W_c(compressor_flow(flow_coefficient, x.omega_t, inlet), x, Pi_c, m, c), s.W_c)
    compressor_efficiency = relative(at_eta_c(eta_c(W_c, Pi_c, c), x, W_c, Pi_c, m, c), s.eta_c)
    P_c = compressor_power(isentropic_compressor_power(W_c, Pi_c, c), compressor_efficiency)
    T_c = compressor_out_temperature(compressor_efficiency, Pi_c, c)

    opening = at_egr_opening(relative(f_egr(x.u_egr, c), s.f_egr), x, m, c)
    opening = added(opening, s.egr_opening)
    A_egr = at_A_egr(egr_area(opening, c), x, m, c)
    Psi_egr = egr_flow_factor(egr_pressure_ratio(x.p_im, x.p_em, c), c)
    W_egr = heating_egr_flow(A_egr, x.p_em, Psi_egr, gas, c)

    volumetric = relative(at_eta_vol(eta_vol(x.p_im, x.n_e, c), x, m, c), s.eta_vol)
    T_im = relative(at_T_im(c.T_im, x, Charge(volumetric, W_c, W_egr, T_c, gas.T), m, c), s.T_im)
    W_ei = cylinder_inflow(volumetric, x.p_im, x.n_e, with_charge(c, T_im, c.eta_sc))
    W_f = fuel_flow(x.u_delta, x.n_e, c)
    W_eo = relative(at_W_eo(cylinder_outflow(W_f, W_ei), x, W_ei, W_f, m, c), s.W_eo)
    return IntakeSide(
        p_bc, Pi_c, flow_coefficient, W_c, compressor_efficiency, P_c, T_c, T_im, opening, A_egr, Psi_egr, volumetric,
        W_ei, W_f, W_eo,
    )  # fmt: skip


def charge_constants(i: IntakeSide, x: OperatingPoint, m: Magnitudes, s: Signals, c: Constants) -> Constants:
    """The constants as the cylinder sees them: T_im [K] and eta_sc [-] under effects and signals."""
    return with_charge(c, i.T_im, relative(at_eta_sc(c.eta_sc, x, i.W_ei, i.W_f, m, c), s.T_e))


def exhaust_side(
    i: IntakeSide, x: OperatingPoint, gas: Gas, m: Magnitudes, s: Signals, c: Constants
) -> Quantities:
    """Cylinder, exhaust manifold, turbine and balances behind `intake_side`; x: `driven`."""
    charge = charge_constants(i, x, m, s, c)
    sweep = cylinder_sweep(exhaust_to_intake_ratio(x.p_em, x.p_im), i.W_ei, i.W_f, x.x_r, x.T_1, charge)
    static = exhaust_manifold_temperature(sweep.T_e, i.W_eo, c)
    static = relative(at_T_em(static, x, sweep.T_e, i.W_eo, i.W_f, m, c), s.T_em)
    T_em = stored(static, gas)
    W_egr = egr_flow(i.A_egr, x.p_em, i.Psi_egr, T_em, c)

    p_es = outlet_pressure(x, T_em, m, s, c)
    Pi_t = turbine_pressure_ratio(x.p_em, with_ambient_pressure(c, p_es))
    turbine_opening = F_vgt_Pi_t(x.u_vgt, Pi_t, c)
    W_t = relative(at_W_t(turbine_flow(turbine_opening, x.p_em, T_em, c), x, Pi_t, T_em, m, c), s.W_t)
    turbine_efficiency = relative(at_eta_tm(eta_tm(x.omega_t, T_em, Pi_t, c), x, W_t, Pi_t, m, c), s.eta_tm)
    P_t_eta_m = turbine_power(turbine_efficiency, W_t, T_em, Pi_t, c)

    W_leak_im = 0.0 - at_intake_balance(0.0, x, i.T_im, m, c)
    W_leak_em = 0.0 - at_exhaust_balance(0.0, x, T_em, m, c)
    P_f = 0.0 - at_shaft_power(0.0, x, m, c)
    return Quantities(
        i.eta_vol, i.W_ei, i.W_f, i.W_eo, sweep.T_e, T_em, sweep.x_r, sweep.T_1, i.f_egr, W_egr, Pi_t, turbine_opening,
        W_t, turbine_efficiency, P_t_eta_m, i.Pi_c, i.Phi_c, i.W_c, i.eta_c, i.P_c,
        intake_pressure_rate(added(i.W_c - W_leak_im, s.intake_balance), W_egr, i.W_ei, charge),
        exhaust_pressure_rate(added(i.W_eo - W_leak_em, s.exhaust_balance), W_t, W_egr, T_em, c),
        turbo_speed_rate(added(P_t_eta_m - P_f, s.shaft_power), i.P_c, x.omega_t, c),
        static, p_es, i.p_bc, i.T_im, i.T_c, W_leak_im, W_leak_em, P_f,
    )  # fmt: skip


def map_arguments(
    p_im: Array, p_em: Array, omega_t: Array, p_bc: Array, p_es: Array, T_em: Array, c: Constants
) -> MapArguments:
    """Where the maps of compressor and turbine are looked up, with p_bc [Pa] before the one and p_es [Pa] behind the
    other: what restricts the flow there moves them; T_em [K] decides how fast the gas is before the wheel."""
    Pi_c = compressor_pressure_ratio(p_im, with_ambient_pressure(c, p_bc))
    Pi_t = turbine_pressure_ratio(p_em, with_ambient_pressure(c, p_es))
    return MapArguments(
        Pi_t, Pi_c, energy_transfer_coefficient(c.T_amb, Pi_c, omega_t, c), blade_speed_ratio(omega_t, T_em, Pi_t, c),
        corrected_speed(omega_t, c),
    )  # fmt: skip


def driver_quantities(q: Quantities, n_e: Array, p_im: Array, p_em: Array, c: Constants) -> DriverQuantities:
    """What a driver or a calibrator reads off; the torque is that of the mass that is really injected."""
    u_injected = q.W_f / fuel_flow(1.0, n_e, c)
    return DriverQuantities(
        air_fuel_ratio(q.W_c, q.W_f, c), egr_fraction(q.W_c, q.W_egr), torque(u_injected, n_e, p_im, p_em, c)
    )


def quantities_extended(x: OperatingPoint, gas: Gas, m: Magnitudes, s: Signals, c: Constants) -> Quantities:
    """All algebraic quantities of the model under effects and signals at given states and inputs.

    Args:
        x: states and inputs.
        gas: gas in the exhaust manifold.
        m: magnitudes of the effects; s: signals at the insertion points.
        c: constants.

    `x_r_next`, `T_1_next` (and T_em for `gas.T`, without thermal inertia) are fixed points as in `quantities`. As
    written here the effects change nothing; `bind` puts their laws in.
    """
    x = driven(x, m, s, c)
    return exhaust_side(intake_side(x, gas, m, s, c), x, gas, m, s, c)


def quantities(
    p_im: Array, p_em: Array, omega_t: Array, x_r: Array, T_1: Array,
    n_e: Array, u_delta: Array, u_egr: Array, u_vgt: Array, c: Constants,
) -> Quantities:  # fmt: skip
    """All algebraic quantities of the published model at given states and inputs; no fixed point is solved inside.

    Args:
        p_im, p_em: manifold pressures [Pa]; omega_t: turbo speed [rad/s].
        x_r: residual gas fraction [-]; T_1: temperature at intake valve closing [K].
        n_e: engine speed [rpm]; u_delta: injected mass [mg/cycle].
        u_egr, u_vgt: actuator positions u~_egr, u~_vgt behind dead time and lags [%].
        c: constants.

    All arguments broadcast against each other. `x_r_next` is the right-hand side of A.10, `T_1_next` that of A.9 with
    `x_r_next` in it, as the simulator sweeps: the fixed point is where they equal x_r and T_1. Away from it A.9 with
    x_r itself is another value (`physics_residuals`).
    """
    x = OperatingPoint(p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, u_egr, u_vgt)
    return quantities_extended(x, Gas(T_1, 1.0, 0.0), 0.0, NO_SIGNALS, c)  # of the gas no temperature is asked for


NO_SIGNALS = Signals(*([0.0] * len(Signals._fields)))
