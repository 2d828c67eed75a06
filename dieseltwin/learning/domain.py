"""Where the maps of an engine are known: over each map's arguments, where the belief was cut to less than half.

The mean of a map and a health parameter can say the same (more of every opening of the EGR valve, or a larger valve).
That is no gap in what is known of the map's shape, and so the health parameters are held here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.engine import EngineParameters, constants
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.map_corrections import (
    ARGUMENTS,
    CORRECTED_POINTS,
    NODES,
    OF_RATIO,
    RANGES,
    basis,
    basis_along,
    look_up,
)
from dieseltwin.engine.turbocharger import PI_T_MAX
from dieseltwin.learning.belief import HEALTH_AT, MAPS_AT, Array, Belief

KNOWN_SHARE = 0.5
"""Of the standard deviation that was believed before, below which a map counts as known [-]."""

EXHAUST = 700.0
"""Exhaust temperature T_em for which the turbine's efficiency is told over speed and pressure ratio [K]: of driving."""


def covariance_of_maps(belief: Belief) -> Array:
    """Covariance (K, K) of the corrections' coefficients at given health parameters [-]."""
    whole = belief.covariance
    across = whole[MAPS_AT, HEALTH_AT]
    return np.asarray(whole[MAPS_AT, MAPS_AT] - across @ np.linalg.solve(whole[HEALTH_AT, HEALTH_AT], across.T))


def uncertainty_along(belief: Belief, functions: Array) -> Array:
    """Standard deviation of every map's correction, (6, n) [-], where the basis functions have values (K, n)."""
    covariance, maps = covariance_of_maps(belief), basis().maps
    out = np.empty((len(CORRECTED_POINTS), functions.shape[1]))
    for m in range(len(out)):
        at = np.flatnonzero(maps == m)
        some = functions[at]
        out[m] = np.sqrt(np.maximum(np.einsum("kn,kl,ln->n", some, covariance[np.ix_(at, at)], some), 0.0))
    return out


def known_along(belief: Belief, map_rms: float, variables: Mapping[str, Array]) -> np.ndarray:
    """(6, n) whether each map is known along a trajectory.

    Args:
        belief: what was learned; map_rms: standard deviation that was believed before [-].
        variables: name -> (n,), the maps' arguments among them.
    """
    return uncertainty_along(belief, basis_along(variables)) < KNOWN_SHARE * map_rms


def functions_on_maps(engine: EngineParameters) -> Array:
    """Values (K, NODES * NODES) of the functions over the arguments of the maps that they are of [-].

    Args:
        engine: its turbine says which blade speed ratio goes with speed and pressure ratio, at `EXHAUST`.
    """
    functions = basis()
    tables = functions.tables.reshape(len(functions.maps), -1).copy()
    nodes = [np.linspace(*RANGES[name], NODES) for name in ARGUMENTS["eta_tm"]]
    omega_t, Pi_t = (some.ravel() for some in np.meshgrid(*nodes, indexing="ij"))
    ratio = numpy_model().blade_speed_ratio(omega_t, EXHAUST, np.minimum(Pi_t, PI_T_MAX), constants(engine))
    tables[functions.of_ratio] = look_up(functions.tables[functions.of_ratio], OF_RATIO, omega_t, ratio)
    return tables


def share_of_box(known: np.ndarray) -> float:
    """Part that is known of the smallest box of both arguments that holds all of it, of nodes (NODES * NODES,) [-]."""
    inside = known.reshape(NODES, NODES)
    return float(inside[np.ix_(inside.any(axis=1), inside.any(axis=0))].mean())


def domain_of(belief: Belief, map_rms: float, engine: EngineParameters) -> dict[str, dict[str, tuple[float, float]]]:
    """Map -> argument -> lowest and highest value at which anything of it is known; maps of which nothing is, are left
    out. Arguments as of `uncertainty_along` and `functions_on_maps`."""
    known = uncertainty_along(belief, functions_on_maps(engine)) < KNOWN_SHARE * map_rms
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for m, point in enumerate(CORRECTED_POINTS):
        inside = known[m].reshape(NODES, NODES)
        if not inside.any():
            continue
        ends = {}
        for axis, argument in enumerate(ARGUMENTS[point]):
            rows = np.flatnonzero(inside.any(axis=1 - axis))
            low, high = RANGES[argument]
            step = (high - low) / (NODES - 1)
            ends[argument] = (float(low + step * rows[0]), float(low + step * rows[-1]))
        found[point] = ends
    return found
