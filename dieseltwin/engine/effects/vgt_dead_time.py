"""VGT actuator that answers later than the model takes it to."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="vgt_dead_time",
    site="vgt_actuator",
    enters=Entry("command", "vgt", "dead_time"),
    law="dead time + d",
    symbol="d",
    unit="s",
    tolerance=0.05,
    limits=(0.0, 1.0),
    sizes=(0.05, 0.2),
    smooth=False,
    kind="actuator",
    confused_with=("vgt_backlash",),
    phrase="a dead time of the VGT actuator longer by {m}",
    source="Wahlstrom & Eriksson, Proc. IMechE D 225 (2011), Eq. 53",
)
