"""A charge cooler that is not as effective as the model takes it to be."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def charge_cooler_loss(T_im: Array, k: Array, T_c: Array, T_amb: Array) -> Array:
    """T_im [K] behind a cooler of effectiveness 1 - k [-] and a compressor at T_c [K]."""
    return T_im + k * (T_c - T_amb)


EFFECT = Effect(
    name="charge_cooler_loss",
    site="intake_temperature",
    enters=Entry("quantity", "T_im"),
    change=charge_cooler_loss,
    law="T_im + k (T_c - T_amb)",
    symbol="k",
    unit="-",
    tolerance=0.05,
    limits=(0.0, 0.8),
    confused_with=("egr_heating", "volumetric_efficiency_residual"),
    curve=Curve("T_c", "K"),
    phrase="a charge cooler that misses its full effectiveness by {m}",
    source="Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), sec. 7.5",
)
