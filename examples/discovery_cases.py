"""Worked cases of discovery: a leak, back-pressure, friction, two effects the catalogue doesn't hold, a healthy engine.

    python examples/discovery_cases.py --out DIR [--cases boost_leak,healthy] [--figures docs/figures]

Each case is a machine of the concealed benchmark's plant (its own equations, maps off by 0.3 %, sensor tolerances,
noise of the paper, 12 bits), driven for ten minutes; `dieseltwin discover` gets the recording alone. The machine's
truth is printed beside what was found, and written nowhere.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dieseltwin.challenge.cases import HEALTH_SPREAD, MAP_RMS, MapErrors, SensorSet, draw_driving
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.sensors import read
from dieseltwin.cli.app import main as command_line
from dieseltwin.discovery.verdict.document import load_discrepancy
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import write_recording

SEED = 20261121
DURATION_S = 600.0
SENSORS = 6  # the paper's five and w_c
SHOWN = {
    "boost_leak": ("minimum_detectable", "health", "law", "evidence_time", "residual_map", "candidates", "score"),
    "back_pressure": ("law", "evidence_map"),
    "healthy": ("residual_map",),
    "withheld_boost_leak": ("law",),
    "withheld_back_pressure": ("law",),
}


@dataclass(frozen=True)
class Worked:
    """One case: its fault, and what the catalogue must do without."""

    name: str
    fault: Fault | None
    withhold: tuple[str, ...] = ()


CASES = (
    Worked("boost_leak", Fault("boost_leak", 2.5e-5)),
    Worked("back_pressure", Fault("back_pressure", 9e4)),
    Worked("bearing_friction", Fault("bearing_friction", 7e-6)),
    Worked("withheld_boost_leak", Fault("boost_leak", 3e-5), ("boost_leak",)),
    Worked("healthy", None),
    Worked("afterburning", Fault("afterburning", 0.05)),  # no catalogue holds it
    Worked("withheld_back_pressure", Fault("back_pressure", 9e4), ("back_pressure",)),
)


def make_recording(case: Worked, path: Path) -> dict[str, float]:
    """Drive the machine of a case, write its recording, return its true health parameters."""
    number = [c.name for c in CASES].index(case.name)
    rng = np.random.default_rng([SEED, number])
    laboratory = we2011.PARAMETERS.model_dump()
    health = {name: laboratory[name] * (1.0 + rng.uniform(-s, s)) for name, s in HEALTH_SPREAD.items()}
    maps, sensors = MapErrors.draw(MAP_RMS["main"], rng), SensorSet.draw(rng)
    driving = draw_driving("random", DURATION_S, laboratory, rng)
    faults = () if case.fault is None else (case.fault,)
    run = run_plant(driving, {**laboratory, **health}, faults, maps)
    write_recording(read(run, driving, faults, sensors, SENSORS, rng), path)
    return health


def main(arguments: list[str] | None = None) -> int:
    """Make, discover and tell the cases; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", default=",".join(case.name for case in CASES))
    parser.add_argument("--figures", type=Path, help="where to copy the figures that docs/discovery-measured.md shows")
    options = parser.parse_args(arguments)
    for case in (case for case in CASES if case.name in options.cases.split(",")):
        folder = options.out / case.name
        folder.mkdir(parents=True, exist_ok=True)
        health = make_recording(case, folder / "recording.csv")
        asked = [str(folder / "recording.csv"), "--out", str(folder)]
        if case.withhold:
            asked += ["--withhold", ",".join(case.withhold)]
        print(f"== {case.name}", flush=True)
        code = command_line(["discover", *asked])
        if code:
            return code
        if options.figures is not None:
            options.figures.mkdir(parents=True, exist_ok=True)
            for name in SHOWN.get(case.name, ()):
                shutil.copyfile(folder / "figures" / f"{name}.svg", options.figures / f"{case.name}_{name}.svg")
        document = load_discrepancy(folder)
        truth = "none" if case.fault is None else f"{case.fault.effect} {case.fault.magnitude:g}"
        print(f"truth: {truth}")
        for name, value in health.items():
            found = document.health[name]
            print(f"  {name}: error {100 * (found.before / value - 1):+.1f} % before, "
                  f"{100 * (found.value / value - 1):+.1f} % after")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
