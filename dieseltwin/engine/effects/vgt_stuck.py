"""Guide vanes of the turbine that stand still, whatever they are told: seized, or without a drive."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="vgt_stuck",
    site="vgt_actuator",
    enters=Entry("command", "vgt", "stuck"),
    law="u_vgt = p",
    symbol="p",
    unit="%",
    tolerance=1.0,
    limits=(0.0, 100.0),
    sizes=(20.0, 50.0, 80.0),
    smooth=False,
    kind="actuator",
    confused_with=("vgt_offset", "vgt_backlash"),
    phrase="guide vanes (VGT) that stand still at {m}",
    source="Isermann, Combustion Engine Diagnosis (2017)",
)
