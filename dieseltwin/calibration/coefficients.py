"""Which coefficients each submodel has, and what is believed of them before the data.

Priors are the base engine's values, flows scaled with the displacement, with wide standard deviations. Where the
balances give a product alone (the two efficiencies of the turbocharger; volumetric efficiency over temperature) the
prior decides, and the result says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dieseltwin.discovery.twins.interface import Hypothesis
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.parameters import ELEMENTS, HEALTH, EngineParameters

FLAP_COEFFICIENTS: Mapping[str, str] = {"flap_m": "m", "flap_q": "q"}
"""Names among the numbers of a calibration -> coefficients of the exhaust flap's law."""


@dataclass(frozen=True)
class Coefficient:
    """One free number of the calibration.

    Attributes:
        name: scalar engine parameter ("c_vol1") or parameter of a term ("flap_m").
        submodel: row of the relations that it belongs to first.
        mean, std: what is believed before the data [unit].
        low, high: bounds [unit].
        unit: unit.
        source: where the belief comes from.
    """

    name: str
    submodel: str
    mean: float
    std: float
    low: float
    high: float
    unit: str = "-"
    source: str = "base engine"


# name: (submodel, standard deviation, lowest, highest, unit); deviations "x" relative to the base value where < 0
_ENGINE: Mapping[str, tuple[str, float, float, float, str]] = {
    "c_vol1": ("cylinder_flow", 3e-4, -3e-3, 3e-3, "1/sqrt(Pa)"),
    "c_vol2": ("cylinder_flow", 4e-3, -0.03, 0.03, "1/sqrt(rpm)"),
    "c_vol3": ("cylinder_flow", 0.3, 0.3, 2.0, "-"),
    "A_vgtmax": ("turbine_flow", -0.5, 1e-5, 1e-2, "m2"),
    "K_t": ("turbine_flow", 0.5, 1.2, 6.0, "-"),
    "c_f2": ("turbine_flow", 0.5, -3.0, 2.0, "-"),
    "c_vgt1": ("turbine_flow", 30.0, 60.0, 300.0, "%"),
    "c_vgt2": ("turbine_flow", 25.0, 75.0, 200.0, "%"),
    "eta_tmmax": ("turbo_power", 0.05, 0.4, 0.95, "-"),
    "BSR_opt": ("turbo_power", 0.2, 0.3, 1.6, "-"),
    "c_m1": ("turbo_power", 1.0, 0.0, 10.0, "-"),
    "eta_cmax": ("turbo_power", 0.03, 0.5, 0.9, "-"),
    "a_1": ("turbo_power", 3.0, 0.0, 60.0, "s2/kg2"),
    "a_2": ("turbo_power", 1.5, 0.0, 30.0, "-"),
    "a_3": ("turbo_power", 2.0, -30.0, 10.0, "s/kg"),
    "W_copt": ("turbo_power", -0.25, 0.01, 3.0, "kg/s"),
    "pi_copt": ("turbo_power", 0.15, 0.5, 1.8, "-"),
    "c_omega_psi1": ("compressor_flow", 1e-8, -1e-7, 1e-7, "s2/rad2"),
    "c_omega_psi2": ("compressor_flow", 1e-4, -1e-3, 1e-3, "s/rad"),
    "c_omega_psi3": ("compressor_flow", 0.5, -3.0, 5.0, "-"),
    "c_omega_phi1": ("compressor_flow", 4e-7, -5e-6, 5e-6, "s2/rad2"),
    "c_omega_phi2": ("compressor_flow", 6e-3, -0.06, 0.06, "s/rad"),
    "c_omega_phi3": ("compressor_flow", 20.0, 0.0, 200.0, "-"),
    "A_egrmax": ("egr_flow", -0.6, 1e-6, 1e-2, "m2"),
    "Pi_egropt": ("egr_flow", 0.1, 0.3, 0.95, "-"),
    "c_egr1": ("egr_flow", 1e-4, -1e-3, -1e-6, "1/%2"),
    "c_egr3": ("egr_flow", 0.15, -1.0, 1.0, "-"),
    "eta_sc": ("exhaust_temperature", 0.15, 0.4, 2.0, "-"),
    "h_tot": ("exhaust_temperature", 60.0, 0.0, 600.0, "W/(m2 K)"),
    "x_cv": ("exhaust_temperature", 0.2, 0.0, 1.0, "-"),
}
_SCALED = ("A_vgtmax", "W_copt", "A_egrmax")  # with the displacement
_SLOPE = ("a_1", "a_3")  # over the flow: fall with its square, with it


_HD = "heavy-duty practice (stated belief)"

