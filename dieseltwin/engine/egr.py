"""EGR valve flow (paper, appendix A.I "EGR valve")."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum, minimum, root
from dieseltwin.engine.model_constants import Constants


def egr_valve_position(u_egr1: Array, u_egr2: Array, c: Constants) -> Array:
    """Valve position u~_egr [%] (A.18): two lags combined, so that it can overshoot below 0 and beyond 100 %."""
    return c.K_egr * u_egr1 - (c.K_egr - 1.0) * u_egr2


def f_egr(u_egr: Array, c: Constants) -> Array:
    """Effective area ratio f_egr [-] (A.23) from u~_egr [%]: saturates at its vertex, not below 0. Map N_2."""
    u = minimum(u_egr, c.u_egr_vertex)
    return maximum((c.c_egr1 * u + c.c_egr2) * u + c.c_egr3, 0.0)


def egr_area(f_egr: Array, c: Constants) -> Array:
    """Effective area of the EGR valve A_egr [m2] (A.21)."""
    return c.A_egrmax * f_egr


def egr_pressure_ratio(p_im: Array, p_em: Array, c: Constants) -> Array:
    """Pressure quotient over the valve Pi_egr [-] (A.22): choked below Pi_egropt, no back-flow above 1."""
    return minimum(maximum(p_im / p_em, c.Pi_egropt), 1.0)


def egr_flow_factor(Pi_egr: Array, c: Constants) -> Array:
    """Parabolic flow factor Psi_egr [-] (A.20)."""
    deviation = (1.0 - Pi_egr) / (1.0 - c.Pi_egropt) - 1.0
    return 1.0 - deviation * deviation


def egr_flow(A_egr: Array, p_em: Array, Psi_egr: Array, T_em: Array, c: Constants) -> Array:
    """EGR mass flow W_egr [kg/s] (A.19)."""
    return A_egr * p_em * Psi_egr / root(T_em * c.R_e)
