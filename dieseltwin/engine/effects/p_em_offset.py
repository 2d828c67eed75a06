"""An offset of the p_em reading."""

from __future__ import annotations

from dieseltwin.engine.effect import Curve, Effect, Entry

EFFECT = Effect(
    name="p_em_offset",
    site="sensor:p_em_pa",
    enters=Entry("reading", "p_em_pa", "offset"),
    law="reading + b",
    symbol="b",
    unit="Pa",
    tolerance=1500.0,
    limits=(-4e4, 4e4),
    kind="sensor",
    curve=Curve("p_em"),
    phrase="an offset of the p_em reading of {m}",
    source="offset and gain errors of data sheets",
)
