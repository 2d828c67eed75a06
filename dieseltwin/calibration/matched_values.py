"""Optimum and curvature of a turbine's efficiency over its blade speed ratio, as of one that fits its engine."""

from __future__ import annotations

import numpy as np

from dieseltwin.engine import constants, we2011
from dieseltwin.engine.binding import bind
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.recordings.steady_points import SteadyPoints

SLOPE_OF_RATIO = ("BSR_opt", "c_m1")
"""Coefficients that say how the turbine's efficiency goes with its blade speed ratio."""

WORKS_AT, BEST_AT = 0.85, 1.0  # settled points' share of the best ratio [-]: usually (slope 0.3), and at most (slope 0)

_eq = bind("numpy")


def known_turbine(base: EngineParameters, engine: EngineParameters) -> bool:
    """Whether the base's optimum is this engine's: the published engine's size, or an optimum that isn't the published
    one."""
    published = we2011.PARAMETERS
    return engine.V_d == published.V_d or base.BSR_opt != published.BSR_opt


def matched_values(points: SteadyPoints, engine: EngineParameters, works_at: float = WORKS_AT) -> dict[str, float]:
    """`SLOPE_OF_RATIO` of a turbine that fits: its middle blade speed ratio is a share of the best one.

    Args:
        points: n settled points, as read.
        engine: with the turbine's radius and highest efficiency.
        works_at: the share [-].
    """
    Pi_t = points["p_amb_pa"] / points["p_em_pa"]
    ratio = _eq.blade_speed_ratio(points["omega_t_rad_s"], points["t_em_k"], Pi_t, constants(engine))
    best = float(np.nanmedian(ratio)) / works_at
    return {"BSR_opt": best, "c_m1": engine.eta_tmmax / best**2}
