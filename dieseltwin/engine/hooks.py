"""Where effects enter the model graph: one function a quantity, called by the composition (`model`).

As written they leave the quantity as it is: that is the published model. `binding.bind` puts functions of the same
arguments in their place that apply the laws of the effects that enter there, in the order of their names. A law may
name, behind the quantity and its magnitude, every argument of the hook, every field of an argument that is a tuple
(`OperatingPoint`, `Charge`), the constants c, and every field of `Constants`. m: magnitudes of the effects.
"""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.quantities import Charge, OperatingPoint

Magnitudes = Array
"""A tuple with one field an effect (`effects.Magnitudes`)."""


def at_u_delta(u_delta: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Injected mass u_delta [mg/cycle]."""
    return u_delta


def at_u_egr(u_egr: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Position of the EGR valve u~_egr [%]."""
    return u_egr


def at_u_vgt(u_vgt: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Position of the VGT u~_vgt [%]."""
    return u_vgt


def at_p_bc(p_bc: Array, x: OperatingPoint, W_c: Array, m: Magnitudes, c: Constants) -> Array:
    """Pressure before the compressor p_bc [Pa]; the law is solved for the flow that p_bc gives rise to."""
    return p_bc


def at_W_c(W_c: Array, x: OperatingPoint, Pi_c: Array, m: Magnitudes, c: Constants) -> Array:
    """Compressor flow W_c [kg/s]."""
    return W_c


def at_eta_c(eta_c: Array, x: OperatingPoint, W_c: Array, Pi_c: Array, m: Magnitudes, c: Constants) -> Array:
    """Compressor efficiency eta_c [-]."""
    return eta_c


def at_egr_opening(egr_opening: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Share of the EGR valve's largest area that is open [-]."""
    return egr_opening


def at_A_egr(A_egr: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Effective area of the EGR valve A_egr [m2]."""
    return A_egr


def at_eta_vol(eta_vol: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Volumetric efficiency eta_vol [-]."""
    return eta_vol


def at_T_im(T_im: Array, x: OperatingPoint, charge: Charge, m: Magnitudes, c: Constants) -> Array:
    """Intake manifold temperature T_im [K]."""
    return T_im


def at_W_eo(W_eo: Array, x: OperatingPoint, W_ei: Array, W_f: Array, m: Magnitudes, c: Constants) -> Array:
    """Flow out of the cylinders W_eo [kg/s]."""
    return W_eo


def at_eta_sc(eta_sc: Array, x: OperatingPoint, W_ei: Array, W_f: Array, m: Magnitudes, c: Constants) -> Array:
    """Compensation factor of the cycle eta_sc [-]; the temperature behind the cylinders T_e is proportional to it."""
    return eta_sc


def at_T_em(T_em: Array, x: OperatingPoint, T_e: Array, W_eo: Array, W_f: Array, m: Magnitudes, c: Constants) -> Array:
    """Gas temperature in the exhaust manifold T_em [K], before the manifold's thermal inertia."""
    return T_em


def at_p_es(p_es: Array, x: OperatingPoint, W_t: Array, T_em: Array, m: Magnitudes, c: Constants) -> Array:
    """Pressure behind the turbine p_es [Pa]; the law is solved for the flow that p_es lets through."""
    return p_es


def at_W_t(W_t: Array, x: OperatingPoint, Pi_t: Array, T_em: Array, m: Magnitudes, c: Constants) -> Array:
    """Turbine flow W_t [kg/s]."""
    return W_t


def at_eta_tm(eta_tm: Array, x: OperatingPoint, W_t: Array, Pi_t: Array, m: Magnitudes, c: Constants) -> Array:
    """Turbine efficiency eta_tm [-]."""
    return eta_tm


def at_intake_balance(flow: Array, x: OperatingPoint, T_im: Array, m: Magnitudes, c: Constants) -> Array:
    """Further flow into the intake manifold [kg/s]."""
    return flow


def at_exhaust_balance(flow: Array, x: OperatingPoint, T_em: Array, m: Magnitudes, c: Constants) -> Array:
    """Further flow into the exhaust manifold [kg/s]."""
    return flow


def at_shaft_power(power: Array, x: OperatingPoint, m: Magnitudes, c: Constants) -> Array:
    """Further power on the turbocharger's shaft [W]."""
    return power
