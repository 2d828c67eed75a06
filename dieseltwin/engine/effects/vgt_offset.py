"""A zero of the VGT position sensor that has moved: the turbine is more open or shut than it is told."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def vgt_offset(u_vgt: Array, b: Array) -> Array:
    """Position of the VGT u~_vgt [%] that is off by b [%]."""
    return u_vgt + b


EFFECT = Effect(
    name="vgt_offset",
    site="vgt_actuator",
    enters=Entry("quantity", "u_vgt"),
    change=vgt_offset,
    law="u_vgt + b",
    symbol="b",
    unit="%",
    tolerance=0.5,
    limits=(-15.0, 15.0),
    kind="actuator",
    confused_with=("injector_drift",),
    curve=Curve("u_vgt"),
    phrase="an offset of the VGT position of {m}",
    source="zero of the position sensor",
)
