"""Residual gas that expands into the intake when the exhaust pressure is high."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def volumetric_efficiency_residual(eta_vol: Array, k: Array, p_im: Array, p_em: Array) -> Array:
    """Volumetric efficiency eta_vol [-] less what residual gas takes of the cylinder."""
    return eta_vol * (1.0 - k * (p_em / p_im - 1.0))


EFFECT = Effect(
    name="volumetric_efficiency_residual",
    site="cylinder_flow",
    enters=Entry("quantity", "eta_vol"),
    change=volumetric_efficiency_residual,
    law="eta_vol (1 - k (p_em/p_im - 1))",
    symbol="k",
    unit="-",
    tolerance=0.1,
    limits=(-1.0, 2.0),
    confused_with=("egr_heating", "charge_cooler_loss"),
    curve=Curve("p_em/p_im"),
    plain=True,
    phrase="a volumetric efficiency that falls with p_em/p_im (k = {m})",
    source="residual gas expands into the intake, Heywood (1988), sec. 6.2",
)
