"""Settled points of a made-up engine: the balances solved exactly, then noise on the readings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.calibration.coefficients import with_scalars
from dieseltwin.calibration.steady_model import MAP_MODE, ROWS, SteadyModel
from dieseltwin.engine import we2011
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.recordings.steady_points import STATES, SteadyPoints, points

GEOMETRY = we2011.PARAMETERS.replace(V_d=0.0108, r_c=17.5, R_c=0.0368, R_t=0.0368)
TRUTH = with_scalars(GEOMETRY, {
    "c_vol3": 1.12, "A_egrmax": 3.0e-4, "A_vgtmax": 7.6e-4, "K_t": 2.7, "c_vgt1": 130.0, "eta_tmmax": 0.80,
    "BSR_opt": 0.93, "c_m1": 1.6, "eta_cmax": 0.75, "W_copt": 0.24, "pi_copt": 1.02, "c_egr1": -1.0e-4, "c_egr3": 0.02,
    "c_omega_psi3": 1.05, "c_omega_phi3": 30.5, "eta_sc": 1.05, "h_tot": 80.0, "Pi_egropt": 0.67,
})  # fmt: skip


NEWTON_STEPS = 30
LARGEST_STEP = 0.1  # of ln x
DIFFERENCE = 1e-5
WAVE_RPM = 260.0  # of engine speed, for a radian of a wave
DAMPING = 1e-8  # keeps a speed line that is flat at a trial state from throwing the state away
FLAP = {"exhaust_flap": 1e5, "flap_m": 4.0, "flap_q": 0.0}
"""An exhaust flap that throttles by 9 kPa at 0.3 kg/s and half stroke."""


def settle(model: SteadyModel, data: SteadyPoints, values: Mapping[str, Any], start: Array) -> Array:
    """States at which every balance holds, (n, 6), from start (n, 6); where there are none the nearest that was met."""
    y = np.log(start)
    size = len(STATES)

    def residual(y: Array) -> Array:
        r = model.relations(data, np.exp(y)[None], values).residual[0, :, : len(ROWS)]
        return np.clip(np.nan_to_num(r), -3.0, 3.0)

    r = residual(y)
    best, best_y = np.max(np.abs(r), axis=-1), y.copy()
    for _ in range(NEWTON_STEPS):
        J = np.stack([(residual(y + DIFFERENCE * np.eye(size)[j]) - r) / DIFFERENCE for j in range(size)], axis=-1)
        normal = np.swapaxes(J, -1, -2) @ J + DAMPING * np.eye(size)
        step = -np.linalg.solve(normal, np.swapaxes(J, -1, -2) @ r[..., None])[..., 0]
        longest = np.max(np.abs(step), axis=-1, keepdims=True)
        y = y + step * np.minimum(1.0, LARGEST_STEP / np.maximum(longest, 1e-300))
        r = residual(y)
        worst = np.max(np.abs(r), axis=-1)
        better = worst < best
        best, best_y = np.where(better, worst, best), np.where(better[..., None], y, best_y)
    return np.exp(best_y)


def made_points(
    engine: EngineParameters = TRUTH, count: int = 150, noise: float = 0.01, seed: int = 5,
    effects: Mapping[str, float] | None = None, exhaust_wave: float = 0.0, filling_wave: float = 0.0,
    **fixed: float,
) -> SteadyPoints:  # fmt: skip
    """`count` settled points with relative noise under effects (and coefficients of the flap's law).

    Faults of sensors among the effects change the readings; `fixed` holds an input column at one value. The exhaust's
    temperature is off by `exhaust_wave` times a wave over engine speed, the volumetric efficiency by `filling_wave`.
    """
    generator = np.random.default_rng(seed)
    n = 3 * count
    u = generator.uniform([800.0, 35.0, 8.0, 24.0], [2000.0, 195.0, 85.0, 62.0], (n, 4))
    columns = dict(zip(("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"), u.T, strict=True))
    columns["u_flap_pct"] = generator.uniform(25.0, 100.0, n)
    for name, value in fixed.items():
        columns[name] = np.full(n, value)
    data = points(columns, engine, needed=())
    waves = {f"{MAP_MODE}T_em:wave": exhaust_wave, f"{MAP_MODE}eta_vol:wave": filling_wave}
    solved = data.with_columns(**dict.fromkeys(waves, np.sin(data["n_e_rpm"] / WAVE_RPM)))
    model = SteadyModel(engine)
    values = {"h_tot": engine.h_tot, **waves, **(effects or {})}
    load = columns["u_delta_mg"] / 200.0
    p_im = engine.p_amb * (1.1 + 1.7 * load)
    flow = 0.9 * p_im * columns["n_e_rpm"] * engine.V_d / (120.0 * 287.0 * 300.0)
    turbo, exhaust = 3000.0 + 6500.0 * load, 550.0 + 300.0 * load
    start = np.stack([p_im, 1.15 * p_im, turbo, 0.85 * flow, 0.15 * flow, exhaust], axis=1)
    x = settle(model, solved, values, start)
    r = model.relations(solved, x, values).residual[0, :, : len(ROWS)]
    air = x[:, 3] / (14.57e-6 / 120.0 * columns["u_delta_mg"] * columns["n_e_rpm"] * 6)
    good = (np.abs(r).max(axis=1) < 1e-4) & (air > 1.15) & (x[:, 0] > 1.04 * engine.p_amb) & (x[:, 5] < 1200.0)
    chosen = np.flatnonzero(good)[:count]
    if chosen.size < count:
        raise AssertionError(f"only {chosen.size} of {count} points settled")
    readings = x[chosen] * (1.0 + noise * generator.standard_normal((count, len(STATES))))
    return data.take(chosen).with_columns(**dict(zip(STATES, readings.T, strict=True)))
