"""An EGR valve that doesn't close."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def egr_valve_leak(egr_opening: Array, f_0: Array) -> Array:
    """Open share of the largest area [-] with a leak of f_0 [-]."""
    return egr_opening + f_0


EFFECT = Effect(
    name="egr_valve_leak",
    site="egr_flow",
    enters=Entry("quantity", "egr_opening"),
    change=egr_valve_leak,
    law="f_egr + f_0",
    symbol="f_0",
    unit="-",
    tolerance=0.01,
    limits=(0.0, 0.3),
    confused_with=("egr_clogging", "w_egr_gain"),
    curve=Curve("u_egr"),
    phrase="an EGR valve that leaks by {m} of its largest area when shut",
    source="Wahlstrom & Eriksson, Proc. IMechE D 225 (2011), Eq. 36 with a leak of the shut valve",
)
