"""Charge that passes worn piston rings and is lost to the exhaust."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def blow_by(W_eo: Array, k: Array, W_ei: Array) -> Array:
    """Flow out of the cylinders W_eo [kg/s] without the share k [-] of what flows in."""
    return W_eo - k * W_ei


EFFECT = Effect(
    name="blow_by",
    site="exhaust_mass_balance",
    enters=Entry("quantity", "W_eo"),
    change=blow_by,
    law="W_eo = W_ei (1 - k) + W_f",
    symbol="k",
    unit="-",
    tolerance=0.01,
    limits=(0.0, 0.3),
    confused_with=("exhaust_leak",),
    curve=Curve("n_e"),
    phrase="blow-by of {m} of the cylinder flow",
    source="worn piston rings",
)
