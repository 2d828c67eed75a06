"""The effects that the published model leaves out, as one family: site, law, magnitude, unit, range.

What is a term of the right-hand side is in `effect_laws` and `extended_model`; effects on the actuators' commands are
in `actuator_effects`, on readings in `sensor_effects`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

SITES = (
    "intake_mass_balance", "exhaust_mass_balance", "cylinder_flow", "compressor_flow", "compressor_power",
    "turbine_flow", "turbine_power", "shaft_power", "cylinder_out_temperature", "exhaust_temperature",
    "intake_temperature", "egr_flow", "egr_actuator", "vgt_actuator", "fuel_injection",
    "sensor:p_im_pa", "sensor:p_em_pa", "sensor:omega_t_rad_s", "sensor:w_egr_kg_s", "sensor:t_em_k",
    "sensor:w_c_kg_s",
)  # fmt: skip
"""Where the twin and the engine may differ."""

STATE_EFFECTS = (
    "boost_leak", "exhaust_leak", "back_pressure", "air_filter_restriction", "charge_cooler_loss", "egr_heating",
    "bearing_friction", "exhaust_thermal_inertia", "egr_valve_leak", "egr_clogging", "vgt_offset", "injector_drift",
    "compressor_efficiency_loss", "turbine_efficiency_loss", "compressor_flow_loss", "volumetric_efficiency_residual",
    "blow_by",
)  # fmt: skip
"""Effects inside the right-hand side, in the order of `extended.Extension.magnitudes`."""

POINTS = (
    "eta_vol", "W_eo", "T_e", "T_em", "f_egr", "W_t", "eta_tm", "p_es", "W_c", "eta_c", "p_bc", "T_im",
    "intake_balance", "exhaust_balance", "shaft_power", "u_delta", "u_egr", "u_vgt", "egr_opening",
)  # fmt: skip
"""Insertion points of the model graph, in the order of `extended.Extension.signals`."""

ADDED_AT = {
    "intake_balance": "kg/s", "exhaust_balance": "kg/s", "shaft_power": "W", "u_egr": "%", "u_vgt": "%",
    "egr_opening": "-",
}  # fmt: skip
"""Points where a signal is added, with its unit; at the others the quantity is multiplied by (1 + signal)."""

ACTUATOR_EFFECTS = ("egr_backlash", "vgt_backlash", "egr_dead_time", "vgt_dead_time")
"""Effects between the command and the actuator."""

Kind = Literal["physics", "actuator", "input", "sensor"]

_NODES = "Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), "
_WE = "Wahlstrom & Eriksson, Proc. IMechE D 225 (2011), "


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: as in terms, tables and on the command line.
        site: one of `SITES`.
        law: formula in words and symbols.
        symbol: of the magnitude; unit: of the magnitude ("-" where dimensionless).
        tolerance: smallest magnitude of interest [unit].
        limits: physically possible magnitudes [unit]; a lower limit of 0 is a one-sided effect.
        sizes: magnitudes for first differences [unit]: one for a smooth effect, several where it isn't.
        smooth: the response is differentiable at 0.
        kind: "physics", "actuator", "input", or "sensor" (changes readings alone).
        confused_with: effects that look alike once the health parameters are fitted.
        source: where the law comes from.
    """

    name: str
    site: str
    law: str
    symbol: str
    unit: str
    tolerance: float
    limits: tuple[float, float]
    sizes: tuple[float, ...]
    smooth: bool = True
    kind: Kind = "physics"
    confused_with: tuple[str, ...] = ()
    source: str = ""


def _physics(
    name: str, site: str, law: str, symbol: str, unit: str, tolerance: float, high: float,
    confused_with: tuple[str, ...] = (), source: str = "", low: float = 0.0, kind: Kind = "physics",
) -> Effect:  # fmt: skip
    return Effect(
        name, site, law, symbol, unit, tolerance, (low, high), (tolerance,), True, kind, confused_with, source
    )


def _abrupt(
    name: str, site: str, law: str, symbol: str, unit: str, tolerance: float, high: float, sizes: tuple[float, ...],
    kind: Kind, confused_with: tuple[str, ...] = (), source: str = "",
) -> Effect:  # fmt: skip
    return Effect(name, site, law, symbol, unit, tolerance, (0.0, high), sizes, False, kind, confused_with, source)


def _sensor(name: str, column: str, law: str, symbol: str, unit: str, tolerance: float, high: float) -> Effect:
    return Effect(
        name, f"sensor:{column}", law, symbol, unit, tolerance, (-high, high), (tolerance,), True, "sensor", (),
        "offset and gain errors of data sheets",
    )  # fmt: skip


