"""Engines with two minutes of reference, judged with and without what others of their type were learned from.

    python benchmarks/siblings.py OUT --engines 6 --seed 71 [--others-min 10] [--reference-min 2] [--minutes 5]

Every engine is the plant of the concealed benchmark's own-engine tier, but the errors of its maps are the type's (80 %
of the variance) and its own. All are learned from `--others-min` minutes. Then each is taken for a new one, of which
`--reference-min` minutes of other driving are known, and judged worn and well, and worn with one fault: with that
reference alone, and with the others as siblings. One line a judgement is appended to OUT/rows.jsonl, and lines that are
there aren't made again; the last lines printed are the counts.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from kept import keep, kept_lines

import dieseltwin as dt
from dieseltwin.challenge.cases import Plan, draw_fault, make_plans
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.own_engine import (
    TIERS,
    draw_health,
    record_reference,
    same_sensors,
    weather,
    with_ambient,
    worn,
)
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.engine import HEALTH, we2011
from dieseltwin.settings.defaults import default_learn

LABORATORY = we2011.PARAMETERS.model_dump()
OF_TYPE, RECORDED, DRIVEN_IN_REFERENCE = 0, 1, 2  # streams of random numbers
INTERVAL_90 = 1.645


def maps_of(number: int, seed: int) -> MapErrors:
    """Errors of an engine's maps: the type's and its own."""
    share, size = default_learn().type_share, TIERS["own-engine"]
    of_type = MapErrors.draw(np.sqrt(share) * size, np.random.default_rng([seed, OF_TYPE]))
    own = MapErrors.draw(np.sqrt(1.0 - share) * size, np.random.default_rng([seed, OF_TYPE, 1 + number]))
    return MapErrors(of_type.tables + own.tables, own.low, own.high)


def record(plan: Plan, number: int, seed: int, minutes: tuple[float, float, float], folder: Path) -> None:
    """Write an engine's recordings: long_*.csv, short_*.csv (references), healthy.csv and faulty.csv, truth.json.

    Args:
        plan: which fault; number, seed: of the engine.
        minutes: of the long reference, of the short one and of each recording that is judged [min].
    """
    rng = np.random.default_rng([seed, RECORDED, number])
    then, wear = draw_health(LABORATORY, rng)
    maps, sensors = maps_of(number, seed), SensorSet.draw(rng)
    driving = draw_driving(plan.route, 60.0 * minutes[2], LABORATORY, rng)
    now = weather(worn(then, wear), LABORATORY, rng)
    faults = tuple(draw_fault(name, plan, driving, rng, k) for k, name in enumerate(plan.effects))
    first = run_plant(driving, now, (), maps)
    folder.mkdir(parents=True, exist_ok=True)
    for name, present in (("healthy", ()), ("faulty", faults)):
        run = run_plant(driving, now, present, maps)
        frame = read(run, driving, present, same_sensors(sensors, first, run), 6, rng)
        with_ambient(frame, now).to_csv(folder / f"{name}.csv", index=False)
    for name, length in (("long", minutes[0]), ("short", minutes[1])):
        for k, frame in enumerate(record_reference(then, LABORATORY, maps, (sensors, first, 6), length, rng)):
            frame.to_csv(folder / f"{name}_{k + 1}.csv", index=False)
    truth = {"wear": wear, "faults": [[fault.effect, fault.magnitude] for fault in faults]}
    (folder / "truth.json").write_text(json.dumps(truth))


def judge(folder: Path, kind: str, engine: Path) -> dict[str, Any]:
    """What is said of a recording with an engine."""
    truth = json.loads((folder / "truth.json").read_text())
    document = dt.discover(folder / f"{kind}.csv", engine).document
    since = {name: document.health[name].since_reference for name in HEALTH}
    said = [[effect.name, *effect.equivalent_names] for effect in document.effects]
    true = {name for name, _ in truth["faults"]} if kind == "faulty" else set()
    return {
        "alarm": document.mismatch, "said": said, "sizes": [effect.magnitude for effect in document.effects],
        "true": truth["faults"] if kind == "faulty" else [],
        "right": document.mismatch == bool(true) and true <= {name for names in said for name in names},
        "off": {n: v.value / truth["wear"][n] - 1.0 for n, v in since.items() if v is not None},
        "std": {n: v.std / truth["wear"][n] for n, v in since.items() if v is not None},
        "smallest": {n: document.minimum_detectable.get(n) for n in ("boost_leak", "exhaust_leak")},
    }  # fmt: skip


def counts(rows: pd.DataFrame) -> list[str]:
    """Alarms, names, errors of health since the reference and how many intervals hold it, a line each way."""
    lines = []
    for way, here in rows.groupby("way"):
        healthy, faulty = here[here["kind"] == "healthy"], here[here["kind"] == "faulty"]
        off = {name: np.array([row[name] for row in here["off"]]) for name in HEALTH}
        std = {name: np.array([row[name] for row in here["std"]]) for name in HEALTH}
        inside = sum(int((np.abs(off[name]) < INTERVAL_90 * std[name]).sum()) for name in HEALTH)
        errors = ", ".join(f"{name} {100 * np.median(np.abs(off[name])):.2g} %" for name in HEALTH)
        leak = 1e6 * np.median([row["exhaust_leak"] for row in here["smallest"]])
        lines.append(f"{way:9s} alarms {healthy['alarm'].sum()} of {len(healthy)} healthy; "
                     f"{faulty['alarm'].sum()} found and {faulty['right'].sum()} named of {len(faulty)}; "
                     f"since the reference, median: {errors}; "
                     f"{inside} of {len(HEALTH) * len(here)} inside 90 %; exhaust leak visible from {leak:.1f} mm2")
    return lines


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--engines", type=int, default=6)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument("--others-min", type=float, default=10.0)
    parser.add_argument("--reference-min", type=float, default=2.0)
    parser.add_argument("--minutes", type=float, default=5.0)
    given = parser.parse_args()
    plans = [plan for plan in make_plans(6 * given.engines, given.seed) if plan.kind == "single"][: given.engines]
    folders = [given.out / f"engine_{number}" for number in range(len(plans))]
    for number, (plan, folder) in enumerate(zip(plans, folders, strict=True)):
        if not (folder / "truth.json").is_file():
            record(plan, number, given.seed, (given.others_min, given.reference_min, given.minutes), folder)
        if not (folder / "long.yaml").is_file():
            dt.learn(sorted(folder.glob("long_*.csv"))).save(folder / "long.yaml")
            print(f"{folder.name} learned", flush=True)
    lines = given.out / "rows.jsonl"
    rows = kept_lines(lines)
    known = {(row["engine"], row["way"], row["kind"]) for row in rows}
    for folder in folders:
        others = [other / "long.yaml" for other in folders if other != folder]
        for way, siblings in (("alone", []), ("siblings", others)):
            engine = folder / f"{way}.yaml"
            if not engine.is_file():
                dt.learn(sorted(folder.glob("short_*.csv")), siblings=siblings).save(engine)
            for kind in ("healthy", "faulty"):
                if (folder.name, way, kind) in known:
                    continue
                rows.append({"engine": folder.name, "way": way, "kind": kind, **judge(folder, kind, engine)})
                keep(lines, rows[-1])
                print(folder.name, way, kind, rows[-1]["true"], "->", rows[-1]["said"], rows[-1]["sizes"], flush=True)
    print("\n".join(counts(pd.DataFrame(rows))))


if __name__ == "__main__":
    main()
