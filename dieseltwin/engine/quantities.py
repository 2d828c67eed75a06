"""What goes into and comes out of the model's equations: operating point, gas, signals, all algebraic quantities."""

from __future__ import annotations

from typing import Any, NamedTuple

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

    p_im: Any
    p_em: Any
    omega_t: Any
    x_r: Any
    T_1: Any
    n_e: Any
    u_delta: Any
    u_egr: Any
    u_vgt: Any


class Charge(NamedTuple):
    """What decides the charge's temperature: eta_vol [-], compressor flow W_c and EGR flow W_egr [kg/s], temperature
    behind the compressor T_c and of the recirculated gas T_em [K]."""

    eta_vol: Any
    W_c: Any
    W_egr: Any
    T_c: Any
    T_em: Any


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


class Sweep(NamedTuple):
    """One sweep of the cylinder's fixed point: residual gas fraction [-] and temperatures [K]."""

    x_r: Any
    T_1: Any
    T_e: Any


class IntakeSide(NamedTuple):
    """What is known before the cylinder: compressor, charge temperature, flows (units as in `Quantities`)."""

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
    T_em_static: Any
    p_es: Any
    p_bc: Any
    T_im: Any
    T_c: Any
    W_leak_im: Any
    W_leak_em: Any
    P_f: Any


class MapArguments(NamedTuple):
    """What the maps of compressor and turbine are looked up at, besides states and inputs: pressure quotients Pi_t and
    Pi_c, energy transfer coefficient Psi_c, blade speed ratio BSR [-]."""

    Pi_t: Any
    Pi_c: Any
    Psi_c: Any
    BSR: Any


class DriverQuantities(NamedTuple):
    """What a driver or a calibrator reads off: air/fuel ratio lambda [-], EGR fraction [-], torque [N m]."""

    air_fuel_ratio: Any
    egr_fraction: Any
    torque: Any
