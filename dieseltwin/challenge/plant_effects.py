"""What can be left out of the textbook model, as the plant sees it (docs/discovery.md).

The table stands apart from the tool's catalogue `dieseltwin.engine.effects` on purpose; a test compares them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dieseltwin.challenge.driving import Driving
from dieseltwin.errors import InputError

KERNEL_EFFECTS = (
    "boost_leak", "exhaust_leak", "back_pressure", "air_filter_restriction", "charge_cooler_loss", "egr_heating",
    "bearing_friction", "exhaust_thermal_inertia", "egr_valve_leak", "egr_clogging", "vgt_offset", "injector_drift",
    "compressor_efficiency_loss", "turbine_efficiency_loss", "compressor_flow_loss", "volumetric_efficiency_residual",
    "blow_by", "thermocouple_lag", "disc_windage", "port_heating", "afterburning", "intake_heat_pickup",
    "egr_offset",
)  # fmt: skip
"""Effects inside the right-hand side, in the order of the kernel's magnitudes."""


FLAP = "exhaust_flap"
KERNEL_SLOT = {FLAP: "back_pressure"}
"""Families that act in the kernel as another one whose magnitude follows something."""

_FLAP_SHUT = 0.08  # share of the open flap's area that a shut one leaves [-]


@dataclass(frozen=True)
class Family:
    """One family of faults of the plant.

    Attributes:
        name, site, unit: of docs/discovery.md.
        tolerance: smallest size of interest.
        upper: largest size that a case may have.
        signed: both signs occur.
        onset: may begin in the middle of a recording.
        boxes: input columns over which it may be confined, pairs or singles; () for none.
        catalogued: False for families that no catalogue holds.
        equivalents: families with (nearly) the same response: withheld together.
        dealt: belongs to the benchmark's mix. Families that came later don't: the cases of a seed stay what they were.
    """

    name: str
    site: str
    unit: str
    tolerance: float
    upper: float
    signed: bool = False
    onset: bool = True
    boxes: tuple[tuple[str, ...], ...] = ()
    catalogued: bool = True
    equivalents: tuple[str, ...] = ()
    dealt: bool = True


_LOAD = ("n_e_rpm", "u_delta_mg")
_VGT = ("u_vgt_pct",)

FAMILIES: Mapping[str, Family] = {
    family.name: family
    for family in (
        Family("boost_leak", "intake_mass_balance", "m2", 4e-6, 1.1e-4, boxes=(_LOAD,)),
        Family("exhaust_leak", "exhaust_mass_balance", "m2", 5e-6, 1.1e-4, boxes=(_LOAD,)),
        Family("back_pressure", "turbine_flow", "Pa/(kg/s)^2", 2e4, 2.3e5),
        # 1.5-7 kPa at 0.4 kg/s are 0.9e4-4.4e4: three tolerances are the most that a filter does
        Family("air_filter_restriction", "compressor_flow", "Pa/(kg/s)^2", 1.5e4, 4.5e4),
        Family("charge_cooler_loss", "intake_temperature", "-", 0.05, 0.5),
        Family("egr_heating", "intake_temperature", "-", 0.05, 0.5),
        Family("bearing_friction", "shaft_power", "N m s", 1.6e-6, 1.6e-5),
        Family("exhaust_thermal_inertia", "exhaust_temperature", "s", 0.1, 1.0),
        Family("thermocouple_lag", "sensor:t_em_k", "s", 0.2, 2.0),
        Family("egr_backlash", "egr_actuator", "%", 1.5, 15.0),
        Family("vgt_backlash", "vgt_actuator", "%", 1.0, 10.0),
        Family("egr_valve_leak", "egr_flow", "-", 0.01, 0.1),
        Family("egr_clogging", "egr_flow", "1/s", 5e-5, 5e-4, onset=False),
        Family("vgt_offset", "vgt_actuator", "%", 0.5, 5.0, signed=True, boxes=(_VGT,)),
        Family("injector_drift", "fuel_injection", "-", 0.01, 0.1, signed=True, boxes=(_LOAD,)),
        Family("compressor_efficiency_loss", "compressor_power", "-", 0.01, 0.1, boxes=(_LOAD,),
               equivalents=("turbine_efficiency_loss",)),
        Family("turbine_efficiency_loss", "turbine_power", "-", 0.01, 0.1, boxes=(_LOAD, _VGT),
               equivalents=("compressor_efficiency_loss",)),
        Family("compressor_flow_loss", "compressor_flow", "-", 0.01, 0.1, boxes=(_LOAD,)),
        Family("volumetric_efficiency_residual", "cylinder_flow", "-", 0.1, 1.0, boxes=(_LOAD,)),
        Family("blow_by", "exhaust_mass_balance", "-", 0.01, 0.1, boxes=(_LOAD,)),
        Family("p_im_offset", "sensor:p_im_pa", "Pa", 1000.0, 1e4, signed=True),
        Family("p_em_offset", "sensor:p_em_pa", "Pa", 1500.0, 1.5e4, signed=True),
        Family("p_em_gain", "sensor:p_em_pa", "-", 0.01, 0.1, signed=True),
        Family("w_egr_gain", "sensor:w_egr_kg_s", "-", 0.01, 0.1, signed=True),
        Family("w_c_gain", "sensor:w_c_kg_s", "-", 0.01, 0.1, signed=True),
        Family("t_em_gain", "sensor:t_em_k", "-", 0.01, 0.1, signed=True),
        Family("egr_dead_time", "egr_actuator", "s", 0.05, 0.5),
        Family("vgt_dead_time", "vgt_actuator", "s", 0.05, 0.5),
        Family("intake_heat_pickup", "intake_temperature", "W/K", 4.0, 40.0, dealt=False),
        Family("egr_offset", "egr_actuator", "%", 1.0, 10.0, signed=True, dealt=False),
        Family("fuel_lag", "fuel_injection", "s", 0.1, 1.0, dealt=False),
        Family("egr_stuck", "egr_actuator", "%", 1.0, 100.0, dealt=False),
        Family("vgt_stuck", "vgt_actuator", "%", 1.0, 100.0, dealt=False),
        Family(FLAP, "turbine_flow", "Pa/(kg/s)^2", 2e4, 2e5, onset=False, dealt=False),
        # in no catalogue: P_f = k omega_t^3; eta_vol (1 - k (1 - n_e/2000 rpm)); T_em + k q_HV W_f/(c_pe W_eo)
        Family("disc_windage", "shaft_power", "N m s2", 3.2e-10, 3.2e-9, catalogued=False),
        Family("port_heating", "cylinder_flow", "-", 0.03, 0.3, catalogued=False),
        Family("afterburning", "exhaust_temperature", "-", 0.01, 0.1, catalogued=False),
    )
}
"""Every family; the magnitudes' units and signs as in docs/discovery.md."""


