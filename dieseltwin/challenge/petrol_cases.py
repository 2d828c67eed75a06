"""Drawn petrol engines: gains, offsets, leak, restriction, less filling, or healthy; 5 to 60 min, half with a gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.petrol_plant import drive

CALIBRATION_S = 1800.0
MINUTES = (5.0, 10.0, 20.0, 30.0, 60.0)
HEALTHY_SHARE = 0.25
FROM_THE_START = 0.4  # of the faults
ONSET_REL = (0.15, 0.6)  # of the duration
GAP_SHARE, GAP_S = 0.5, (1.5, 40.0)
_HEALTHY_DRIVING = 2**30


@dataclass(frozen=True)
class Family:
    """One fault: where it is, its size of interest, the sizes drawn (log-uniform), and how the plant takes it.

    Attributes:
        site, tolerance: as the catalogue has them, written here once more: the plant imports nothing of it.
        sizes: smallest and largest [unit of the effect].
        argument: of the plant; None where `column` is offset afterwards.
        column: that an offset is added to.
        signed: either sign is drawn; else the sign is that of the sizes.
    """

    site: str
    tolerance: float
    sizes: tuple[float, float]
    argument: str | None = None
    column: str | None = None
    signed: bool = False


FAMILIES: Mapping[str, Family] = {
    "p_im_gain": Family("sensor:p_im_pa", 0.02, (0.04, 0.15), "p_im_Pa", signed=True),
    "p_ic_gain": Family("sensor:p_ic_pa", 0.01, (0.02, 0.15), "p_ic_Pa", signed=True),
    "w_af_gain": Family("sensor:w_af_kg_s", 0.02, (0.04, 0.15), "W_af_kg_s", signed=True),
    "p_im_offset": Family("sensor:p_im_pa", 1e3, (2e3, 6e3), column="p_im_Pa", signed=True),
    "w_af_offset": Family("sensor:w_af_kg_s", 1e-4, (2e-4, 6e-4), column="W_af_kg_s"),
    "intake_leak": Family("intake_mass_balance", 5e-7, (1e-6, 2e-5), "leak_m2"),
    "throttle_area_change": Family("throttle_flow", 0.03, (-0.06, -0.3), "restriction"),
    "volumetric_efficiency_change": Family("cylinder_flow", 0.03, (-0.06, -0.2), "filling"),
}


def draw_healthy(seed: int) -> pd.DataFrame:
    """What the engine is calibrated on."""
    return drive(CALIBRATION_S, int(np.random.default_rng([seed, _HEALTHY_DRIVING]).integers(1 << 30)))


def draw_petrol(number: int, seed: int, *, healthy: bool = False) -> tuple[pd.DataFrame, dict[str, Any]]:
    """A recording and its answers.

    Args:
        number: of the case, from 1 on; seed: of the benchmark.
        healthy: nothing is wrong in any.
    """
    rng = np.random.default_rng([seed, number])
    duration = 60.0 * float(rng.choice(MINUTES))
    faulty = rng.random() >= HEALTHY_SHARE and not healthy
    effect = str(rng.choice(list(FAMILIES)))
    onset = None if rng.random() < FROM_THE_START else float(rng.uniform(*ONSET_REL) * duration)
    family = FAMILIES[effect]
    low, high = np.abs(family.sizes)
    size = float(np.sign(family.sizes[0]) * np.exp(rng.uniform(np.log(low), np.log(high))))
    size *= -1.0 if family.signed and rng.random() < 0.5 else 1.0
    acting = {family.argument: size} if faulty and family.argument is not None else {}
    table = drive(duration, int(rng.integers(1 << 30)), onset_s=onset or 0.0, **acting)
    if faulty and family.column is not None:
        table.loc[table["time_s"] >= (onset or 0.0), family.column] += size
    gap = None
    if rng.random() < GAP_SHARE:
        start = float(rng.uniform(0.1, 0.9) * duration)
        gap = (start, start + float(rng.uniform(*GAP_S)))
        table = table[~table["time_s"].between(*gap)]
    answers = {
        "case": f"case_{number:04d}", "kind": "single" if faulty else "healthy", "withhold": [], "route": "drawn",
        "partial": "onset" if faulty and onset is not None else None, "duration_s": duration, "gap_s": gap,
        "onset_s": onset if faulty else None,
        "effects": [{"effect": effect, "magnitude": size}] if faulty else [],
    }  # fmt: skip
    return table, answers
