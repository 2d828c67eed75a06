"""A zero of the EGR position sensor that has moved: the valve is more open or shut than it is told."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def egr_offset(u_egr: Array, b: Array) -> Array:
    """Position of the EGR valve u~_egr [%] that is off by b [%]."""
    return u_egr + b


EFFECT = Effect(
    name="egr_offset",
    site="egr_actuator",
    enters=Entry("quantity", "u_egr"),
    change=egr_offset,
    law="u_egr + b",
    symbol="b",
    unit="%",
    tolerance=1.0,
    limits=(-20.0, 20.0),
    kind="actuator",
    confused_with=("egr_valve_leak", "w_egr_gain"),
    curve=Curve("u_egr"),
    phrase="an offset of the EGR position of {m}",
    source="zero of the position sensor; as vgt_offset",
)
