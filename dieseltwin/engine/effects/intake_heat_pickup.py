"""Warm walls of intake manifold and ports that heat the charge on its way into the cylinders."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, with_charge
from dieseltwin.engine.cylinder import cylinder_inflow
from dieseltwin.engine.effect import Curve, Effect, Entry
from dieseltwin.engine.model_constants import Constants

T_WALL = 360.0  # K, of a cylinder head cooled by water behind a thermostat of 87 degrees Celsius


def intake_heat_pickup(T_im: Array, k: Array, eta_vol: Array, p_im: Array, n_e: Array, c: Constants) -> Array:
    """T_im [K] behind walls of T_WALL that give k [W/K] to the charge.

    W_ei is the flow of the charge that has been heated, W_0 T_im,0/T_im with the flow W_0 of the charge as it came; the
    law is solved for T_im.
    """
    W_0 = cylinder_inflow(eta_vol, p_im, n_e, with_charge(c, T_im, c.eta_sc))
    return T_im / (1.0 - k * (T_WALL - T_im) / (W_0 * c.c_pa * T_im))


EFFECT = Effect(
    name="intake_heat_pickup",
    site="intake_temperature",
    enters=Entry("quantity", "T_im"),
    change=intake_heat_pickup,
    law="T_im + k (T_wall - T_im)/(W_ei c_pa), T_wall = 360 K",
    symbol="k",
    unit="W/K",
    tolerance=4.0,
    limits=(0.0, 60.0),
    confused_with=("charge_cooler_loss", "egr_heating", "volumetric_efficiency_residual"),
    curve=Curve("n_e", "K"),
    phrase="walls that heat the charge by {m}",
    source="heat transfer in the intake system, Heywood (1988), sec. 6.2",
)
