"""Arguments of the petrol engine's maps, and how far each second of a recording can be relied upon.

cylinder: log of (air flow - filling of both volumes) over displaced flow = log eta_vol(omega_e, p_im);
throttle: log of (air flow - filling before the throttle) over the nozzle's flow factor = log A(alpha) + c(Psi);
boost: p_ic = p_amb while the engine idles with the throttle shut and the compressor does nothing;
cooler: T_ic follows T_amb slowly.

The sensors enter with different signs: W_af in the first two, p_im in the first and, unchoked, the second, p_ic in
the last two. That is what tells their faults apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.petrol.blocks import BLOCK_S, Blocks, Grid
from dieseltwin.petrol.maps import beyond, sum_basis, tensor_basis, tensor_value
from dieseltwin.petrol.parameters import SplineMap, Spread
from dieseltwin.petrol.recording import Signals

BALANCES = ("cylinder", "throttle", "boost", "cooler")
SHUT_PCT, IDLE_RAD_S, REST_S = 4.0, 130.0, 3  # idle: throttle below, speed below, for so many blocks before
DRIFT_S = 300.0  # between anchors of the slow drift
ALPHA_SHIFT = 1.0  # %, added before the logarithm: the throttle's map is smooth in log(alpha + 1)
CHOKED_PSI, LEAST_PSI = 0.685, 0.02  # flow factor of a choked throttle; where 1/Psi is limited [-]
ZERO_STEP_PCT = 0.05  # for the derivative to the throttle's zero


def cylinder_basis(b: Blocks, m: SplineMap) -> Array:
    """Basis of log eta_vol over (omega_e, log p_im)."""
    return tensor_basis(b.omega_e, np.log(b.p_im), np.array(m.knots_x), np.array(m.knots_y))


def log_efficiency(b: Blocks, m: SplineMap) -> Array:
    """(m,) log eta_vol by a map."""
    return tensor_value(b.omega_e, np.log(b.p_im), np.array(m.knots_x), np.array(m.knots_y), np.array(m.coefficients))


def opening(alpha: Array) -> Array:
    """(m,) log(alpha + 1) of throttle positions alpha [%]; a reading far below 0 is taken for shut [-]."""
    return np.asarray(np.log(np.maximum(alpha, -0.5 * ALPHA_SHIFT) + ALPHA_SHIFT))


def throttle_basis(b: Blocks, m: SplineMap, shift_pct: float = 0.0) -> Array:
    """Basis of the log area over log(alpha + 1) and Psi."""
    return sum_basis(opening(b.alpha + shift_pct), b.psi, np.array(m.knots_x), np.array(m.knots_y))


def outside(b: Blocks, cylinder: SplineMap, throttle: SplineMap) -> dict[str, tuple[Array, ...]]:
    """Flow balance -> (m,) how far each argument of its map lies beyond what was learned [steps of the knots]."""
    arguments = {"cylinder": (cylinder, b.omega_e, np.log(b.p_im)), "throttle": (throttle, opening(b.alpha), b.psi)}
    return {
        name: (beyond(x, np.array(m.knots_x)), beyond(y, np.array(m.knots_y))) for name, (m, x, y) in arguments.items()
    }


def throttle_zero(b: Blocks, m: SplineMap) -> Array:
    """(m,) change of the log area per % of throttle position."""
    theta = np.array(m.coefficients)
    up, down = throttle_basis(b, m, ZERO_STEP_PCT), throttle_basis(b, m, -ZERO_STEP_PCT)
    return np.asarray((up - down) @ theta / (2.0 * ZERO_STEP_PCT))


def drift_basis(mid_s: Array) -> Array:
    """Hat functions over time with an anchor every DRIFT_S (m, anchors)."""
    anchors = np.arange(mid_s[0], mid_s[-1] + DRIFT_S, DRIFT_S)
    hats = np.maximum(0.0, 1.0 - np.abs(mid_s[:, None] - anchors[None]) / DRIFT_S)
    return np.asarray(hats[:, hats.any(axis=0)])


def unsteadiness(s: Signals, grid: Grid, b: Blocks) -> Array:
    """(m, 4) how unsteady each block is: pressure change, throttle motion, speed change, 1/Psi over choked [-]."""
    def relative(x: Array, floor: float) -> Array:
        middle = grid.mean(x)
        spread = np.sqrt(np.maximum(grid.mean(x * x) - middle * middle, 0.0))
        return np.asarray(spread / np.maximum(np.abs(middle), floor))

    pressure = np.abs(grid.slope(s.p_im)) * BLOCK_S / b.p_im
    nearly_open = np.maximum(CHOKED_PSI / np.maximum(b.psi, LEAST_PSI) - 1.0, 0.0)
    return np.stack([pressure, relative(s.alpha, 1.0), relative(s.omega_e, 10.0), nearly_open], 1)


def scale_of(spread: Spread, unsteady: Array) -> Array:
    """(m,) Student-t scale of a balance."""
    rates = np.array(spread.rates)
    return np.sqrt(spread.base**2 + (unsteady[:, : len(rates)] ** 2) @ rates**2)


def at_rest(b: Blocks, grid: Grid) -> NDArray[np.bool_]:
    """(m,) the engine idles with the throttle shut, for a while: the compressor does nothing."""
    idle = (b.alpha < SHUT_PCT) & (b.omega_e < IDLE_RAD_S)
    result = idle.copy()
    for back in range(1, REST_S + 1):
        result[back:] &= idle[:-back] & (grid.piece[back:] == grid.piece[:-back])
        result[:back] = False
    return result
