"""A hole between compressor and cylinders: charge air escapes to the surroundings."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.nozzle import leak_flow


def boost_leak(flow: Array, A: Array, p_im: Array, T_im: Array, c: Constants) -> Array:
    """Further flow into the intake manifold [kg/s] with a hole of A [m2]."""
    return flow - leak_flow(A, p_im, T_im, c.p_amb, c.R_a, c.gamma_a, c.choking_a)


EFFECT = Effect(
    name="boost_leak",
    site="intake_mass_balance",
    enters=Entry("quantity", "intake_balance"),
    change=boost_leak,
    law="W_leak = A p_im/sqrt(R_a T_im) Psi(p_amb/p_im)",
    symbol="A",
    unit="m2",
    tolerance=4e-6,
    limits=(0.0, 2e-4),
    confused_with=("compressor_efficiency_loss", "compressor_flow_loss"),
    curve=Curve("p_im/p_amb", "kg/s", sign=-1.0),
    phrase="a boost leak of {m}",
    source="isentropic nozzle, Heywood (1988), App. C",
)
