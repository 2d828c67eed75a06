"""The exhaust flap: a restriction behind the turbine whose area follows the input `u_flap_pct`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry
from dieseltwin.engine.effects.back_pressure import T_ES_REFERENCE

REFERENCE_PCT = 50.0  # position at which the coefficient of the flap is stated
LEAST_PCT = 1.0  # a flap that is shut altogether leaks; it keeps the logarithm finite


def exhaust_flap(p_es: Array, k: Array, W_t: Array, T_em: Array) -> Array:
    """Pressure behind the turbine p_es [Pa] before a flap of k [Pa/(kg/s)^2] at 700 K in its present position."""
    return p_es + k * W_t * W_t * T_em / T_ES_REFERENCE


def flap_factor(
    columns: Mapping[str, NDArray[np.float64]], coefficients: Mapping[str, float]
) -> NDArray[np.float64]:
    """Coefficient of the flap over that at 50 %, exp(-m y - q y^2) with y = ln(u_flap/50 %) [-], (n,)."""
    y = np.log(np.maximum(columns["u_flap_pct"], LEAST_PCT) / REFERENCE_PCT)
    return np.exp(-y * (coefficients["m"] + coefficients["q"] * y))


EFFECT = Effect(
    name="exhaust_flap",
    site="turbine_flow",
    enters=Entry("quantity", "p_es"),
    change=exhaust_flap,
    law="p_es = p_amb + k exp(-m y - q y^2) W_t^2 T_em/700 K, y = ln(u_flap/50 %)",
    symbol="k",
    unit="Pa/(kg/s)^2",
    tolerance=2e4,
    limits=(0.0, 5e6),
    sizes=(1e5,),
    smooth=False,
    confused_with=("back_pressure",),
    curve=Curve("W_t", "Pa"),
    at_flow=0.3,
    phrase="an exhaust flap that at 50 % throttles by {m}",
    source="a restriction of area A has k ~ 1/A^2; Eriksson & Nielsen, Modeling and Control of Engines and Drivelines "
    "(2014), sec. 7.2",
    needs=("u_flap_pct",),
    coefficients={"m": 4.0, "q": 0.0},
    follows=flap_factor,
)
