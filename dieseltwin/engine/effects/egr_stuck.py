"""An EGR valve that stands still, whatever it is told: seized, sooted up, or shut by its spring."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="egr_stuck",
    site="egr_actuator",
    enters=Entry("command", "egr", "stuck"),
    law="u_egr = p",
    symbol="p",
    unit="%",
    tolerance=1.0,
    limits=(0.0, 100.0),
    sizes=(20.0, 50.0, 80.0),
    smooth=False,
    kind="actuator",
    confused_with=("egr_offset", "egr_backlash"),
    phrase="an EGR valve that stands still at {m}",
    source="Isermann, Combustion Engine Diagnosis (2017)",
)
