"""Heat stored in the wall of the exhaust manifold: the gas temperature follows with a lag."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="exhaust_thermal_inertia",
    site="exhaust_temperature",
    enters=Entry("gas", "T_em", "lag"),
    law="tau dT_em/dt = T_em(static) - T_em",
    symbol="tau",
    unit="s",
    tolerance=0.1,
    limits=(0.0, 90.0),
    sizes=(0.1, 0.4, 2.0, 10.0, 30.0),
    smooth=False,
    confused_with=("thermocouple_lag",),
    phrase="a thermal inertia of the exhaust of {m}",
    source="heat stored in the manifold's wall: seconds for thin steel, a minute for cast iron",
)
