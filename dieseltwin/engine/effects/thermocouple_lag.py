"""A sheathed thermocouple that follows the gas temperature with a lag."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="thermocouple_lag",
    site="sensor:t_em_k",
    enters=Entry("reading", "t_em_k", "lag"),
    law="tau dT/dt = T_em - T, of the reading alone",
    symbol="tau",
    unit="s",
    tolerance=0.2,
    limits=(0.0, 20.0),
    sizes=(0.2, 0.5, 2.0),
    smooth=False,
    kind="sensor",
    confused_with=("exhaust_thermal_inertia",),
    phrase="a lag of the exhaust thermocouple of {m}",
    source="first-order lag of a sheathed thermocouple",
)
