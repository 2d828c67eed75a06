"""What two healthy days of a petrol engine differ by in the whole: levels of its balances."""

from __future__ import annotations

from dieseltwin.discovery.twins.interface import Parameter
from dieseltwin.petrol.parameters import PetrolParameters

BALANCE_OF = {
    "eta_vol_level": "cylinder", "throttle_area_level": "throttle", "throttle_zero_pct": "throttle",
    "boost_level": "boost", "cooler_level": "cooler",
}  # fmt: skip


def healthy_parameters(engine: PetrolParameters) -> tuple[Parameter, ...]:
    """What two healthy days differ by in the whole."""
    t = engine.tolerances
    stds = {"eta_vol_level": (t.cylinder_level, "-"), "throttle_area_level": (t.throttle_level, "-"),
            "throttle_zero_pct": (t.throttle_zero_pct, "%"), "boost_level": (t.boost_level, "-"),
            "cooler_level": (t.cooler_level, "-")}  # fmt: skip
    return tuple(Parameter(name, 0.0, std, unit, std, bounded=False) for name, (std, unit) in stds.items())