_CATALOGUE = (
    _physics("boost_leak", "intake_mass_balance", "W_leak = A p_im/sqrt(R_a T_im) Psi(p_amb/p_im)", "A", "m2", 4e-6,
             2e-4, ("compressor_efficiency_loss", "compressor_flow_loss"), "isentropic nozzle, Heywood (1988), App. C"),
    _physics("exhaust_leak", "exhaust_mass_balance", "W_leak = A p_em/sqrt(R_e T_em) Psi(p_amb/p_em)", "A", "m2", 5e-6,
             2e-4, ("bearing_friction", "blow_by", "turbine_efficiency_loss"),
             "isentropic nozzle, Heywood (1988), App. C"),
    _physics("back_pressure", "turbine_flow", "p_es = p_amb + k W_t^2 T_em/700 K", "k", "Pa/(kg/s)^2", 2e4, 5e5,
             ("turbine_efficiency_loss", "bearing_friction"), _NODES + "sec. 7.2"),
    _physics("air_filter_restriction", "compressor_flow", "p_bc = p_amb - k W_c^2", "k", "Pa/(kg/s)^2", 1.5e4, 2e5,
             ("compressor_efficiency_loss", "compressor_flow_loss"), _NODES + "sec. 7.2"),
    _physics("charge_cooler_loss", "intake_temperature", "T_im + k (T_c - T_amb)", "k", "-", 0.05, 0.8,
             ("egr_heating", "volumetric_efficiency_residual"), _NODES + "sec. 7.5"),
    _physics("egr_heating", "intake_temperature", "T_im + f (T_em - T_im) W_egr/(W_c + W_egr)", "f", "-", 0.05, 1.0,
             ("volumetric_efficiency_residual", "charge_cooler_loss"), "mixing of two flows; " + _NODES + "sec. 7.5"),
    _physics("bearing_friction", "shaft_power", "P_f = c omega_t^2", "c", "N m s", 1.6e-6, 5e-5,
             ("exhaust_leak", "turbine_efficiency_loss", "compressor_efficiency_loss"), _NODES + "sec. 8.5"),
    _abrupt("exhaust_thermal_inertia", "exhaust_temperature", "tau dT_em/dt = T_em(static) - T_em", "tau", "s", 0.1,
            90.0, (0.08, 0.4, 2.0), "physics", ("thermocouple_lag",), "heat stored in the manifold's wall"),
    _physics("egr_valve_leak", "egr_flow", "f_egr + f_0", "f_0", "-", 0.01, 0.3, ("egr_clogging", "w_egr_gain"),
             _WE + "Eq. 36 with a leak of the shut valve"),
    _physics("egr_clogging", "egr_flow", "A_egrmax (1 - k t)", "k", "1/s", 5e-5, 1e-3, ("egr_valve_leak",),
             "soot deposits over time; t from the recording's start"),
    _physics("vgt_offset", "vgt_actuator", "u_vgt + b", "b", "%", 0.5, 15.0, ("injector_drift",),
             "zero of the position sensor", low=-15.0, kind="actuator"),
    _physics("injector_drift", "fuel_injection", "u_delta (1 + k)", "k", "-", 0.01, 0.3, ("vgt_offset",),
             "wear of the injectors; hardly separable from eta_sc", low=-0.3, kind="input"),
    _physics("compressor_efficiency_loss", "compressor_power", "eta_c (1 - k)", "k", "-", 0.01, 0.4,
             ("turbine_efficiency_loss", "boost_leak"),
             "fouling; an equivalence pair with turbine_efficiency_loss"),
    _physics("turbine_efficiency_loss", "turbine_power", "eta_tm (1 - k)", "k", "-", 0.01, 0.4,
             ("compressor_efficiency_loss", "bearing_friction"),
             "erosion; an equivalence pair with compressor_efficiency_loss"),
    _physics("compressor_flow_loss", "compressor_flow", "W_c (1 - k)", "k", "-", 0.01, 0.4,
             ("boost_leak", "air_filter_restriction"), "fouling narrows the impeller"),
    _physics("volumetric_efficiency_residual", "cylinder_flow", "eta_vol (1 - k (p_em/p_im - 1))", "k", "-", 0.1, 2.0,
             ("egr_heating", "charge_cooler_loss"), "residual gas expands into the intake, Heywood (1988), sec. 6.2",
             low=-1.0),
    _physics("blow_by", "exhaust_mass_balance", "W_eo = W_ei (1 - k) + W_f", "k", "-", 0.01, 0.3,
             ("exhaust_leak",), "worn piston rings"),
    _abrupt("egr_backlash", "egr_actuator", "play of full width w on the command", "w", "%", 1.5, 20.0,
            (1.0, 4.0, 10.0), "actuator", ("egr_dead_time",), "play operator, Visintin (1994)"),
    _abrupt("vgt_backlash", "vgt_actuator", "play of full width w on the command", "w", "%", 1.0, 20.0,
            (1.0, 4.0, 10.0), "actuator", ("vgt_dead_time",), "play operator, Visintin (1994)"),
    _abrupt("egr_dead_time", "egr_actuator", "dead time + d", "d", "s", 0.05, 1.0, (0.05, 0.2), "actuator",
            ("egr_backlash",), _WE + "Eq. 39"),
    _abrupt("vgt_dead_time", "vgt_actuator", "dead time + d", "d", "s", 0.05, 1.0, (0.05, 0.2), "actuator",
            ("vgt_backlash",), _WE + "Eq. 53"),
    _abrupt("thermocouple_lag", "sensor:t_em_k", "tau dT/dt = T_em - T, of the reading alone", "tau", "s", 0.2, 10.0,
            (0.2, 0.5, 2.0), "sensor", ("exhaust_thermal_inertia",), "first-order lag of a sheathed thermocouple"),
    _sensor("p_im_offset", "p_im_pa", "reading + b", "b", "Pa", 1000.0, 3e4),
    _sensor("p_em_offset", "p_em_pa", "reading + b", "b", "Pa", 1500.0, 4e4),
    _sensor("p_em_gain", "p_em_pa", "reading (1 + g)", "g", "-", 0.01, 0.3),
    _sensor("w_egr_gain", "w_egr_kg_s", "reading (1 + g)", "g", "-", 0.01, 0.3),
    _sensor("w_c_gain", "w_c_kg_s", "reading (1 + g)", "g", "-", 0.01, 0.3),
    _sensor("t_em_gain", "t_em_k", "reading (1 + g)", "g", "-", 0.01, 0.3),
)  # fmt: skip

EFFECTS: dict[str, Effect] = {effect.name: effect for effect in _CATALOGUE}
"""The catalogue by name."""
