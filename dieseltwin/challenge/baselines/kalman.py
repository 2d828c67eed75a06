"""Baseline: an extended Kalman filter over p_im, p_em, omega_t and random-walk biases on the three balances."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.challenge.baselines.model import EFFECTS, STEP_S, Bound, _tables
from dieseltwin.challenge.plant import rates
from dieseltwin.inner import kernel

SITES = ("intake_mass_balance", "exhaust_mass_balance", "shaft_power")
"""What a bias points at."""

WALK = np.array([5e-4, 5e-4, 30.0])  # of the biases per root second [kg/s, kg/s, W]
STATE_NOISE = np.array([100.0, 100.0, 2.0])  # per root second [Pa, Pa, rad/s]: rounding of the model
START_STD = np.array([3e3, 3e3, 50.0, 3e-3, 3e-3, 150.0])
SETTLE_S = 20.0  # left out of the statistics
SMOOTHING_S = 10.0


@kernel(error_model="numpy", nogil=True)
def _filter(fine, step, every, measured, channels, sigma, c, tables, low, high, x0, p0, q, out):  # type: ignore[no-untyped-def]
    n, m = measured.shape
    e = np.zeros(EFFECTS)
    x, P = x0.copy(), p0.copy()
    carry = np.array([0.03, 310.0, c.T_im])
    y, guess, dy_0, dy_1 = np.zeros(4), np.zeros(4), np.empty(4), np.empty(4)
    row, scratch = np.empty(23), np.empty(23)
    ends, carried = np.empty((7, 6)), np.empty(3)
    delta = np.array([50.0, 50.0, 2.0, 1e-5, 1e-5, 1.0])
    H, FP, PH, moved = np.zeros((m, 6)), np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    once, sweeps = np.int64(1), np.int64(4)  # no numbers: `plant._integrate` says why
    for i in range(n):
        n_e, u_d, u_e, u_v = fine[0, i * every], fine[1, i * every], fine[2, i * every], fine[3, i * every]
        predicted = np.empty(m)
        for j in range(4):  # reading at the state and its differences by the states
            y[0], y[1], y[2], y[3] = x[0], x[1], x[2], 600.0
            if j > 0:
                y[j - 1] += delta[j - 1]
            for k in range(3):
                carried[k] = carry[k]
            rates(y, carried, n_e, u_d, u_e, u_v, c, e, tables, low, high, sweeps, dy_0,
                  row)  # fmt: skip
            for k in range(m):
                if j == 0:
                    predicted[k] = row[channels[k]]
                else:
                    H[k, j - 1] = (row[channels[k]] - predicted[k]) / delta[j - 1]
        # One reading after another, as their noises are independent: no matrices, whose products take ten seconds to
        # compile.
        for a in range(6):
            moved[a] = 0.0
        for k in range(m):
            innovation, variance = measured[i, k] - predicted[k], sigma[k] ** 2
            for a in range(6):
                innovation -= H[k, a] * moved[a]
                PH[a] = 0.0
                for d in range(6):
                    PH[a] += P[a, d] * H[k, d]
                variance += H[k, a] * PH[a]
            for a in range(6):
                moved[a] += PH[a] * innovation / variance
                for d in range(6):
                    P[a, d] -= PH[a] * PH[d] / variance
        for a in range(6):
            x[a] += moved[a]
        x[0] = min(max(x[0], 0.6 * c.p_amb), 9.0 * c.p_amb)
        x[1] = min(max(x[1], 0.6 * c.p_amb), 19.0 * c.p_amb)
        x[2] = min(max(x[2], 200.0), 1.9e4)
        for j in range(6):
            out[i, j] = x[j]
        if i == n - 1:
            break
        for j in range(7):  # one lane at the state, six beside it
            for k in range(3):
                carried[k] = carry[k]
                y[k] = x[k]
            b0, b1, b2 = x[3], x[4], x[5]
            y[3] = 600.0
            if 1 <= j <= 3:
                y[j - 1] += delta[j - 1]
            elif j == 4:
                b0 += delta[3]
            elif j == 5:
                b1 += delta[4]
            elif j == 6:
                b2 += delta[5]
            for s in range(every):
                k = i * every + s
                rates(y, carried, fine[0, k], fine[1, k], fine[2, k], fine[3, k], c, e, tables, low, high, once,
                      dy_0, row)  # fmt: skip
                dy_0[0] += c.R_a * c.T_im / c.V_im * b0
                dy_0[1] += c.R_e * row[4] / c.V_em * b1
                dy_0[2] += b2 / (c.J_t * y[2])
                for a in range(4):
                    guess[a] = y[a] + step * dy_0[a]
                k += 1
                rates(guess, carried, fine[0, k], fine[1, k], fine[2, k], fine[3, k], c, e, tables, low, high, once,
                      dy_1, scratch)  # fmt: skip
                dy_1[0] += c.R_a * c.T_im / c.V_im * b0
                dy_1[1] += c.R_e * scratch[4] / c.V_em * b1
                dy_1[2] += b2 / (c.J_t * guess[2])
                for a in range(3):
                    y[a] += 0.5 * step * (dy_0[a] + dy_1[a])
                y[0] = min(max(y[0], 0.5 * c.p_amb), 10.0 * c.p_amb)
                y[1] = min(max(y[1], 0.5 * c.p_amb), 20.0 * c.p_amb)
                y[2] = min(max(y[2], 10.5), 2e4)
            ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3], ends[j, 4], ends[j, 5] = y[0], y[1], y[2], b0, b1, b2
            if j == 0:
                for k in range(3):
                    scratch[k] = carried[k]
                kept_0, kept_1, kept_2 = carried[0], carried[1], carried[2]
        F = np.empty((6, 6))
        for j in range(6):
            for k in range(6):
                F[k, j] = (ends[j + 1, k] - ends[0, k]) / delta[j]
        for k in range(6):
            x[k] = ends[0, k]
        for a in range(6):
            for d in range(6):
                FP[a, d] = 0.0
                for k in range(6):
                    FP[a, d] += F[a, k] * P[k, d]
        for a in range(6):
            for d in range(6):
                P[a, d] = q[a] if a == d else 0.0
                for k in range(6):
                    P[a, d] += FP[a, k] * F[d, k]
        carry[0], carry[1], carry[2] = kept_0, kept_1, kept_2


def filter_biases(bound: Bound, health: Mapping[str, float]) -> np.ndarray:
    """Filtered states and biases (n, 6): p_im, p_em [Pa], omega_t [rad/s], biases [kg/s, kg/s, W]."""
    out = np.empty((bound.time_s.size, 6))
    sample_s = float(bound.time_s[1] - bound.time_s[0])
    x0 = np.concatenate([bound.first_local()[0], np.zeros(3)])
    walk = np.concatenate([STATE_NOISE, WALK]) ** 2 * sample_s
    # A copy: an array that may not be written to would be compiled for once more, ten seconds.
    _filter(bound.fine, STEP_S, bound.every, bound.measured.copy(), np.array(bound.channels), bound.noise.sigma,
            bound.constants(health), *_tables(), x0, np.diag(START_STD**2), walk, out)  # fmt: skip
    return out


def statistics(bound: Bound, filtered: np.ndarray) -> dict[str, float]:
    """Root mean square of each bias, smoothed over 10 s [kg/s, kg/s, W]: to be compared with its band."""
    sample_s = float(bound.time_s[1] - bound.time_s[0])
    width = round(SMOOTHING_S / sample_s)
    kernel = np.ones(width) / width
    first = round(SETTLE_S / sample_s)
    return {site: float(np.sqrt(np.mean(np.convolve(filtered[first:, 3 + k], kernel, mode="valid") ** 2)))
            for k, site in enumerate(SITES)}  # fmt: skip
