"""Play in the linkage of the EGR actuator."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="egr_backlash",
    site="egr_actuator",
    enters=Entry("command", "egr", "play"),
    law="play of full width w on the command",
    symbol="w",
    unit="%",
    tolerance=1.5,
    limits=(0.0, 20.0),
    sizes=(1.0, 4.0, 10.0),
    smooth=False,
    kind="actuator",
    confused_with=("egr_dead_time",),
    phrase="a play of {m} in the EGR actuator",
    source="play operator, Visintin (1994)",
)
