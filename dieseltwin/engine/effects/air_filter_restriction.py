"""Resistance of the air filter before the compressor."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum
from dieseltwin.engine.effect import Curve, Effect, Entry

LEAST_SHARE = 0.5  # limiter: of the pressure before the filter


def air_filter_restriction(p_bc: Array, k: Array, W_c: Array) -> Array:
    """Pressure before the compressor p_bc [Pa] behind a filter of k [Pa/(kg/s)^2]."""
    return maximum(p_bc - k * W_c * W_c, LEAST_SHARE * p_bc)


EFFECT = Effect(
    name="air_filter_restriction",
    site="compressor_flow",
    enters=Entry("quantity", "p_bc"),
    change=air_filter_restriction,
    law="p_bc = p_amb - k W_c^2",
    symbol="k",
    unit="Pa/(kg/s)^2",
    tolerance=1.5e4,
    limits=(0.0, 2e5),
    confused_with=("compressor_efficiency_loss", "compressor_flow_loss"),
    curve=Curve("W_c", "Pa", sign=-1.0),
    at_flow=0.4,
    phrase="a restriction of the air filter of {m}",
    source="Eriksson & Nielsen, Modeling and Control of Engines and Drivelines (2014), sec. 7.2",
)