@dataclass(frozen=True)
class Fault:
    """One fault of one machine.

    Attributes:
        effect: name of a family.
        magnitude: in the family's unit.
        onset_s: begins so long after the recording's start [s]; None: there all along.
        region: input column -> (low, high) outside which it is absent; None: everywhere.
    """

    effect: str
    magnitude: float
    onset_s: float | None = None
    region: Mapping[str, tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        if self.effect not in FAMILIES:
            raise InputError("fault", repr(self.effect), ", ".join(FAMILIES), "name a family of the plant")

    @property
    def ratio(self) -> float:
        """Magnitude over tolerance [-], without sign."""
        return abs(self.magnitude) / FAMILIES[self.effect].tolerance

    def lasting(self) -> Fault:
        """The same fault there from the start: what a later recording of the same machine shows."""
        return Fault(self.effect, self.magnitude, None, self.region)

    def document(self) -> dict[str, Any]:
        """For the sealed answers."""
        region = None if self.region is None else {name: list(box) for name, box in self.region.items()}
        return {"effect": self.effect, "magnitude": self.magnitude, "onset_s": self.onset_s, "region": region,
                "site": FAMILIES[self.effect].site, "ratio": self.ratio}  # fmt: skip

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Fault:
        """From the sealed answers."""
        region = document.get("region")
        boxes = None if region is None else {name: (float(a), float(b)) for name, (a, b) in region.items()}
        return cls(document["effect"], float(document["magnitude"]), document.get("onset_s"), boxes)


def schedule(fault: Fault, time_s: np.ndarray, driving: Driving) -> np.ndarray:
    """Factor of the magnitude at the given times (n,): 0 before the onset and outside the region; a drift grows."""
    factor = np.ones(time_s.size)
    if fault.effect == FLAP:
        if driving.u_flap_pct is None:
            raise InputError(FLAP, "driving without u_flap_pct", "positions of the flap", "give them")
        factor = (_flap_area(50.0) / _flap_area(np.interp(time_s, driving.time_s, driving.u_flap_pct))) ** 2
    if fault.effect == "egr_clogging":
        factor = np.maximum(time_s - driving.time_s[0], 0.0)
    if fault.onset_s is not None:
        factor = np.where(time_s - driving.time_s[0] >= fault.onset_s, factor, 0.0)
    for column, (low, high) in (fault.region or {}).items():
        values = np.interp(time_s, driving.time_s, getattr(driving, column))
        factor = np.where((values >= low) & (values <= high), factor, 0.0)
    return factor


def _flap_area(position: Any) -> Any:
    """Area of a plate that turns in a pipe over the open one [-], at a position [%]: a restriction goes with 1/A^2."""
    return _FLAP_SHUT + (1.0 - _FLAP_SHUT) * (1.0 - np.cos(0.5 * np.pi * np.asarray(position) / 100.0))
