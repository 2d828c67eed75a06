"""A hole between cylinders and turbine: exhaust gas escapes to the surroundings."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.effect import Curve, Effect, Entry
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.nozzle import leak_flow


def exhaust_leak(flow: Array, A: Array, p_em: Array, T_em: Array, c: Constants) -> Array:
    """Further flow into the exhaust manifold [kg/s] with a hole of A [m2]."""
    return flow - leak_flow(A, p_em, T_em, c.p_amb, c.R_e, c.gamma_e, c.choking_e)


EFFECT = Effect(
    name="exhaust_leak",
    site="exhaust_mass_balance",
    enters=Entry("quantity", "exhaust_balance"),
    change=exhaust_leak,
    law="W_leak = A p_em/sqrt(R_e T_em) Psi(p_amb/p_em)",
    symbol="A",
    unit="m2",
    tolerance=5e-6,
    limits=(0.0, 2e-4),
    confused_with=("bearing_friction", "blow_by", "turbine_efficiency_loss"),
    curve=Curve("p_em/p_amb", "kg/s", sign=-1.0),
    phrase="an exhaust leak of {m}",
    source="isentropic nozzle, Heywood (1988), App. C",
)
