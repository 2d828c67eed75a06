"""EGR that arrives warmer than the intake manifold and heats the charge."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry


def egr_heating(T_im: Array, f: Array, T_em: Array, W_c: Array, W_egr: Array) -> Array:
    """T_im [K] with EGR that arrives at T_im + f (T_em - T_im), mixed by mass flows [kg/s]."""
    return T_im + f * (T_em - T_im) * W_egr / (W_c + W_egr)


EFFECT = Effect(
    name="egr_heating",
    site="intake_temperature",
    enters=Entry("quantity", "T_im"),
    change=egr_heating,
    law="T_im + f (T_em - T_im) W_egr/(W_c + W_egr)",
    symbol="f",
    unit="-",
    tolerance=0.05,
    limits=(0.0, 1.0),
    confused_with=("volumetric_efficiency_residual", "charge_cooler_loss"),
    curve=Curve("W_egr", "K"),
    plain=True,
    phrase="heating of the charge by warm EGR (f = {m})",
    source="mixing of two flows; Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), sec. 7.5",
)
