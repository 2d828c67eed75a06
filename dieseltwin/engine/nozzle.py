"""Isentropic nozzle: choking, flow factor, flow through an area.

Heywood, Internal Combustion Engine Fundamentals (1988), App. C.
"""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum, minimum, positive_power, root


def choking_quotient(gamma: Array) -> Array:
    """Pressure quotient (outer over inner) at which an isentropic nozzle chokes [-]."""
    return (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))


def nozzle_flow_factor(Pi: Array, gamma: Array, choking: Array) -> Array:
    """Flow factor Psi [-] of an isentropic nozzle at the pressure quotient Pi (outer over inner): choked below
    `choking`, no back-flow above 1."""
    quotient = minimum(maximum(Pi, choking), 1.0)
    density = positive_power(quotient, 1.0 / gamma)  # density quotient
    return root(2.0 * gamma / (gamma - 1.0) * density * (density - quotient))


def leak_flow(area: Array, p: Array, T: Array, p_out: Array, R: Array, gamma: Array, choking: Array) -> Array:
    """Leak flow [kg/s] from p [Pa], T [K] to p_out [Pa] through an area [m2]."""
    return area * p / root(R * T) * nozzle_flow_factor(p_out / p, gamma, choking)
