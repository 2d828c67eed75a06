"""Recordings of diesel engines that are none of the library's own: the benchmark's plant, its sensors, its driving."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.engine import we2011

HEALTH = {"A_egrmax": 0.90, "A_vgtmax": 1.10, "eta_sc": 0.96, "h_tot": 1.15}
"""Health parameter -> the plant's over the laboratory's value [-]."""

MAP_RMS = 0.003


@dataclass(frozen=True)
class Machine:
    """One engine: its fault, if any, the names that discovery must do without, and how long it is driven."""

    faults: tuple[Fault, ...] = ()
    withhold: tuple[str, ...] = ()
    duration_s: float = 300.0


MACHINES = {
    "leak": Machine((Fault("boost_leak", 4e-5),)),
    "sensor": Machine((Fault("p_em_gain", 0.04),)),
    "healthy": Machine(),
    "withheld": Machine((Fault("boost_leak", 8e-5),), ("boost_leak",), 600.0),  # a law wants more than a name
    "inertia": Machine((Fault("exhaust_thermal_inertia", 10.0),)),
}


def recorded(machine: Machine, seed: int = 1) -> pd.DataFrame:
    """At 5 Hz with six sensors; the same driving, maps and noise whatever the fault."""
    laboratory = we2011.PARAMETERS.model_dump()
    parameters = laboratory | {name: laboratory[name] * share for name, share in HEALTH.items()}
    driving = draw_driving("random", machine.duration_s, laboratory, np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 1)
    maps = MapErrors.draw(MAP_RMS, rng)
    sensors = SensorSet.draw(rng)
    return read(run_plant(driving, parameters, machine.faults, maps), driving, machine.faults, sensors, 6, rng)


def as_logged(table: pd.DataFrame) -> pd.DataFrame:
    """The recording as a logger of several rasters writes it: boost every 0.5 s in steps of 2 kPa, turbo speed every
    second, both repeated until their next reading."""
    held = table.copy()
    time = table["time_s"].to_numpy()
    for column, rate_hz, step in (("p_im_pa", 2.0, 2000.0), ("omega_t_rad_s", 1.0, 0.0)):
        last = np.searchsorted(time, np.floor(time * rate_hz + 1e-9) / rate_hz + 1e-9, side="right") - 1
        values = table[column].to_numpy()[last]
        held[column] = np.round(values / step) * step if step else values
    return held
