"""Fuel that reaches the cylinders later than its signal: filtered signal, delivery through the rail."""

from __future__ import annotations

from dieseltwin.engine.effect import Effect, Entry

EFFECT = Effect(
    name="fuel_lag",
    site="fuel_injection",
    enters=Entry("input", "u_delta", "lag"),
    law="tau du/dt = u_delta - u, the mass that is injected",
    symbol="tau",
    unit="s",
    tolerance=0.1,
    limits=(0.0, 5.0),
    sizes=(0.1, 0.4, 1.5),
    smooth=False,
    kind="input",
    confused_with=("exhaust_thermal_inertia",),
    phrase="a lag of the injected mass behind its signal of {m}",
    source="first-order lag of a filtered or slewed fuel command",
)
