"""What goes into and comes out of the model's equations: operating point, gas, signals, all algebraic quantities."""

from __future__ import annotations

from typing import NamedTuple

from dieseltwin.engine.array_namespace import Array

POINTS = (
    "eta_vol", "W_eo", "T_e", "T_em", "f_egr", "W_t", "eta_tm", "p_es", "W_c", "eta_c", "p_bc", "T_im",
    "intake_balance", "exhaust_balance", "shaft_power", "u_delta", "u_egr", "u_vgt", "egr_opening",
)  # fmt: skip
"""Insertion points of the model graph, where a signal may enter; in the order of `Signals`."""

ADDED_AT = {
    "intake_balance": "kg/s", "exhaust_balance": "kg/s", "shaft_power": "W", "u_egr": "%", "u_vgt": "%",
    "egr_opening": "-",
}  # fmt: skip
"""Points where a signal is added, with its unit; at the others the quantity is multiplied by (1 + signal)."""


class OperatingPoint(NamedTuple):
    """States and inputs at a moment.

    p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K], n_e [rpm], u_delta [mg/cycle], u_egr, u_vgt: actuator positions
    u~_egr, u~_vgt behind dead time and lags [%].
    """

    p_im: Array
    p_em: Array
    omega_t: Array
    x_r: Array
    T_1: Array
    n_e: Array
    u_delta: Array
    u_egr: Array
    u_vgt: Array


class Charge(NamedTuple):
    """What decides the charge's temperature: eta_vol [-], compressor flow W_c and EGR flow W_egr [kg/s], temperature
    behind the compressor T_c and of the recirculated gas T_em [K]."""

    eta_vol: Array
    W_c: Array
    W_egr: Array
    T_c: Array
    T_em: Array


class Signals(NamedTuple):
    """Signals at the insertion points: relative on maps, flows, temperatures, pressures and u_delta, added elsewhere.

    Added are intake_balance, exhaust_balance [kg/s into the manifold], shaft_power [W], u_egr, u_vgt [% of position],
    egr_opening [-, share of the largest area, beside f_egr].
    """

    eta_vol: Array
    W_eo: Array
    T_e: Array
    T_em: Array
    f_egr: Array
    W_t: Array
    eta_tm: Array
    p_es: Array
    W_c: Array
    eta_c: Array
    p_bc: Array
    T_im: Array
    intake_balance: Array
    exhaust_balance: Array
    shaft_power: Array
    u_delta: Array
    u_egr: Array
    u_vgt: Array
    egr_opening: Array


class Gas(NamedTuple):
    """Gas in the exhaust manifold: T [K] that heats the EGR (start of a fixed point), and T_em = gain T_static + carry.

    Without thermal inertia gain is 1 and carry 0. With it, gain 0 and carry the lagged temperature; or both from the
    lag's exact solution over part of a step.
    """

    T: Array
    gain: Array
    carry: Array


class Sweep(NamedTuple):
    """One sweep of the cylinder's fixed point: residual gas fraction [-] and temperatures [K]."""

    x_r: Array
    T_1: Array
    T_e: Array


class IntakeSide(NamedTuple):
    """What is known before the cylinder: compressor, charge temperature, flows (units as in `Quantities`)."""

    p_bc: Array
    Pi_c: Array
    Phi_c: Array
    W_c: Array
    eta_c: Array
    P_c: Array
    T_c: Array
    T_im: Array
    f_egr: Array
    A_egr: Array
    Psi_egr: Array
    eta_vol: Array
    W_ei: Array
    W_f: Array
    W_eo: Array


class Quantities(NamedTuple):
    """All algebraic quantities of the model, SI units; rates dp_im, dp_em [Pa/s], domega_t [rad/s2]."""

    eta_vol: Array
    W_ei: Array
    W_f: Array
    W_eo: Array
    T_e: Array
    T_em: Array
    x_r_next: Array
    T_1_next: Array
    f_egr: Array
    W_egr: Array
    Pi_t: Array
    F_vgt_Pi_t: Array
    W_t: Array
    eta_tm: Array
    P_t_eta_m: Array
    Pi_c: Array
    Phi_c: Array
    W_c: Array
    eta_c: Array
    P_c: Array
    dp_im: Array
    dp_em: Array
    domega_t: Array
    T_em_static: Array
    p_es: Array
    p_bc: Array
    T_im: Array
    T_c: Array
    W_leak_im: Array
    W_leak_em: Array
    P_f: Array


class MapArguments(NamedTuple):
    """What the maps of compressor and turbine are looked up at, besides states and inputs: pressure quotients Pi_t and
    Pi_c, energy transfer coefficient Psi_c, blade speed ratio BSR [-], corrected speed of the compressor omega_c
    [rad/s]."""

    Pi_t: Array
    Pi_c: Array
    Psi_c: Array
    BSR: Array
    omega_c: Array


class DriverQuantities(NamedTuple):
    """What a driver or a calibrator reads off: air/fuel ratio lambda [-], EGR fraction [-], torque [N m]."""

    air_fuel_ratio: Array
    egr_fraction: Array
    torque: Array
