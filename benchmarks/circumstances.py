"""Discovery on machines whose recording doesn't say what it was made under: weather, altitude, clocks of the channels.

    python benchmarks/circumstances.py OUT.jsonl --healthy 100 --faulty 100 --seed 8101 [--seconds 600] [--shift 0.3]
                                       [--told nothing columns] [--cases "healthy 3" "faulty 10"] [--reference 20]

Every machine of the benchmark's main tier stands at 0 to 2000 m and -15 to 40 degC, its charge air follows the weather
a little, and every channel is recorded up to `--shift` seconds late or early; ambient columns are left out ("nothing").
Beside it the same machine is judged with its ambient columns and all channels in time ("columns"). Healthy and faulty
machines take turns, so that a run that is stopped has as many of both. One line a judgement is appended, and lines that
are there aren't made again; the last lines printed are the counts.

With `--reference MINUTES` every machine has maps of its own, off by 2 %, and is worn since it was recorded for so long
when it was well: in pieces of at most ten minutes, each at a height and in weather of its own, by the same sensors and
the same logger, whose clocks are off alike. What isn't said of the case isn't said of the reference. The engine is
learned from it (`dt.learn`), the case judged by what was learned, and health since the reference is counted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from kept import keep, kept_lines

from dieseltwin.api.learning import known_engine
from dieseltwin.challenge.cases import HEALTH_SPREAD, MAP_RMS, Plan, draw_fault, make_plans
from dieseltwin.challenge.driving import INPUTS, Driving
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.own_engine import TIERS, draw_health, reference_drivings, same_sensors, worn
from dieseltwin.challenge.plant import PlantRun, run_plant
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
TOLD = ("nothing", "columns")
WEATHER = ("p_amb_pa", "t_amb_k", "t_im_k")
INTERVAL_STD = 1.645  # of a 90 % interval
SEA_LEVEL_PA, SEA_LEVEL_K, LAPSE_K_M, EXPONENT = 101325.0, 288.15, 0.0065, 5.2559  # ICAO standard atmosphere


@dataclass(frozen=True)
class Logger:
    """What records a machine: its sensors, and by how much each channel is late [s]."""

    sensors: SensorSet
    shifts: dict[str, float]


@dataclass(frozen=True)
class Machine:
    """Recordings of one machine by what they say ("columns", "nothing"), those of when it was well, and the truth."""

    recordings: dict[str, Recording]
    references: dict[str, list[Recording]]
    truth: dict[str, Any]


def machine_of(plan: Plan, seed: int, seconds: float, shift_s: float, reference_s: float = 0.0) -> Machine:
    """One machine, recorded.

    Args:
        plan: kind and effects; seed: of everything random.
        seconds: length of the recording [s]; shift_s: largest time by which a channel is late or early [s].
        reference_s: length of what was recorded when it was well [s]; 0 for none, and for maps that are nearly right.
    """
    rng = np.random.default_rng([seed, plan.number])
    well_rng = np.random.default_rng([seed, plan.number, 1])  # of its own: the same machine with and without it
    laboratory = we2011.PARAMETERS.model_dump()
    parameters = dict(laboratory)
    well, wear = parameters, dict[str, float]()
    for name, spread in HEALTH_SPREAD.items():
        parameters[name] = laboratory[name] * (1.0 + rng.uniform(-spread, spread))
    if reference_s:
        well, wear = draw_health(laboratory, well_rng)
        parameters = worn(well, wear)
    height, parameters = _somewhere(parameters, laboratory, rng)
    maps = MapErrors.draw(TIERS["own-engine"] if reference_s else MAP_RMS["main"], rng)
    sensors = SensorSet.draw(rng)
    coarse = draw_driving(plan.route, seconds, laboratory, rng)
    faults = tuple(draw_fault(name, plan, coarse, rng, k) for k, name in enumerate(plan.effects))
    logger = Logger(sensors, {name: float(rng.uniform(-shift_s, shift_s)) for name in (*INPUTS, *SENSORS)})
    run, fine = _driven(coarse, parameters, faults, maps)
    recordings = _recorded(coarse, fine, run, faults, logger, parameters, rng)
    references: dict[str, list[Recording]] = {kind: [] for kind in TOLD}
    for driving in reference_drivings(reference_s, laboratory, well_rng):
        _, then = _somewhere(well, laboratory, well_rng)
        before, fine = _driven(driving, then, (), maps)
        there = replace(logger, sensors=same_sensors(sensors, run, before))
        for told, source in _recorded(driving, fine, before, (), there, then, well_rng).items():
            references[told].append(source)
    true = {"p_amb_pa": parameters["p_amb"], "t_amb_k": parameters["T_amb"], "t_im_k": parameters["T_im"],
            "height_m": height, **{f"time_shift:{name}": value for name, value in logger.shifts.items()}}  # fmt: skip
    truth = {"true": true, "effects": [_said(fault) for fault in faults]}
    return Machine(recordings, references, {**truth, **({"since_reference": wear} if wear else {})})


def _said(fault: Fault) -> dict[str, Any]:
    return {"name": fault.effect, "magnitude": fault.magnitude}


def _somewhere(
    parameters: dict[str, Any], laboratory: dict[str, Any], rng: np.random.Generator
) -> tuple[float, dict[str, Any]]:
    """A height [m], and the engine in the weather there."""
    height = rng.uniform(*ALTITUDE_M)
    p_amb = SEA_LEVEL_PA * (1.0 - LAPSE_K_M * height / SEA_LEVEL_K) ** EXPONENT + WEATHER_PA * rng.standard_normal()
    t_amb = rng.uniform(*AMBIENT_K)
    t_im = laboratory["T_im"] + CHARGE_SHARE * (t_amb - laboratory["T_amb"]) + CHARGE_STD_K * rng.standard_normal()
    return height, parameters | {"p_amb": p_amb, "T_amb": t_amb, "T_im": t_im}


def _driven(
    coarse: Driving, parameters: dict[str, Any], faults: tuple[Fault, ...], maps: MapErrors
) -> tuple[PlantRun, Driving]:
    """The plant between the rows of a recording, and its driving there."""
    fine_s = np.linspace(coarse.time_s[0], coarse.time_s[-1], FINE * (coarse.time_s.size - 1) + 1)
    columns = {name: np.interp(fine_s, coarse.time_s, getattr(coarse, name)) for name in INPUTS}
    fine = Driving(fine_s, **columns, kind=coarse.kind)
    return run_plant(fine, parameters, faults, maps), fine


def _recorded(
    coarse: Driving, fine: Driving, run: PlantRun, faults: tuple[Fault, ...], logger: Logger,
    parameters: dict[str, Any], rng: np.random.Generator,
) -> dict[str, Recording]:  # fmt: skip
    """A recording by what it says: its ambient with all channels in time, or neither."""
    inputs = {name: getattr(fine, name) for name in INPUTS}
    signals = {**inputs, **shown(run, fine, faults, logger.sensors)}
    noise = {
        name: NOISE_REL[k] * signals[name].mean() * ar1(coarse.time_s.size, logger.sensors.rho[k], rng)
        for k, name in enumerate(SENSORS)
    }
    out = {}
    for told in TOLD:
        frame = {"time_s": coarse.time_s}
        for name, values in signals.items():
            late = logger.shifts[name] if told == "nothing" else 0.0
            seen = np.interp(coarse.time_s - late, fine.time_s, values)
            if name in SENSORS:
                seen = quantised(seen + noise[name], FULL_SCALE[SENSORS.index(name)])
            frame[name] = quantised(seen, SPEED_SCALE) if name == "n_e_rpm" else seen
        if told == "columns":
            ambient = {"p_amb_pa": parameters["p_amb"], "t_amb_k": parameters["T_amb"]}
            frame |= {name: np.full(coarse.time_s.size, value) for name, value in ambient.items()}
        out[told] = recording(frame)
    return out


def judge(source: Recording, withhold: tuple[str, ...], references: Sequence[Recording] = ()) -> dict[str, Any]:
    """What discovery says of a recording, by an engine that is learned from the references where there are any."""
    began, processor = time.perf_counter(), time.process_time()
    known = known_engine(None, references, None)[0] if references else None
    learned = time.process_time()
    engine = we2011.PARAMETERS if known is None else known.engine
    document = discover(source, engine, Options(withhold=withhold, law_search=False), known).document
    said = {
        "mismatch": document.mismatch, "effects": [[e.name, *e.equivalent_names] for e in document.effects],
        "magnitudes": [e.magnitude for e in document.effects],
        "circumstances": {c.name: [c.value, c.std, c.off] for c in document.circumstances},
        "health": {name: value.value for name, value in document.health.items()},
        "seconds": time.perf_counter() - began, "processor_s": time.process_time() - processor,
    }  # fmt: skip
    if known is None:
        return said
    since = {name: value.since_reference for name, value in document.health.items()}
    shares = {name: [share.value, share.std] for name, share in since.items() if share is not None}
    return said | {"learn_processor_s": learned - processor, "since_reference": shares}


def counts(rows: list[dict[str, Any]]) -> list[str]:
    """Alarms on healthy machines, names on faulty ones, by what the recordings say; how often intervals hold."""
    lines = []
    for kind in TOLD:
        here = [row for row in rows if row["kind"] == kind]
        healthy, faulty = ([row for row in here if bool(row["effects"]) == state] for state in (False, True))
        alarms = sum(row["said"]["mismatch"] for row in healthy)
        found = sum(row["said"]["mismatch"] for row in faulty)
        named = sum(_named(row) for row in faulty)
        seconds = np.median([row["said"]["processor_s"] for row in here]) if here else float("nan")
        lines.append(f"{kind:8s} alarms {alarms} of {len(healthy)} healthy; {found} found and {named} named of "
                     f"{len(faulty)} faulty; {seconds:.1f} s of processor time in the middle")  # fmt: skip
        held = {name: list(_held(here, name)) for name in (*WEATHER, "time_shift")}
        lines.append("         90 % intervals hold the truth: " + ", ".join(
            f"{name} {sum(inside)} of {len(inside)}" for name, inside in held.items()))  # fmt: skip
        lines += _since_reference(here)
    told = {row["case"]: row for row in rows if row["kind"] == "columns" and row["effects"]}
    both = [(row, told[row["case"]]) for row in rows if row["kind"] == "nothing" and row["case"] in told]
    same = sum(_names(a) == _names(b) for a, b in both)
    unseen = sum(not a["said"]["mismatch"] and b["said"]["mismatch"] for a, b in both)
    lines.append(f"of {len(both)} faulty judged both ways: {same} say the same, {unseen} show nothing where nothing is "
                 f"told, {len(both) - same - unseen} say something else")  # fmt: skip
    return lines


def _since_reference(rows: list[dict[str, Any]]) -> list[str]:
    """Health since the reference: median errors, and how often intervals hold the truth."""
    off: dict[str, list[tuple[float, bool]]] = {}
    for row in rows:
        for name, (value, std) in row["said"].get("since_reference", {}).items():
            error = value - row["since_reference"][name]
            off.setdefault(name, []).append((abs(error), abs(error) <= INTERVAL_STD * std))
    middle = {name: 100.0 * np.median([error for error, _ in pairs]) for name, pairs in off.items()}
    return [f"         {name} since the reference: {middle[name]:.2f} % off in the middle, "
            f"{sum(inside for _, inside in pairs)} of {len(pairs)} inside 90 %"
            for name, pairs in off.items()]  # fmt: skip


def _names(row: dict[str, Any]) -> set[str]:
    return {name for names in row["said"]["effects"] for name in names}


def _named(row: dict[str, Any]) -> bool:
    return {effect["name"] for effect in row["effects"]} <= _names(row)


def _held(rows: list[dict[str, Any]], name: str) -> Iterator[bool]:
    """Whether the intervals of one circumstance, or of all clocks, hold the truth.

    Shifts count from the clocks that are trusted, from the middle one of them; where none is, from the middle of all.
    """
    for row in rows:
        said = row["said"]["circumstances"]
        wanted = {key: value for key, value in said.items() if key == name or key.startswith(f"{name}:")}
        true = {key: row["true"][key] if row["kind"] == "nothing" or key in WEATHER else 0.0 for key in wanted}
        if name == "time_shift" and row["kind"] == "nothing":
            trusted = {key: late for key, late in row["true"].items() if key.startswith(name) and key not in wanted}
            middle = float(np.median(list((trusted or true).values())))
            true = {key: value - middle for key, value in true.items()}
        yield from (abs(value - true[key]) <= INTERVAL_STD * std for key, (value, std, _) in wanted.items())


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--healthy", type=int, default=12)
    parser.add_argument("--faulty", type=int, default=12)
    parser.add_argument("--seed", type=int, default=8101)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--shift", type=float, default=0.3)
    parser.add_argument("--told", nargs="+", choices=TOLD, default=TOLD, help="judge with this told")
    parser.add_argument("--cases", nargs="+", help='these alone, such as "healthy 3"')
    parser.add_argument("--reference", type=float, default=0.0, help="minutes of the engine when it was well")
    given = parser.parse_args()
    rows = kept_lines(given.out)
    known = {(row["case"], row["kind"]) for row in rows}
    healthy = make_plans(max(given.healthy, 1), given.seed, healthy_only=True)[: given.healthy]
    faulty = [p for p in make_plans(6 * max(given.faulty, 1), given.seed + 1) if p.kind == "single"][: given.faulty]
    turns = zip_longest(
        [(f"healthy {p.number}", p, given.seed) for p in healthy],
        [(f"faulty {p.number}", p, given.seed + 1) for p in faulty],
    )
    for name, plan, seed in (case for turn in turns for case in turn if case):
        wanted = [kind for kind in given.told if (name, kind) not in known]
        if not wanted or (given.cases and name not in given.cases):
            continue
        machine = machine_of(plan, seed, given.seconds, given.shift, 60.0 * given.reference)
        for kind in wanted:
            said = judge(machine.recordings[kind], plan.withhold, machine.references[kind])
            row = {"case": name, "kind": kind, **machine.truth, "said": said}
            rows.append(row)
            keep(given.out, row)
            print(name, kind, machine.truth["effects"], "->", row["said"]["effects"],
                  f"{row['said']['processor_s']:.0f} s of processor time", flush=True)  # fmt: skip
    print("\n".join(counts(rows)))


if __name__ == "__main__":
    main()
