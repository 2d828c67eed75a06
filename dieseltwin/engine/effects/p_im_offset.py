"""An offset of the p_im reading."""

from __future__ import annotations

from dieseltwin.engine.effect import Curve, Effect, Entry

EFFECT = Effect(
    name="p_im_offset",
    site="sensor:p_im_pa",
    enters=Entry("reading", "p_im_pa", "offset"),
    law="reading + b",
    symbol="b",
    unit="Pa",
    tolerance=1000.0,
    limits=(-3e4, 3e4),
    kind="sensor",
    curve=Curve("p_im"),
    phrase="an offset of the p_im reading of {m}",
    source="offset and gain errors of data sheets",
)
