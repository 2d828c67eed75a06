"""A gain error of the W_egr reading."""

from __future__ import annotations

from dieseltwin.engine.effect import Curve, Effect, Entry

EFFECT = Effect(
    name="w_egr_gain",
    site="sensor:w_egr_kg_s",
    enters=Entry("reading", "w_egr_kg_s", "gain"),
    law="reading (1 + g)",
    symbol="g",
    unit="-",
    tolerance=0.01,
    limits=(-0.3, 0.3),
    kind="sensor",
    curve=Curve("W_egr"),
    phrase="a gain error of the W_egr reading of {m}",
    source="offset and gain errors of data sheets",
)
