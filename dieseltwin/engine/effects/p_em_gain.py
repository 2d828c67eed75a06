"""A gain error of the p_em reading."""

from __future__ import annotations

from dieseltwin.engine.effect import Curve, Effect, Entry

EFFECT = Effect(
    name="p_em_gain",
    site="sensor:p_em_pa",
    enters=Entry("reading", "p_em_pa", "gain"),
    law="reading (1 + g)",
    symbol="g",
    unit="-",
    tolerance=0.01,
    limits=(-0.3, 0.3),
    kind="sensor",
    curve=Curve("p_em"),
    phrase="a gain error of the p_em reading of {m}",
    source="offset and gain errors of data sheets",
)
