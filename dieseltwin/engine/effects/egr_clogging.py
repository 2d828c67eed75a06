"""Soot that narrows the EGR path more and more."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum
from dieseltwin.engine.effect import Curve, Effect, Entry


def egr_clogging(A_egr: Array, k_t: Array) -> Array:
    """Effective area A_egr [m2] of which soot has closed the share k t [-]."""
    return A_egr * maximum(1.0 - k_t, 0.0)


EFFECT = Effect(
    name="egr_clogging",
    site="egr_flow",
    enters=Entry("quantity", "A_egr"),
    change=egr_clogging,
    law="A_egrmax (1 - k t)",
    symbol="k",
    unit="1/s",
    tolerance=5e-5,
    limits=(0.0, 1e-3),
    confused_with=("egr_valve_leak",),
    drifts=True,
    curve=Curve("t"),
    phrase="an EGR valve that clogs by {m}",
    source="soot deposits over time; t from the recording's start",
)
