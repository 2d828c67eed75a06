"""A turbine that is less efficient than its map."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def turbine_efficiency_loss(eta_tm: Array, k: Array) -> Array:
    """Turbine efficiency eta_tm [-] less the share k [-]."""
    return eta_tm * (1.0 - k)


EFFECT = Effect(
    name="turbine_efficiency_loss",
    site="turbine_power",
    enters=Entry("quantity", "eta_tm"),
    change=turbine_efficiency_loss,
    law="eta_tm (1 - k)",
    symbol="k",
    unit="-",
    tolerance=0.01,
    limits=(0.0, 0.4),
    confused_with=("compressor_efficiency_loss", "bearing_friction"),
    curve=Curve("W_t"),
    phrase="a loss of turbine efficiency of {m}",
    source="erosion; an equivalence pair with compressor_efficiency_loss",
)
