"""Injectors that inject more or less than they are told."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def injector_drift(u_delta: Array, k: Array) -> Array:
    """Injected mass u_delta [mg/cycle] that is off by the share k [-]."""
    return u_delta * (1.0 + k)


EFFECT = Effect(
    name="injector_drift",
    site="fuel_injection",
    enters=Entry("quantity", "u_delta"),
    change=injector_drift,
    law="u_delta (1 + k)",
    symbol="k",
    unit="-",
    tolerance=0.01,
    limits=(-0.3, 0.3),
    kind="input",
    confused_with=("vgt_offset",),
    curve=Curve("u_delta"),
    phrase="a drift of the injected mass of {m}",
    source="wear of the injectors; hardly separable from eta_sc",
)
