"""Friction in the turbocharger's bearings."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def bearing_friction(power: Array, c_f: Array, omega_t: Array) -> Array:
    """Further power on the shaft [W] with friction of c_f [N m s]."""
    return power - c_f * omega_t * omega_t


EFFECT = Effect(
    name="bearing_friction",
    site="shaft_power",
    enters=Entry("quantity", "shaft_power"),
    change=bearing_friction,
    law="P_f = c omega_t^2",
    symbol="c",
    unit="N m s",
    tolerance=1.6e-6,
    limits=(0.0, 5e-5),
    confused_with=("exhaust_leak", "turbine_efficiency_loss", "compressor_efficiency_loss"),
    curve=Curve("omega_t", "W", sign=-1.0),
    phrase="bearing friction of the turbocharger of {m}",
    source="Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), sec. 8.5",
)
