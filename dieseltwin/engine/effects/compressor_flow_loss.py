"""A compressor that delivers less than its map."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def compressor_flow_loss(W_c: Array, k: Array) -> Array:
    """Compressor flow W_c [kg/s] less the share k [-]."""
    return W_c * (1.0 - k)


EFFECT = Effect(
    name="compressor_flow_loss",
    site="compressor_flow",
    enters=Entry("quantity", "W_c"),
    change=compressor_flow_loss,
    law="W_c (1 - k)",
    symbol="k",
    unit="-",
    tolerance=0.01,
    limits=(0.0, 0.4),
    confused_with=("boost_leak", "air_filter_restriction"),
    curve=Curve("p_im/p_amb"),
    phrase="a loss of compressor flow of {m}",
    source="fouling narrows the impeller",
)
