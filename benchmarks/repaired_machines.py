"""How well `simulate` foretells driving that no fit has seen, with the machine before and after `discover` repaired it.

    python benchmarks/repaired_machines.py [--only diesel,petrol,points,axis,tanks]

One made-up machine of each kind with one planted fault: a boost leak (the benchmark's diesel plant), an air-flow sensor
10 % high (its petrol plant), an exhaust flap (settled points of another engine, held for 40 s each), an axis with dry
friction, tanks that overflow. `discover` sees the first recording, `simulate` runs over another one of the same
machine. Printed are rms errors of each reading: "before" is the machine without what was found and fitted without it
(diesel: `engine_before`; petrol and points: calibrated; rigs: `identify`), "after" is what `discover` wrote.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))

import dieseltwin as dt
from dieseltwin.challenge.petrol_plant import drive
from tests.calibration.simulated import FLAP, GEOMETRY, made_points
from tests.end_to_end.engines import MACHINES, recorded
from tests.end_to_end.test_rigs import RIGS, axis_recording, tanks_recording

HOLD_S = 40
INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "u_flap_pct")
Errors = dict[str, tuple[float, float]]
"""Reading -> rms error before and after."""


def beside(later: pd.DataFrame, before: object, after: object, columns: dict[str, str]) -> Errors:
    """Errors of both machines over later driving; `columns`: of `simulate` -> of the recording."""
    tables = [dt.simulate(later, machine).table() for machine in (before, after)]
    found = {}
    for name, own in columns.items():
        left = [t[name].to_numpy() - later[own].to_numpy() for t in tables]
        found[name] = (float(np.sqrt(np.mean(left[0] ** 2))), float(np.sqrt(np.mean(left[1] ** 2))))
    return found


def diesel(folder: Path) -> tuple[str, Errors]:
    """A boost leak of 0.4 cm2; the later recording is other driving, with errors of maps and sensors drawn anew."""
    found = dt.discover(recorded(MACHINES["leak"]))
    columns = {name: name for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s")}
    return found.sentence, beside(recorded(MACHINES["leak"], 5), found.found.engine_before, found.engine, columns)


def petrol(folder: Path) -> tuple[str, Errors]:
    """An air-flow sensor that reads 10 % high."""
    drive(900.0, 1).to_csv(folder / "healthy.csv", index=False)
    engine = dt.calibrate(folder / "healthy.csv", "liu_petrol").save(folder / "petrol.yaml")
    drive(400.0, 2, W_af_kg_s=0.10).to_csv(folder / "now.csv", index=False)
    found = dt.discover(folder / "now.csv", engine)
    later = drive(400.0, 3, W_af_kg_s=0.10, onset_s=0.0)
    return found.sentence, beside(later, engine, found.engine, {"p_im_pa": "p_im_Pa", "w_af_kg_s": "W_af_kg_s"})


def points(folder: Path) -> tuple[str, Errors]:
    """An exhaust flap; the later points are 40 others."""
    shape = folder / "geometry.yaml"
    shape.write_text("".join(f"{name}: {getattr(GEOMETRY, name)}\n" for name in ("V_d", "r_c", "R_c", "R_t")))
    pd.DataFrame(dict(made_points(noise=0.005, effects=FLAP).columns)).to_csv(folder / "points.csv", index=False)
    engine = dt.calibrate(folder / "points.csv", geometry=shape).save(folder / "engine.yaml")
    found = dt.discover(folder / "points.csv", engine)
    other = pd.DataFrame(dict(made_points(count=40, noise=0.005, seed=11, effects=FLAP).columns))
    held = other.loc[other.index.repeat(HOLD_S)].reset_index(drop=True)
    inputs = held[list(INPUTS)].assign(time_s=np.arange(len(held), dtype=float))
    tables = [dt.simulate(inputs, machine).table() for machine in (engine, found.engine)]
    errors = {}
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_c_kg_s", "t_em_k"):
        left = [t[name].to_numpy()[HOLD_S - 1 :: HOLD_S] - other[name].to_numpy() for t in tables]
        errors[name] = (float(np.sqrt(np.mean(left[0] ** 2))), float(np.sqrt(np.mean(left[1] ** 2))))
    return found.sentence, errors


def rig(name: str, recording: pd.DataFrame, first: int, folder: Path) -> tuple[str, Errors]:
    """The later part of a rig's recording; "before" is fitted by `identify` to the earlier one."""
    early, late = recording.iloc[:first], recording.iloc[first:].reset_index(drop=True)
    early.to_csv(folder / "early.csv", index=False)
    found = dt.discover(folder / "early.csv", RIGS / f"{name}.yaml")
    fitted = dt.identify(folder / "early.csv", engine=RIGS / f"{name}.yaml")
    (column,) = found.engine.readings
    every, skipped = found.engine.every, found.engine.first_rows or 0
    late.to_csv(folder / "late.csv", index=False)
    left = []
    for machine in (fitted.engine, found.engine):
        table = dt.simulate(folder / "late.csv", machine).table()
        measured = late[column].to_numpy()[::every][: len(table)]
        left.append((table[column].to_numpy() - measured)[skipped:])
    return found.sentence, {column: (float(np.sqrt(np.mean(left[0] ** 2))), float(np.sqrt(np.mean(left[1] ** 2))))}


MADE: dict[str, Callable[[Path], tuple[str, Errors]]] = {
    "diesel": diesel, "petrol": petrol, "points": points,
    "axis": lambda folder: rig("positioning_axis", axis_recording(12.0), 8000, folder),
    "tanks": lambda folder: rig("cascaded_tanks", tanks_recording(900), 450, folder),
}  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(MADE))
    print("| machine | reading | before | after |\n|---|---|---|---|")
    for name in parser.parse_args().only.split(","):
        began = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            sentence, errors = MADE[name](Path(folder))
        for reading, (before, after) in errors.items():
            print(f"| {name} | {reading} | {before:.4g} | {after:.4g} |")
        print(f"<!-- {name}: {time.process_time() - began:.0f} s of processor time: {sentence} -->", flush=True)


if __name__ == "__main__":
    main()
