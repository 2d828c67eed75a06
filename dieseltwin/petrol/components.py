"""Component equations of the petrol engine's air path.

The cylinder flow and the manifold balance are those of the diesel engine (`engine.cylinder`, `engine.manifolds`); the
throttle and leaks are compressible nozzles. Numpy throughout: balances are evaluated on measured signals.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.engine import cylinder, manifolds
from dieseltwin.engine.nozzle import choking_quotient, nozzle_flow_factor

R_A = 287.0  # J/(kg K), dry air
GAMMA = 1.4  # of air [-]
CRITICAL = choking_quotient(GAMMA)  # pressure quotient of choking [-]
CHOKED_FACTOR = float(nozzle_flow_factor(CRITICAL, GAMMA, CRITICAL))  # flow factor there [-]
LINEAR_ABOVE = 0.99  # the nozzle's slope is infinite at quotient 1: a straight line from here (Hendricks et al. 1996)
LEAK_LINEAR_ABOVE = 0.9999
"""The same of leaks [-]. Before the throttle the charge is a few hundred pascals above ambient in most part load: there
a line from 0.99 on has a third of the true flow. The throttle has a learned factor that does that, a leak has none."""

RPM = 30.0 / np.pi  # rpm per rad/s


def nozzle_factor(quotient: Array, linear_above: float = LINEAR_ABOVE) -> Array:
    """Flow factor Psi [-] of an isentropic nozzle from its pressure quotient p_down/p_up (Heywood 1988, App. C).

    Constant below the critical quotient, linear between `linear_above` and 1, 0 above 1.
    """
    psi = nozzle_flow_factor(np.minimum(quotient, linear_above), GAMMA, CRITICAL)
    return np.asarray(psi * np.clip((1.0 - quotient) / (1.0 - linear_above), 0.0, 1.0))


def nozzle_flow(
    area: Array | float, p_up: Array, T_up: Array, p_down: Array, linear_above: float = LINEAR_ABOVE
) -> Array:
    """Mass flow through a nozzle of effective `area` [m2] from p_up, T_up to p_down [kg/s]; 0 where p_down > p_up.
    `linear_above`: as of `nozzle_factor`."""
    return np.asarray(area * p_up / np.sqrt(R_A * T_up) * nozzle_factor(p_down / p_up, linear_above))


def signed_leak(area: Array | float, p_inside: Array, T_inside: Array, p_amb: Array, T_amb: Array) -> Array:
    """Flow through a leak, positive into the volume [kg/s]; inwards below ambient pressure, outwards above."""
    inwards = nozzle_flow(area, p_amb, T_amb, p_inside, LEAK_LINEAR_ABOVE)
    return inwards - nozzle_flow(area, p_inside, T_inside, p_amb, LEAK_LINEAR_ABOVE)


def displaced_flow(p_im: Array, omega_e: Array, T_im: Array, V_d: float) -> Array:
    """Cylinder flow at a volumetric efficiency of 1 [kg/s] (`engine.cylinder.cylinder_inflow`), omega_e in rad/s."""
    constants: Any = SimpleNamespace(V_d=V_d, R_a=R_A, T_im=T_im)
    return np.asarray(cylinder.cylinder_inflow(np.float64(1.0), p_im, omega_e * RPM, constants))


def storage_flow(dp_dt: Array, T: Array, volume: float) -> Array:
    """Flow that fills a volume whose pressure rises at dp_dt [Pa/s]: inverse of `engine.manifolds` (A.1) [kg/s]."""
    unit: Any = SimpleNamespace(R_a=R_A, T_im=T, V_im=volume)
    per_flow = manifolds.intake_pressure_rate(np.float64(1.0), np.float64(0.0), np.float64(0.0), unit)
    return np.asarray(dp_dt / per_flow)
