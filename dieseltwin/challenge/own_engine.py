"""The own-engine tier: maps that are off and belong to the engine, wear since a reference, each recording its weather.

The same machine is recorded twice: when it was well, as a reference of other driving, and now, worn and perhaps with a
fault. The sensors are the same ones: an offset is the same in their unit, whatever the recording's mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.driving import Driving
from dieseltwin.challenge.map_errors import CORRELATION_LENGTH, MapErrors
from dieseltwin.challenge.plant import PlantRun, run_plant
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SENSORS, SensorSet, read

TIERS: Mapping[str, float] = {
    "own-engine": 0.02, "own-engine-5": 0.05, "own-engine-rough": 0.02, "own-engine-ratio": 0.02,
}  # fmt: skip
"""Tier -> size of the maps' errors, rms [-]."""

CORRELATION: Mapping[str, float] = {"own-engine-rough": 0.5 * CORRELATION_LENGTH}
"""Tier -> their correlation length [of the map's range], where it isn't the usual one."""

OF_RATIO = ("own-engine-ratio",)
"""Tiers in which the turbine's efficiency errs over the blade speed ratio, not over the pressure ratio."""

HEALTH_THEN = {"A_egrmax": 0.15, "A_vgtmax": 0.15, "eta_sc": 0.04, "h_tot": 0.15}  # uniform about the laboratory's
WEAR = {"A_egrmax": (-0.15, 0.05), "A_vgtmax": (-0.15, 0.05), "eta_sc": (-0.04, 0.02), "h_tot": (-0.15, 0.05)}
AMBIENT_PA, AMBIENT_K = 3000.0, 15.0  # uniform about the laboratory's
PIECE_S = 600.0  # of a reference; the last may be shorter
REFERENCE_MIN = 20.0


def draw_health(laboratory: Mapping[str, Any], rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, float]]:
    """Parameters of the engine when it was well, and what became of each health parameter since then [-]."""
    then = dict(laboratory)
    for name, spread in HEALTH_THEN.items():
        then[name] = laboratory[name] * (1.0 + rng.uniform(-spread, spread))
    return then, {name: 1.0 + rng.uniform(*limits) for name, limits in WEAR.items()}


def worn(then: Mapping[str, Any], wear: Mapping[str, float]) -> dict[str, Any]:
    """Parameters of the engine now."""
    return {**then, **{name: then[name] * share for name, share in wear.items()}}


def weather(parameters: Mapping[str, Any], laboratory: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The engine on another day."""
    return {
        **parameters, "p_amb": laboratory["p_amb"] + rng.uniform(-AMBIENT_PA, AMBIENT_PA),
        "T_amb": laboratory["T_amb"] + rng.uniform(-AMBIENT_K, AMBIENT_K),
    }  # fmt: skip


def with_ambient(frame: pd.DataFrame, parameters: Mapping[str, Any]) -> pd.DataFrame:
    """A recording with its ambient columns."""
    return frame.assign(p_amb_pa=parameters["p_amb"], t_amb_k=parameters["T_amb"])


def same_sensors(sensors: SensorSet, first: PlantRun, now: PlantRun) -> SensorSet:
    """The sensors on another recording: offsets that are the same in their unit as on the first."""
    means = [first[name].mean() / now[name].mean() for name in SENSORS]
    return replace(sensors, offset_rel=sensors.offset_rel * np.array(means))


def reference_drivings(
    seconds: float, laboratory: Mapping[str, Any], rng: np.random.Generator
) -> Iterator[Driving]:
    """Driving of a reference, each piece drawn when it is asked for: `PIECE_S` each, random and the WHTC in turns."""
    left = seconds
    for route in cycle(("random", "whtc")):
        if left <= 0.0:
            return
        yield draw_driving(route, min(left, PIECE_S), laboratory, rng)
        left -= PIECE_S


def record_reference(
    then: Mapping[str, Any], laboratory: Mapping[str, Any], maps: MapErrors, sensors: tuple[SensorSet, PlantRun, int],
    minutes: float, rng: np.random.Generator,
) -> tuple[pd.DataFrame, ...]:  # fmt: skip
    """Recordings of the engine when it was well, one of each of `reference_drivings`.

    Args:
        then: its parameters; laboratory: published ones, for the driving and the weather's middle.
        maps: errors of its maps.
        sensors: the set, the recording on which its offsets are stated, and how many of them there are.
        minutes: of all recordings together [min]; rng: the only source of randomness.
    """
    out: list[pd.DataFrame] = []
    for driving in reference_drivings(60.0 * minutes, laboratory, rng):
        today = weather(then, laboratory, rng)
        run = run_plant(driving, today, (), maps)
        frame = read(run, driving, (), same_sensors(sensors[0], sensors[1], run), sensors[2], rng)
        out.append(with_ambient(frame, today))
    return tuple(out)
