"""The baselines' twin: the plant's equations with published maps and no fault, over windows that start anew.

The equations agree with `dieseltwin.engine` (`tests/challenge/test_plant.py`). It can carry a neural correction or
constant biases on the three balances, which the tool's simulator needn't.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.actuators import fine_command, lag
from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import rates
from dieseltwin.challenge.plant_constants import Constants, plant_constants
from dieseltwin.challenge.plant_effects import KERNEL_EFFECTS
from dieseltwin.challenge.sensors import SENSORS
from dieseltwin.inner import inner, kernel
from dieseltwin.recordings.noise import Noise, estimate_noise

STEP_S = 0.01
WINDOW_S = 10.0
EFFECTS = len(KERNEL_EFFECTS)
HIDDEN = 12
NET_INPUTS = 7  # p_im, p_em, omega_t, n_e, u_delta, u_egr, u_vgt


@dataclass(frozen=True)
class Net:
    """One hidden layer of tanh: biases of the three balances over states and inputs.

    Attributes:
        w1 (HIDDEN, 7), b1 (HIDDEN,), w2 (3, HIDDEN), b2 (3,); middle, spread (7,) of the inputs.
    """

    w1: np.ndarray
    b1: np.ndarray
    w2: np.ndarray
    b2: np.ndarray
    middle: np.ndarray
    spread: np.ndarray

    @classmethod
    def zero(cls) -> Net:
        """No correction."""
        return cls(np.zeros((HIDDEN, NET_INPUTS)), np.zeros(HIDDEN), np.zeros((3, HIDDEN)), np.zeros(3),
                   np.zeros(NET_INPUTS), np.ones(NET_INPUTS))  # fmt: skip


@dataclass(frozen=True)
class Bound:
    """The twin bound to a recording of n rows.

    Attributes:
        time_s: (n,); measured: (n, C) readings of `channels`; fine: (4, N + 1) inputs at the integration steps;
        every: steps a row; starts: (W,) first rows of the windows; noise: of the readings; laboratory: parameters.
    """

    time_s: np.ndarray
    measured: np.ndarray
    channels: tuple[int, ...]
    fine: np.ndarray
    every: int
    starts: np.ndarray
    noise: Noise
    laboratory: Mapping[str, Any]

    @classmethod
    def of(cls, frame: pd.DataFrame, laboratory: Mapping[str, Any]) -> Bound:
        """Bind a recording in our column names at equal steps; its ambient where it has one, as the tool reads it."""
        laboratory = dict(laboratory)
        for name, column in (("p_amb", "p_amb_pa"), ("T_amb", "t_amb_k")):
            if column in frame:
                laboratory[name] = float(frame[column].median())
        driving = Driving(*(frame[name].to_numpy(dtype=float) for name in
                            ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")))  # fmt: skip
        sample_s = float(driving.time_s[1] - driving.time_s[0])
        every = round(sample_s / STEP_S)
        fine_s = driving.time_s[0] + STEP_S * np.arange((driving.time_s.size - 1) * every + 1)
        egr = fine_command(fine_s, driving, "egr", laboratory["tau_degr"], ())
        vgt = fine_command(fine_s, driving, "vgt", laboratory["tau_dvgt"], ())
        k = laboratory["K_egr"]
        fine = np.stack([
            np.interp(fine_s, driving.time_s, driving.n_e_rpm), np.interp(fine_s, driving.time_s, driving.u_delta_mg),
            k * lag(egr, STEP_S, laboratory["tau_egr1"]) - (k - 1.0) * lag(egr, STEP_S, laboratory["tau_egr2"]),
            lag(vgt, STEP_S, laboratory["tau_vgt"]),
        ])  # fmt: skip
        channels = tuple(k for k, name in enumerate(SENSORS) if name in frame)
        measured = frame[[SENSORS[k] for k in channels]].to_numpy(dtype=float)
        starts = np.arange(0, driving.time_s.size, round(WINDOW_S / sample_s))
        return cls(driving.time_s, measured, channels, fine, every, starts, estimate_noise(measured), laboratory)

    def constants(self, health: Mapping[str, float]) -> Constants:
        """Constants with these health parameters."""
        return plant_constants({**self.laboratory, **health})

    def first_local(self) -> np.ndarray:
        """Initial states of the windows from smoothed readings, (W, 3)."""
        kernel = np.ones(5) / 5.0
        smooth = np.column_stack([
            np.convolve(np.pad(self.measured[:, k], 2, mode="edge"), kernel, mode="valid") for k in range(3)
        ])  # fmt: skip
        return np.ascontiguousarray(smooth[self.starts])

    def simulate(self, health: Mapping[str, float], local: np.ndarray, net: Net | None = None) -> np.ndarray:
        """Readings without noise (n, C)."""
        out = np.empty((self.time_s.size, len(SENSORS)))
        run_windows(self.fine, STEP_S, self.every, self.starts, np.ascontiguousarray(local), self.constants(health),
                    *_tables(), *_weights(net or Net.zero()), out)  # fmt: skip
        return out[:, self.channels]

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Rows (n, C) of a residual -> independent of unit variance, window by window."""
        out = values / self.noise.sigma
        later = np.ones(values.shape[0], dtype=bool)
        later[self.starts] = False
        rho = self.noise.rho
        innovation = values[later] - rho * values[np.flatnonzero(later) - 1]
        out[later] = innovation / (self.noise.sigma * np.sqrt(1.0 - rho**2))
        return out


