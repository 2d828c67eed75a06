"""Settled points of a made-up engine: the balances solved exactly, then noise on the readings."""

from __future__ import annotations

import numpy as np

from dieseltwin.calibration.coefficients import TERMS, with_scalars
from dieseltwin.calibration.steady_model import ROWS, SteadyModel
from dieseltwin.calibration.steady_twin import settle
from dieseltwin.engine import we2011
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.recordings.steady_points import STATES, SteadyPoints, points

GEOMETRY = we2011.PARAMETERS.replace(V_d=0.0108, r_c=17.5, R_c=0.0368, R_t=0.0368)
TRUTH = with_scalars(GEOMETRY, {
    "c_vol3": 1.12, "A_egrmax": 3.0e-4, "A_vgtmax": 7.6e-4, "K_t": 2.7, "c_vgt1": 130.0, "eta_tmmax": 0.80,
    "BSR_opt": 0.93, "c_m1": 1.6, "eta_cmax": 0.75, "W_copt": 0.24, "pi_copt": 1.02, "c_egr1": -1.0e-4, "c_egr3": 0.02,
    "c_omega_psi3": 1.05, "c_omega_phi3": 30.5, "eta_sc": 1.05, "h_tot": 80.0, "Pi_egropt": 0.67,
})  # fmt: skip


def made_points(
    engine: EngineParameters = TRUTH, count: int = 150, noise: float = 0.01, seed: int = 5,
    term_values: dict[str, float] | None = None, active: tuple[str, ...] = (), **fixed: float,
) -> SteadyPoints:  # fmt: skip
    """`count` settled points with relative noise; `fixed` holds an input column at one value."""
    generator = np.random.default_rng(seed)
    n = 3 * count
    u = generator.uniform([800.0, 35.0, 8.0, 24.0], [2000.0, 195.0, 85.0, 62.0], (n, 4))
    columns = dict(zip(("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"), u.T, strict=True))
    columns["u_flap_pct"] = generator.uniform(25.0, 100.0, n)
    for name, value in fixed.items():
        columns[name] = np.full(n, value)
    data = points(columns, engine, needed=())
    model = SteadyModel(engine, frozenset(active))
    values = {c.name: c.mean for name in active for c in TERMS[name].parameters} | (term_values or {})
    load = columns["u_delta_mg"] / 200.0
    p_im = engine.p_amb * (1.1 + 1.7 * load)
    flow = 0.9 * p_im * columns["n_e_rpm"] * engine.V_d / (120.0 * 287.0 * 300.0)
    turbo, exhaust = 3000.0 + 6500.0 * load, 550.0 + 300.0 * load
    start = np.stack([p_im, 1.15 * p_im, turbo, 0.85 * flow, 0.15 * flow, exhaust], axis=1)
    x = settle(model, data, values or {"h_tot": engine.h_tot}, start)[0]
    r = model.relations(data, x, values or {"h_tot": engine.h_tot}).residual[0, :, : len(ROWS)]
    air = x[:, 3] / (14.57e-6 / 120.0 * columns["u_delta_mg"] * columns["n_e_rpm"] * 6)
    good = (np.abs(r).max(axis=1) < 1e-4) & (air > 1.15) & (x[:, 0] > 1.04 * engine.p_amb) & (x[:, 5] < 1200.0)
    chosen = np.flatnonzero(good)[:count]
    if chosen.size < count:
        raise AssertionError(f"only {chosen.size} of {count} points settled")
    readings = x[chosen] * (1.0 + noise * generator.standard_normal((count, len(STATES))))
    return data.take(chosen).with_columns(**dict(zip(STATES, readings.T, strict=True)))
