"""Discovery on machines whose recording doesn't say what it was made under: weather, altitude, clocks of the channels.

    python benchmarks/circumstances.py OUT.jsonl --healthy 12 --faulty 12 --seed 8101 [--seconds 600] [--shift 0.3]

Every machine of the benchmark's main tier stands at 0 to 2000 m and -15 to 40 degC, its charge air follows the weather
a little, and every channel is recorded up to `--shift` seconds late or early; ambient columns are left out. Beside it
the same machine is judged with its ambient columns and all channels in time. One line a judgement is appended, and
lines that are there aren't made again; the last lines printed are the counts.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from kept import keep, kept_lines

from dieseltwin.challenge.cases import HEALTH_SPREAD, MAP_RMS, Plan, draw_fault, make_plans
from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import (
    FULL_SCALE,
    NOISE_REL,
    SENSORS,
    SPEED_SCALE,
    SensorSet,
    ar1,
    quantised,
    shown,
)
from dieseltwin.discovery.discover import Options, discover
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import Recording, recording

ALTITUDE_M = (0.0, 2000.0)
AMBIENT_K = (258.15, 313.15)
WEATHER_PA = 1000.0  # standard deviation at one place
CHARGE_SHARE, CHARGE_STD_K = 0.25, 2.0  # of the weather's temperature that reaches the charge air, and the rest
FINE = 8  # samples of the plant between two rows of the recording
SEA_LEVEL_PA, SEA_LEVEL_K, LAPSE_K_M, EXPONENT = 101325.0, 288.15, 0.0065, 5.2559  # ICAO standard atmosphere


def machine_of(plan: Plan, seed: int, seconds: float, shift_s: float) -> tuple[dict[str, Recording], dict[str, Any]]:
    """Recordings of one machine by what they say ("columns", "nothing"), and what was true.

    Args:
        plan: kind and effects; seed: of everything random.
        seconds: length of the recording [s]; shift_s: largest time by which a channel is late or early [s].
    """
    rng = np.random.default_rng([seed, plan.number])
    laboratory = we2011.PARAMETERS.model_dump()
    parameters = dict(laboratory)
    for name, spread in HEALTH_SPREAD.items():
        parameters[name] = laboratory[name] * (1.0 + rng.uniform(-spread, spread))
    height = rng.uniform(*ALTITUDE_M)
    p_amb = SEA_LEVEL_PA * (1.0 - LAPSE_K_M * height / SEA_LEVEL_K) ** EXPONENT + WEATHER_PA * rng.standard_normal()
    t_amb = rng.uniform(*AMBIENT_K)
    t_im = laboratory["T_im"] + CHARGE_SHARE * (t_amb - laboratory["T_amb"]) + CHARGE_STD_K * rng.standard_normal()
    parameters |= {"p_amb": p_amb, "T_amb": t_amb, "T_im": t_im}
    maps, sensors = MapErrors.draw(MAP_RMS["main"], rng), SensorSet.draw(rng)
    coarse = draw_driving(plan.route, seconds, laboratory, rng)
    faults = tuple(draw_fault(name, plan, coarse, rng, k) for k, name in enumerate(plan.effects))
    shifts = {name: float(rng.uniform(-shift_s, shift_s)) for name in (*INPUTS, *SENSORS)}
    fine_s = np.linspace(coarse.time_s[0], coarse.time_s[-1], FINE * (coarse.time_s.size - 1) + 1)
    columns = {name: np.interp(fine_s, coarse.time_s, getattr(coarse, name)) for name in INPUTS}
    fine = Driving(fine_s, **columns, kind=coarse.kind)
    signals = {**columns, **shown(run_plant(fine, parameters, faults, maps), fine, faults, sensors)}
    noise = {
        name: NOISE_REL[k] * signals[name].mean() * ar1(coarse.time_s.size, sensors.rho[k], rng)
        for k, name in enumerate(SENSORS)
    }
    true = {"p_amb_pa": p_amb, "t_amb_k": t_amb, "t_im_k": t_im, "height_m": height,
            **{f"time_shift:{name}": value for name, value in shifts.items()}}  # fmt: skip
    recordings = {
        "columns": _recorded(coarse.time_s, fine_s, signals, noise, {}, {"p_amb_pa": p_amb, "t_amb_k": t_amb}),
        "nothing": _recorded(coarse.time_s, fine_s, signals, noise, shifts, {}),
    }
    return recordings, {"true": true, "effects": [_said(fault) for fault in faults]}


def _said(fault: Fault) -> dict[str, Any]:
    return {"name": fault.effect, "magnitude": fault.magnitude}


def _recorded(
    time_s: np.ndarray, fine_s: np.ndarray, signals: dict[str, np.ndarray], noise: dict[str, np.ndarray],
    shifts: dict[str, float], ambient: dict[str, float],
) -> Recording:  # fmt: skip
    frame = {"time_s": time_s}
    for name, values in signals.items():
        seen = np.interp(time_s - shifts.get(name, 0.0), fine_s, values)
        if name in SENSORS:
            seen = quantised(seen + noise[name], FULL_SCALE[SENSORS.index(name)])
        frame[name] = quantised(seen, SPEED_SCALE) if name == "n_e_rpm" else seen
    frame |= {name: np.full(time_s.size, value) for name, value in ambient.items()}
    return recording(frame)


def judge(source: Recording, withhold: tuple[str, ...]) -> dict[str, Any]:
    """What discovery says of a recording."""
    began = time.perf_counter()
    document = discover(source, we2011.PARAMETERS, Options(withhold=withhold, law_search=False)).document
    return {
        "mismatch": document.mismatch, "effects": [[e.name, *e.equivalent_names] for e in document.effects],
        "magnitudes": [e.magnitude for e in document.effects],
        "circumstances": {c.name: [c.value, c.std, c.off] for c in document.circumstances},
        "health": {name: value.value for name, value in document.health.items()},
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def counts(rows: list[dict[str, Any]]) -> list[str]:
    """Alarms on healthy machines, names on faulty ones, by what the recordings say."""
    lines = []
    for kind in ("columns", "nothing"):
        here = [row for row in rows if row["kind"] == kind]
        healthy, faulty = ([row for row in here if bool(row["effects"]) == state] for state in (False, True))
        alarms = sum(row["said"]["mismatch"] for row in healthy)
        found = sum(row["said"]["mismatch"] for row in faulty)
        named = sum({e["name"] for e in row["effects"]} <= {n for s in row["said"]["effects"] for n in s}
                    for row in faulty)  # fmt: skip
        seconds = np.median([row["said"]["seconds"] for row in here]) if here else float("nan")
        lines.append(f"{kind:8s} alarms {alarms} of {len(healthy)} healthy; {found} found and {named} named of "
                     f"{len(faulty)} faulty; {seconds:.1f} s")  # fmt: skip
    return lines


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--healthy", type=int, default=12)
    parser.add_argument("--faulty", type=int, default=12)
    parser.add_argument("--seed", type=int, default=8101)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--shift", type=float, default=0.3)
    given = parser.parse_args()
    rows = kept_lines(given.out)
    known = {(row["case"], row["kind"]) for row in rows}
    healthy = make_plans(given.healthy, given.seed, healthy_only=True)
    faulty = [p for p in make_plans(6 * given.faulty, given.seed + 1) if p.kind == "single"][: given.faulty]
    cases = [(f"healthy {p.number}", p, given.seed) for p in healthy]
    cases += [(f"faulty {p.number}", p, given.seed + 1) for p in faulty]
    for name, plan, seed in cases:
        if {(name, "columns"), (name, "nothing")} <= known:
            continue
        recordings, truth = machine_of(plan, seed, given.seconds, given.shift)
        for kind, source in recordings.items():
            if (name, kind) not in known:
                row = {"case": name, "kind": kind, **truth, "said": judge(source, plan.withhold)}
                rows.append(row)
                keep(given.out, row)
                print(name, kind, truth["effects"], "->", row["said"]["effects"], f"{row['said']['seconds']:.0f} s",
                      flush=True)  # fmt: skip
    print("\n".join(counts(rows)))


if __name__ == "__main__":
    main()
