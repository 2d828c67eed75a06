"""Regulation schedules and their de-normalisation (UN GTR 4), and what a driver asks of the engine over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
import pandas as pd

from dieseltwin.settings.params import SpeedMapConfig
from dieseltwin.settings.strict import unknown_name

SCHEDULES = ("whtc", "whsc")

# GTR 4, Annex 4, 7.4.6: n_ref = n_norm (0.45 n_lo + 0.45 n_pref + 0.1 n_hi - n_idle) 2.0327 + n_idle
_WEIGHTS_LO_PREF_HI = (0.45, 0.45, 0.10)
_SPEED_SCALE = 2.0327

# docs/definitions.md: greatest torque with lambda >= 1.2, EGR valve closed and at most 250 mg/cycle. The published
# engine at its best VGT position; 600 rpm is smoke-limited, the others are limited by the fuel (tests recompute them).
FULL_LOAD_SPEED_RPM = (600.0, 1000.0, 1300.0, 1600.0, 1900.0)
FULL_LOAD_TORQUE_NM = (1720.0, 2150.0, 2110.0, 2030.0, 1890.0)


@dataclass(frozen=True)
class Schedule:
    """A normalised engine schedule, one row a second.

    Attributes:
        time_s: (n,) [s], 1, 2, ...
        speed_norm_pct, torque_norm_pct: (n,) [%]; the torque is 0 where motored.
        motoring: (n,) bool, the engine is dragged by the vehicle.
    """

    name: str
    time_s: np.ndarray
    speed_norm_pct: np.ndarray
    torque_norm_pct: np.ndarray
    motoring: np.ndarray


@dataclass(frozen=True)
class Demand:
    """What the driver asks for, before the engine's limits.

    Attributes:
        time_s: (n,) [s], equal steps.
        n_e_rpm: (n,) engine speed [rpm].
        torque_nm: (n,) wanted torque [N m]; 0 at idle.
        motoring: (n,) 0 to 1, share of overrun: 1 means no fuel.
        name: where it came from, one name per block, joined by "+".
    """

    time_s: np.ndarray
    n_e_rpm: np.ndarray
    torque_nm: np.ndarray
    motoring: np.ndarray
    name: str = ""


def load_schedule(name: str) -> Schedule:
    """WHTC (1800 s, transient) or WHSC (1895 s, ramped steady modes) of UN GTR 4.

    Raises:
        InputError: another name.
    """
    if name not in SCHEDULES:
        raise unknown_name("schedule", name, SCHEDULES)
    with resources.files("dieseltwin").joinpath(f"data/{name}.csv").open(encoding="utf-8") as file:
        table = pd.read_csv(file)
    motoring = table["motoring"].to_numpy() == 1 if "motoring" in table else np.zeros(len(table), dtype=bool)
    return Schedule(
        name,
        table["time_s"].to_numpy(dtype=np.float64),
        table["speed_norm_pct"].to_numpy(dtype=np.float64),
        table["torque_norm_pct"].to_numpy(dtype=np.float64),
        motoring,
    )


def speed_per_norm(speeds: SpeedMapConfig) -> float:
    """Engine speed per normalised speed [rpm/%] (GTR 4); 11.79 for the speeds of docs/definitions.md."""
    lo, pref, hi = _WEIGHTS_LO_PREF_HI
    reference = lo * speeds.n_lo_rpm + pref * speeds.n_pref_rpm + hi * speeds.n_hi_rpm
    return (reference - speeds.n_idle_rpm) * _SPEED_SCALE / 100.0


def denormalised_speed(speed_norm_pct: np.ndarray, speeds: SpeedMapConfig) -> np.ndarray:
    """Engine speed n_e [rpm] from the normalised speed [%] (GTR 4)."""
    return speeds.n_idle_rpm + speed_per_norm(speeds) * np.asarray(speed_norm_pct, dtype=np.float64)


def full_load_torque(n_e_rpm: np.ndarray) -> np.ndarray:
    """Full-load torque [N m] over engine speed [rpm], linear between the table's points and held outside."""
    return np.interp(n_e_rpm, FULL_LOAD_SPEED_RPM, FULL_LOAD_TORQUE_NM)


def schedule_demand(
    schedule: Schedule, speeds: SpeedMapConfig, first_s: float, last_s: float, step_s: float
) -> Demand:
    """Seconds `first_s` to `last_s` of a schedule, both included, as a demand that starts at 0 s.

    Torque in % is of the full-load torque at the de-normalised speed (GTR 4, 7.4.7); linear between the seconds.
    """
    n_e = denormalised_speed(schedule.speed_norm_pct, speeds)
    torque = schedule.torque_norm_pct / 100.0 * full_load_torque(n_e)
    n = round((last_s - first_s) / step_s) + 1
    time = step_s * np.arange(n)
    at = first_s + time
    return Demand(
        time,
        np.interp(at, schedule.time_s, n_e),
        np.interp(at, schedule.time_s, torque),
        np.interp(at, schedule.time_s, schedule.motoring.astype(np.float64)),
        f"{schedule.name} {first_s:g}-{last_s:g} s",
    )


def joined(blocks: Sequence[Demand], step_s: float, ramp_s: float) -> Demand:
    """Blocks one behind the other with `ramp_s` [s] of linear passage at each joint, inside the later block."""
    columns: dict[str, list[np.ndarray]] = {"n_e_rpm": [], "torque_nm": [], "motoring": []}
    for block in blocks:
        for name, parts in columns.items():
            values = np.array(getattr(block, name))
            if parts:
                start = parts[-1][-1]
                # the row of the joint itself belongs to the earlier block
                weight = np.clip((block.time_s + step_s) / ramp_s, 0.0, 1.0)
                values = start + weight * (values - start)
            parts.append(values)
    joined_columns = {name: np.concatenate(parts) for name, parts in columns.items()}
    time = step_s * np.arange(joined_columns["n_e_rpm"].size)
    return Demand(time, **joined_columns, name=" + ".join(block.name for block in blocks))
