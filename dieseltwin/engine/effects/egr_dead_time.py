"""EGR actuator that answers later than the model takes it to."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="egr_dead_time",
    site="egr_actuator",
    enters=Entry("command", "egr", "dead_time"),
    law="dead time + d",
    symbol="d",
    unit="s",
    tolerance=0.05,
    limits=(0.0, 1.0),
    sizes=(0.05, 0.2),
    smooth=False,
    kind="actuator",
    confused_with=("egr_backlash",),
    phrase="a dead time of the EGR actuator longer by {m}",
    source="Wahlstrom & Eriksson, Proc. IMechE D 225 (2011), Eq. 39",
)
