"""A machine of the benchmarks: the concealed benchmark's plant in a drawn state of health, and its driving."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.challenge.cases import HEALTH_SPREAD, MAP_RMS
from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SENSORS, SensorSet, read, shown
from dieseltwin.engine import we2011


@dataclass(frozen=True)
class DrawnMachine:
    """One machine of the tier "main" and ten minutes or so of random driving.

    Attributes:
        parameters: of the plant by name; health: name -> value, among them.
        maps, sensors: with their errors; driving: inputs (n,) every 0.2 s.
    """

    parameters: dict[str, Any]
    health: dict[str, float]
    maps: MapErrors
    sensors: SensorSet
    driving: Driving

    @classmethod
    def draw(cls, seconds: float, rng: np.random.Generator) -> DrawnMachine:
        """Draw health, maps, sensors and that many seconds of driving, in this order."""
        laboratory = we2011.PARAMETERS.model_dump()
        health = {name: laboratory[name] * (1.0 + rng.uniform(-s, s)) for name, s in HEALTH_SPREAD.items()}
        maps, sensors = MapErrors.draw(MAP_RMS["main"], rng), SensorSet.draw(rng)
        driving = draw_driving("random", seconds, laboratory, rng)
        return cls({**laboratory, **health}, health, maps, sensors, driving)

    def recorded(self, faults: Sequence[Fault], rng: np.random.Generator) -> pd.DataFrame:
        """What its six sensors show with faults, noise and converters included, (n,) columns of a recording."""
        faults = tuple(faults)
        run = run_plant(self.driving, self.parameters, faults, self.maps)
        return read(run, self.driving, faults, self.sensors, len(SENSORS), rng)

    def noiseless(
        self, faults: Sequence[Fault], inputs: pd.DataFrame | Mapping[str, np.ndarray], rate_hz: float
    ) -> dict[str, np.ndarray]:
        """Inputs and readings without noise at a rate, driven with inputs linear between the rows of a table.

        Args:
            faults: of the machine.
            inputs: `time_s` and the columns of `INPUTS`.
            rate_hz: of the result [Hz], a multiple of the driving's 5 Hz.
        """
        coarse_s, faults = self.driving.time_s, tuple(faults)
        time_s = np.linspace(coarse_s[0], coarse_s[-1], round(rate_hz / 5.0) * (coarse_s.size - 1) + 1)
        columns = {column: np.interp(time_s, inputs["time_s"], inputs[column]) for column in INPUTS}
        fine = Driving(time_s, **columns, kind=self.driving.kind)
        run = run_plant(fine, self.parameters, faults, self.maps)
        return {"time_s": time_s, **columns, **shown(run, fine, faults, self.sensors)}
