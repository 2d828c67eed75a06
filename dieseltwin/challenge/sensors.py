"""What the recording shows of the plant: gains and offsets inside the tolerances, AR(1) noise, a 12-bit converter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.plant import PlantRun
from dieseltwin.challenge.plant_effects import Fault, schedule

SENSORS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s")
"""The paper's five and the compressor flow, which the last of `--sensors 6` adds."""

NOISE_REL = (0.03, 0.03, 0.01, 0.05, 0.03, 0.03)  # of the mean of the clean signal (docs/definitions.md)
GAIN_STD = 0.005  # docs/benchmark.md
OFFSET_STD_REL = 0.003  # of the mean
LARGEST_RHO = 0.5
FULL_SCALE = ((0.0, 6e5), (0.0, 8e5), (0.0, 16000.0), (-0.05, 0.35), (200.0, 1300.0), (-0.1, 0.9))  # SI
SPEED_SCALE = (0.0, 2500.0)  # rpm, of the engine speed; the other inputs are the ECU's own numbers
LEVELS = 2**12


@dataclass(frozen=True)
class SensorSet:
    """The sensors of one machine, each array (6,) in the order of `SENSORS`.

    Attributes:
        gain: relative error [-]; offset_rel: of the signal's mean [-]; rho: correlation of neighbouring noise [-].
    """

    gain: np.ndarray
    offset_rel: np.ndarray
    rho: np.ndarray

    @classmethod
    def draw(cls, rng: np.random.Generator) -> SensorSet:
        """Gains and offsets Gaussian, rho uniform (docs/benchmark.md)."""
        n = len(SENSORS)
        return cls(
            GAIN_STD * rng.standard_normal(n), OFFSET_STD_REL * rng.standard_normal(n), rng.uniform(0, LARGEST_RHO, n)
        )

    @classmethod
    def perfect(cls) -> SensorSet:
        """No gain, no offset, white noise."""
        return cls(np.zeros(len(SENSORS)), np.zeros(len(SENSORS)), np.zeros(len(SENSORS)))

    def document(self) -> dict[str, Any]:
        """For the sealed answers."""
        return {name: np.asarray(getattr(self, name)).tolist() for name in ("gain", "offset_rel", "rho")}


def shown(run: PlantRun, driving: Driving, faults: Sequence[Fault], sensors: SensorSet) -> dict[str, np.ndarray]:
    """Readings without noise and before the converter: gains, offsets and faults of the sensors in them."""
    signals = {}
    for k, name in enumerate(SENSORS):
        clean = run["t_read_k" if name == "t_em_k" else name]
        values = clean * (1.0 + sensors.gain[k]) + sensors.offset_rel[k] * clean.mean()
        for fault in faults:
            kind, channel = fault.effect.rsplit("_", 1)[-1], fault.effect.rsplit("_", 1)[0]
            if kind in ("offset", "gain") and name.startswith(f"{channel}_"):
                active = fault.magnitude * schedule(fault, driving.time_s, driving)
                values = values + active if kind == "offset" else values * (1.0 + active)
        signals[name] = values
    return signals


def read(
    run: PlantRun, driving: Driving, faults: Sequence[Fault], sensors: SensorSet, count: int, rng: np.random.Generator
) -> pd.DataFrame:
    """The recording: inputs and the first `count` sensors with noise, through the converter."""
    frame = {name: values for name, values in driving.columns().items()}
    frame["n_e_rpm"] = quantised(driving.n_e_rpm, SPEED_SCALE)
    signals = shown(run, driving, faults, sensors)
    for k, name in enumerate(SENSORS):
        clean = run["t_read_k" if name == "t_em_k" else name]
        noise = NOISE_REL[k] * clean.mean() * ar1(clean.size, sensors.rho[k], rng)
        if k < count:
            frame[name] = quantised(signals[name] + noise, FULL_SCALE[k])
    return pd.DataFrame({name: frame[name] for name in ("time_s", *INPUTS, *SENSORS[:count])})


def ar1(n: int, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Stationary AR(1) noise of unit variance, (n,)."""
    white = rng.standard_normal(n)
    out = np.empty(n)
    out[0] = white[0]
    scale = np.sqrt(1.0 - rho * rho)
    for i in range(1, n):
        out[i] = rho * out[i - 1] + scale * white[i]
    return out


def quantised(values: np.ndarray, full_scale: tuple[float, float]) -> np.ndarray:
    """The nearest of 4096 levels over the full scale."""
    low, high = full_scale
    step = (high - low) / (LEVELS - 1)
    return low + step * np.clip(np.round((values - low) / step), 0, LEVELS - 1)