def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    none = MapErrors.none()
    return none.tables, none.low, none.high


def _weights(net: Net) -> tuple[np.ndarray, ...]:
    return net.w1, net.b1, net.w2, net.b2, net.middle, net.spread


@inner(error_model="numpy")
def correct(y, n_e, u_delta, u_egr, u_vgt, c, T_im, T_em, w1, b1, w2, b2, middle, spread, dy):  # type: ignore[no-untyped-def]
    """Add the net's biases [kg/s, kg/s, W] to the rates."""
    z = (y[0], y[1], y[2], n_e, u_delta, u_egr, u_vgt)
    for j in range(3):
        bias = b2[j]
        for k in range(w1.shape[0]):
            if w2[j, k] != 0.0:
                total = b1[k]
                for m in range(7):
                    total += w1[k, m] * (z[m] - middle[m]) / spread[m]
                bias += w2[j, k] * np.tanh(total)
        if j == 0:
            dy[0] += c.R_a * T_im / c.V_im * bias
        elif j == 1:
            dy[1] += c.R_e * T_em / c.V_em * bias
        else:
            dy[2] += bias / (c.J_t * y[2])


@kernel(error_model="numpy", nogil=True)
def run_windows(fine, step, every, starts, local, c, tables, low, high, w1, b1, w2, b2, middle, spread, out):  # type: ignore[no-untyped-def]
    """Heun's method from window to window; out (n, 6) in the order of `SENSORS`."""
    e = np.zeros(EFFECTS)
    y, guess, dy_0, dy_1 = np.zeros(4), np.zeros(4), np.empty(4), np.empty(4)
    carry, row, scratch = np.empty(3), np.empty(23), np.empty(23)
    window = 0
    once, twice, until_settled = np.int64(1), np.int64(2), np.int64(12)  # no numbers: `plant._integrate` says why
    for i in range(out.shape[0]):
        at = i * every
        sweeps = twice
        if window < starts.size and i == starts[window]:
            y[0], y[1], y[2], y[3] = local[window, 0], local[window, 1], local[window, 2], 600.0
            carry[0], carry[1], carry[2] = 0.03, 310.0, c.T_im
            window += 1
            sweeps = until_settled
        for k in range(every):
            m = at + k
            n_e, u_d, u_e, u_v = fine[0, m], fine[1, m], fine[2, m], fine[3, m]
            rates(y, carry, n_e, u_d, u_e, u_v, c, e, tables, low, high, sweeps, dy_0, row)
            sweeps = twice
            if k == 0:
                for j in range(6):
                    out[i, j] = row[j]
                if i == out.shape[0] - 1:
                    break
            correct(y, n_e, u_d, u_e, u_v, c, row[9], row[4], w1, b1, w2, b2, middle, spread, dy_0)
            for j in range(4):
                guess[j] = y[j] + step * dy_0[j]
            n_e, u_d, u_e, u_v = fine[0, m + 1], fine[1, m + 1], fine[2, m + 1], fine[3, m + 1]
            rates(guess, carry, n_e, u_d, u_e, u_v, c, e, tables, low, high, once, dy_1, scratch)
            correct(guess, n_e, u_d, u_e, u_v, c, scratch[9], scratch[4], w1, b1, w2, b2, middle, spread, dy_1)
            for j in range(3):
                y[j] += 0.5 * step * (dy_0[j] + dy_1[j])
            y[3] = row[4]
            y[0] = min(max(y[0], 0.5 * c.p_amb), 10.0 * c.p_amb)
            y[1] = min(max(y[1], 0.5 * c.p_amb), 20.0 * c.p_amb)
            y[2] = min(max(y[2], 10.5), 2e4)
