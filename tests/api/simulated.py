"""A simulated engine over slow random driving, and what sensors would read."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.engine import EngineParameters, Inputs, simulate, we2011

NOISE = {"p_im_pa": 5e3, "p_em_pa": 6e3, "omega_t_rad_s": 60.0, "w_egr_kg_s": 0.0015, "t_em_k": 20.0, "w_c_kg_s": 0.005}
INPUTS = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")


def drive(
    seconds: float, engine: EngineParameters = we2011.PARAMETERS, *, seed: int = 5, still: bool = False
) -> pd.DataFrame:
    """A noisy recording at 5 Hz, of driving or of an engine that stands still at one point."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds + 0.1, 0.2)

    def walk(low: float, high: float, every_s: float) -> np.ndarray:
        knots = rng.uniform(low, high, int(seconds / every_s) + 3)
        return np.interp(time_s, np.arange(knots.size) * every_s, knots)

    inputs = [walk(900, 1800, 9.0), walk(60, 200, 6.0), walk(0, 60, 8.0), walk(30, 80, 7.0)]
    if still:
        inputs = [np.full(time_s.size, value) for value in (1300.0, 110.0, 20.0, 50.0)]
    table = simulate(Inputs(time_s, *inputs), engine, oxygen=False)
    for name, sigma in NOISE.items():
        table[name] += sigma * rng.standard_normal(time_s.size)
    return table[[*INPUTS, *NOISE]]
