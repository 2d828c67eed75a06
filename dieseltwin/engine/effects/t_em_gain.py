"""A gain error of the T_em reading."""

from __future__ import annotations

from dieseltwin.engine.effect import Curve, Effect, Entry

EFFECT = Effect(
    name="t_em_gain",
    site="sensor:t_em_k",
    enters=Entry("reading", "t_em_k", "gain"),
    law="reading (1 + g)",
    symbol="g",
    unit="-",
    tolerance=0.01,
    limits=(-0.3, 0.3),
    kind="sensor",
    curve=Curve("T_em"),
    phrase="a gain error of the T_em reading of {m}",
    source="offset and gain errors of data sheets",
)
