"""Play in the linkage of the VGT actuator."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="vgt_backlash",
    site="vgt_actuator",
    enters=Entry("command", "vgt", "play"),
    law="play of full width w on the command",
    symbol="w",
    unit="%",
    tolerance=1.0,
    limits=(0.0, 20.0),
    sizes=(1.0, 4.0, 10.0),
    smooth=False,
    kind="actuator",
    confused_with=("vgt_dead_time",),
    phrase="a play of {m} in the VGT actuator",
    source="play operator, Visintin (1994)",
)
