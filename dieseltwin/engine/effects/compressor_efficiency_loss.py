"""A compressor that is less efficient than its map."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def compressor_efficiency_loss(eta_c: Array, k: Array) -> Array:
    """Compressor efficiency eta_c [-] less the share k [-]."""
    return eta_c * (1.0 - k)


EFFECT = Effect(
    name="compressor_efficiency_loss",
    site="compressor_power",
    enters=Entry("quantity", "eta_c"),
    change=compressor_efficiency_loss,
    law="eta_c (1 - k)",
    symbol="k",
    unit="-",
    tolerance=0.01,
    limits=(0.0, 0.4),
    confused_with=("turbine_efficiency_loss", "boost_leak"),
    curve=Curve("W_c"),
    phrase="a loss of compressor efficiency of {m}",
    source="fouling; an equivalence pair with turbine_efficiency_loss",
)
