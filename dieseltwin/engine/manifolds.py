"""Intake and exhaust manifold balances (paper, appendix A.I "Manifold pressures")."""

from __future__ import annotations

from dieseltwin.engine.array_namespace import Array, maximum
from dieseltwin.engine.model_constants import Constants

X_OC = 0.2314  # oxygen mass fraction of ambient air [-] (Wahlström & Eriksson 2011, Sec. 2)


def intake_pressure_rate(W_c: Array, W_egr: Array, W_ei: Array, c: Constants) -> Array:
    """Rate of the intake manifold pressure dp_im/dt [Pa/s] (A.1) from the flows [kg/s]."""
    return c.R_a * c.T_im / c.V_im * (W_c + W_egr - W_ei)


def exhaust_pressure_rate(W_eo: Array, W_t: Array, W_egr: Array, T_em: Array, c: Constants) -> Array:
    """Rate of the exhaust manifold pressure dp_em/dt [Pa/s] (A.2) from the flows [kg/s] and T_em [K]."""
    return c.R_e * T_em / c.V_em * (W_eo - W_t - W_egr)


def intake_oxygen_rate(X_Oim: Array, X_Oem: Array, p_im: Array, W_c: Array, W_egr: Array, c: Constants) -> Array:
    """Rate of the intake oxygen mass fraction dX_Oim/dt [1/s] (Wahlström & Eriksson 2011, Eq. 4)."""
    return c.R_a * c.T_im / (p_im * c.V_im) * (W_egr * (X_Oem - X_Oim) + W_c * (X_OC - X_Oim))


def exhaust_oxygen_rate(X_Oem: Array, X_Oe: Array, p_em: Array, T_em: Array, W_eo: Array, c: Constants) -> Array:
    """Rate of the exhaust oxygen mass fraction dX_Oem/dt [1/s] (Wahlström & Eriksson 2011, Eq. 7)."""
    return c.R_e * T_em / (p_em * c.V_em) * W_eo * (X_Oe - X_Oem)


def cylinder_out_oxygen(X_Oim: Array, W_ei: Array, W_f: Array, c: Constants) -> Array:
    """Oxygen mass fraction behind the cylinders X_Oe [-], not below 0 (Wahlström & Eriksson 2011, Eq. 15)."""
    return maximum(W_ei * X_Oim - W_f * c.AF_s * X_OC, 0.0) / (W_ei + W_f)


def air_fuel_ratio(W_c: Array, W_f: Array, c: Constants) -> Array:
    """Relative air/fuel ratio lambda [-] = W_c/(W_f AF_s); without fuel limited by W_f >= 1e-7 kg/s."""
    return W_c / (maximum(W_f, LEAST_FUEL_FLOW) * c.AF_s)


LEAST_FUEL_FLOW = 1e-7  # kg/s, a hundredth of idle: keeps lambda finite when motoring


def egr_fraction(W_c: Array, W_egr: Array) -> Array:
    """EGR fraction [-] = W_egr/(W_c + W_egr)."""
    return W_egr / (W_c + W_egr)
