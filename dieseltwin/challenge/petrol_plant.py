"""A made-up petrol engine: other maps than splines, own integration, drawn driving, noise; faults act in it.

It imports nothing of the twin that it proves.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
import pandas as pd

RATE_HZ, R, V_D, V_IM, V_IC = 20.0, 287.0, 1.953e-3, 1.8e-3, 4.7e-3
CRITICAL = (2.0 / 2.4) ** (1.4 / 0.4)  # pressure quotient of choking [-]
ONSET_S = 200.0


def _psi(q: float) -> float:
    q = max(q, CRITICAL)
    if q >= 1.0:
        return 0.0
    value = sqrt(7.0 * (min(q, 0.99) ** (2 / 1.4) - min(q, 0.99) ** (2.4 / 1.4)))
    return value * min((1.0 - q) / 0.01, 1.0)


def _area(alpha: float) -> float:
    return 3e-6 + 4.5e-6 * alpha**1.35


def _eta(omega: float, p_im: float) -> float:
    return 0.62 + 0.22 * float(np.tanh((p_im - 5e4) / 3e4)) + 0.04 * float(np.sin(omega / 60.0))


def drive(
    duration_s: float, seed: int, *, leak_m2: float = 0.0, restriction: float = 0.0, filling: float = 0.0,
    onset_s: float = ONSET_S, **gains: float,
) -> pd.DataFrame:  # fmt: skip
    """A recording with the columns and the jitter of a logger at 20 Hz.

    Args:
        duration_s: length [s]; seed: of driving and noise.
        leak_m2: hole of the intake manifold [m2].
        restriction, filling: relative changes of the throttle's area and of the cylinders' filling [-].
        onset_s: since when all of them act [s].
        gains: column -> relative error of its sensor.
    """
    rng = np.random.default_rng(seed)
    n = int(duration_s * RATE_HZ)
    time = np.arange(n) / RATE_HZ + rng.uniform(-3e-4, 3e-4, n)
    time[0] = 0.0
    alpha, omega = np.empty(n), np.empty(n)
    at = 0
    while at < n:
        idle = rng.random() < 0.3
        length = int(rng.uniform(15, 30) * RATE_HZ) if idle else int(rng.uniform(3, 12) * RATE_HZ)
        alpha[at : at + length] = rng.uniform(1.6, 2.8) if idle else rng.uniform(3.0, 18.0)
        omega[at : at + length] = rng.uniform(85.0, 115.0) if idle else rng.uniform(120.0, 300.0)
        at += length
    throttle, speed, times = alpha.tolist(), omega.tolist(), time.tolist()  # Python's floats: half the time
    a, w, p_im, p_ic = throttle[0], speed[0], 3e4, 1e5
    T, p_amb = 298.0, 1.0e5
    root = sqrt(R * T)
    rows = np.empty((n, 5))
    for k in range(n):
        since = times[k] >= onset_s
        leak = leak_m2 if since else 0.0
        open_area, filled = (1.0 + restriction, 1.0 + filling) if since else (1.0, 1.0)
        for _ in range(5):
            h = 0.2 / RATE_HZ
            a += (throttle[k] - a) * h / 0.15
            w += (speed[k] - w) * h / 1.5
            flow = p_ic / root * open_area * _area(a) * _psi(p_im / p_ic)
            inward = leak / root * (p_amb * _psi(p_im / p_amb) - p_im * _psi(p_amb / p_im)) if leak else 0.0
            cylinder = filled * _eta(w, p_im) * V_D * w / (4 * np.pi) * p_im / (R * T)
            boost = 1e5 * (1.0 + 6.0 * max(flow - 0.004, 0.0))
            rise = (boost - p_ic) / 0.4
            p_ic += h * rise
            p_im += h * R * T / V_IM * (flow + inward - cylinder)
        rows[k] = a, w, p_im, p_ic, flow + V_IC / (R * T) * rise
    noise = rng.standard_normal((n, 5)) * np.array([0.02, 0.3, 250.0, 30.0, 2e-5])
    level = np.cumsum(rng.standard_normal(n)) * 2e-5  # the air-flow sensor drifts a little
    read = rows + noise
    frame = pd.DataFrame({
        "time_s": time, "p_ic_Pa": read[:, 3], "T_ic_K": T, "p_im_Pa": read[:, 2],
        "W_af_kg_s": read[:, 4] * (1 + 0.004 * rng.standard_normal()) * np.exp(level), "omega_e_rad_s": read[:, 1],
        "alpha_th_pct": read[:, 0], "u_wg_frac": 0.5, "W_fc_kg_s": 1e-3, "p_amb_Pa": p_amb, "T_amb_K": T,
    })
    for column, gain in gains.items():
        frame.loc[frame.time_s >= onset_s, column] *= 1.0 + gain
    return frame