BELIEFS: tuple[Coefficient, ...] = (
    Coefficient("back_pressure", "turbine_flow", 1.1e5, 4e4, 0.0, 2e6, "Pa/(kg/s)^2",
                "10 to 25 kPa at 0.4 kg/s, " + _HD),
    Coefficient("air_filter_restriction", "compressor_flow", 1.8e4, 8e3, 0.0, 8e4, "Pa/(kg/s)^2",
                "2 to 5 kPa at 0.4 kg/s, " + _HD),
    Coefficient("charge_cooler_loss", "cylinder_flow", 0.10, 0.05, 0.0, 0.5, "-", "effectiveness 0.85 to 0.95, " + _HD),
    Coefficient("cooler_approach", "cylinder_flow", 10.0, 7.0, -5.0, 40.0, "K", _HD),
    Coefficient("egr_heating", "cylinder_flow", 0.12, 0.06, 0.0, 0.7, "-",
                "EGR cooler effectiveness 0.8 to 0.95, " + _HD),
    Coefficient("egr_coolant", "cylinder_flow", 360.0, 6.0, 330.0, 390.0, "K", "engine coolant, " + _HD),
    Coefficient("volumetric_efficiency_residual", "cylinder_flow", 0.06, 0.05, -0.3, 0.5, "-",
                "1/(r_c - 1), clearance volume"),
    Coefficient("vol_heating", "cylinder_flow", 0.35, 0.12, 0.0, 0.8, "-",
                "charge heated by the walls: eta_vol ~ T^0.2..0.5"),
    Coefficient("k_cooler_dp", "compressor_flow", 1.0e5, 6e4, 0.0, 5e5, "Pa/(kg/s)^2 at 300 K and 1 bar",
                "5 to 12 kPa at full load, " + _HD),
    Coefficient("work_0", "compressor_work", 1.0, 0.2, 0.4, 2.0, "-", "Euler's work at no flow over R_c^2 omega_t^2"),
    Coefficient("work_slope", "compressor_work", 2.0, 0.7, 0.0, 5.0, "-", "backswept blades, 30 to 40 degrees"),
)
"""What is believed of places that settled points don't see: effects by their names, and what is none of the catalogue.

`imply` fits them beside what was found. Calibration and search fit none of them but the walls' heating where the charge
was read; a law that takes such a place beyond them is refused (`believable`).
"""

_ROW_OF_SITE = {
    "turbine_power": "turbo_power", "compressor_power": "turbo_power", "shaft_power": "turbo_power",
    "intake_mass_balance": "cylinder_flow", "intake_temperature": "cylinder_flow", "vgt_actuator": "turbine_flow",
    "exhaust_mass_balance": "turbine_flow", "fuel_injection": "exhaust_temperature",
}  # fmt: skip
_WIDE = 30.0  # tolerances: prior standard deviation of a found magnitude

FOUND = "found"
"""`Coefficient.source` of what the search added."""


def effect_coefficients(name: str, hypothesis: Hypothesis, flap_spread: float) -> tuple[Coefficient, ...]:
    """Magnitude of an effect as a free number with a wide belief about 0, and the coefficients of its law."""
    low, high = hypothesis.limits
    row = _ROW_OF_SITE.get(hypothesis.site, hypothesis.site)
    found = [Coefficient(name, row, 0.0, _WIDE * hypothesis.tolerance, low, high, hypothesis.unit, FOUND)]
    if name == "exhaust_flap":
        nominal = EFFECTS[name].coefficients
        found += [Coefficient(column, row, nominal[key], flap_spread, -8.0, 20.0, "-", FOUND)
                  for column, key in FLAP_COEFFICIENTS.items()]
    return tuple(found)


WEAR: Mapping[str, str] = {name: f"{name}:since" for name in HEALTH}
"""Health parameter -> name of its relative change since the reference."""

_WEAR_STD, _MOST_WEAR = 0.15, 0.6
_OWN_WEAR_STD = {"eta_sc": 0.04}
"""The cycle wears by few per cent (the benchmark's engines by -4 to +2 %), areas and heat transfer by soot far more."""


def wear_coefficients() -> tuple[Coefficient, ...]:
    """What the health parameters may have changed by since a reference."""
    return tuple(
        Coefficient(wear, _ENGINE[name][0], 0.0, _OWN_WEAR_STD.get(name, _WEAR_STD), -_MOST_WEAR, _MOST_WEAR, "-",
                    "wear")
        for name, wear in WEAR.items()
    )


def worn(engine: EngineParameters, values: Mapping[str, float]) -> EngineParameters:
    """The engine with its health as it is now."""
    return engine.replace(**{name: getattr(engine, name) * (1.0 + values.get(wear, 0.0))
                             for name, wear in WEAR.items()})  # fmt: skip


def engine_coefficients(base: EngineParameters, engine: EngineParameters) -> tuple[Coefficient, ...]:
    """The engine's own coefficients with priors around the base, flows scaled from `base` to `engine` by V_d."""
    ratio = engine.V_d / base.V_d
    found = []
    for name, (row, std, low, high, unit) in _ENGINE.items():
        value = scalar(base, name)
        factor = ratio if name in _SCALED else 1.0
        if name in _SLOPE:
            factor = ratio ** (-2.0 if name == "a_1" else -1.0)
        mean = value * factor
        spread = -std * abs(mean) if std < 0 else std * (factor if name in _SLOPE else 1.0)
        found.append(Coefficient(name, row, mean, spread, low, high, unit))
    return tuple(found)


def scalar(engine: EngineParameters, name: str) -> float:
    """One scalar of an engine by the name of `ELEMENTS` or of the parameter itself."""
    if name in ELEMENTS:
        vector, index = ELEMENTS[name]
        return float(getattr(engine, vector)[index])
    return float(getattr(engine, name))


def with_scalars(engine: EngineParameters, values: Mapping[str, float]) -> EngineParameters:
    """The engine with scalars (vector elements by their names) changed; other names are passed over.

    The straight part of the turbine's curvature (c_mlin) follows c_m1, so that the curve stays continuous.
    """
    changes: dict[str, Any] = {}
    for name, value in values.items():
        if name in ELEMENTS:
            vector, index = ELEMENTS[name]
            current = list(changes.get(vector, getattr(engine, vector)))
            current[index] = float(value)
            changes[vector] = tuple(current)
        elif name in type(engine).model_fields:
            changes[name] = float(value)
    if "c_m" in changes and engine.c_m[0] > 0:
        changes["c_mlin"] = engine.c_mlin * changes["c_m"][0] / engine.c_m[0]
    return engine.replace(**changes) if changes else engine
