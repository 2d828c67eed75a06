"""Resistance of the exhaust system behind the turbine."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry

T_ES_REFERENCE = 700.0  # K, gas temperature at which the coefficient is stated


def back_pressure(p_es: Array, k: Array, W_t: Array, T_em: Array) -> Array:
    """Pressure behind the turbine p_es [Pa] before an exhaust system of k [Pa/(kg/s)^2] at 700 K."""
    return p_es + k * W_t * W_t * T_em / T_ES_REFERENCE


EFFECT = Effect(
    name="back_pressure",
    site="turbine_flow",
    enters=Entry("quantity", "p_es"),
    change=back_pressure,
    law="p_es = p_amb + k W_t^2 T_em/700 K",
    symbol="k",
    unit="Pa/(kg/s)^2",
    tolerance=2e4,
    limits=(0.0, 5e5),
    confused_with=("turbine_efficiency_loss", "bearing_friction"),
    curve=Curve("W_t", "Pa"),
    at_flow=0.3,
    phrase="a back-pressure behind the turbine of {m}",
    source="Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), sec. 7.2",
)
