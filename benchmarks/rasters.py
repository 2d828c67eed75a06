"""The same driving at several rates: do the intervals of `identify` hold, and does `discover` name a leak?

    python benchmarks/rasters.py OUT.jsonl [--engines 10] [--page]

`identify` (classical): engines of random health (`datasets.make_validation`), five minutes of random driving, the
paper's noise on every reading, so that more readings say more. Counted are segments whose own bound calls a parameter
identifiable. `discover`: the plant of docs/benchmark.md with a boost leak, ten minutes, maps off by 0.3 %. Boost in
steps: 5 Hz rows in which boost is read at 1 Hz, rounded to 2 kPa and repeated. Lines that are in OUT.jsonl aren't run
again; `--page` writes both tables into docs/formats.md.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawn_machine import DrawnMachine
from kept import keep, kept_lines
from pages import table, write_table

import dieseltwin as dt
from dieseltwin.challenge.driving import INPUTS
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.sensors import NOISE_REL, SENSORS
from dieseltwin.engine import HEALTH
from dieseltwin.paper.datasets import make_validation, simulated
from dieseltwin.settings.params import Params, load_params

FINE_HZ = 50
STEPPED = "5, boost in held steps"
RATES: dict[str, int] = {"50": 50, "20": 20, "10": 10, "5": 5, "2": 2, "1": 1, STEPPED: 5,
                         "2, inputs linear between rows": 2, "1, inputs linear between rows": 1}
LINEAR = "inputs linear between rows"
"""Rates at which the engine was driven by what the rows say: nothing happened in between that isn't recorded."""

BOOST_STEP_PA, BOOST_ROWS = 2000.0, 5
ENGINES_SEED, SEED, LEAK_M2 = 8401, 8201, 2.5e-5
Z_90 = 1.6449


def at_rate(fine: pd.DataFrame, name: str, rng: np.random.Generator) -> pd.DataFrame:
    """The clean recording of 50 Hz as a logger of another rate writes it, noise on every reading (n,) [SI]."""
    every = FINE_HZ / RATES[name]
    rows = np.rint(np.arange(0, len(fine) - 0.5, every)).astype(int)
    made = fine.iloc[rows].reset_index(drop=True)
    for column, share in zip(SENSORS, NOISE_REL, strict=True):
        made[column] += share * fine[column].mean() * rng.standard_normal(len(made))
    if name == STEPPED:
        held = np.arange(len(made)) // BOOST_ROWS * BOOST_ROWS
        made["p_im_pa"] = BOOST_STEP_PA * np.rint(made["p_im_pa"].to_numpy()[held] / BOOST_STEP_PA)
    return made


def inputs_at(name: str, inputs: pd.DataFrame) -> pd.DataFrame:
    """The inputs (n,) that the engine is driven with: those of every row, or linear between the rows of a slow rate."""
    if LINEAR not in name:
        return inputs
    time_s = inputs["time_s"].to_numpy()
    rows = np.arange(time_s[0], time_s[-1] + 1e-9, 1.0 / RATES[name])
    at_rows = {column: np.interp(rows, time_s, inputs[column]) for column in INPUTS}
    return pd.DataFrame({"time_s": time_s, **{c: np.interp(time_s, rows, values) for c, values in at_rows.items()}})


def driven(number: int, name: str, params: Params) -> tuple[pd.DataFrame, dict[str, float]]:
    """Five minutes of an engine of random health at 50 Hz, without noise, and its health."""
    inputs, truth = make_validation(ENGINES_SEED + number, params, duration_s=300.0)
    inputs = inputs_at(name, inputs)
    fine = simulated(inputs, truth, 1.0 / FINE_HZ, params.engine.step_s, oxygen=False)
    columns = ["time_s", *INPUTS, *SENSORS, "p_amb_pa", "t_amb_k"]
    return fine[columns], {name: float(getattr(truth, name)) for name in HEALTH}


def identified(number: int, name: str, params: Params) -> dict[str, Any]:
    """What `identify` says of an engine at a rate: errors [standard deviations] and deviations [-] by segment."""
    fine, truth = driven(number, name, params)
    recorded = at_rate(fine, name, np.random.default_rng([ENGINES_SEED, number, list(RATES).index(name)]))
    began = time.perf_counter()
    found = dt.identify(recorded, runs=1, setup=dt.Setup(fit_test=False)).found.to_json()
    errors: dict[str, list[float]] = {key: [] for key in HEALTH}
    stds: dict[str, list[float]] = {key: [] for key in HEALTH}
    for segment in found["segments"]:
        for key in HEALTH:
            value = segment["parameters"][key]
            if value["identifiable"] and value["mean"] is not None:
                stds[key].append(value["std"] / truth[key])
                errors[key].append((value["mean"] - truth[key]) / value["std"])
    return {"what": "identify", "number": number, "rate": name, "errors": errors, "stds": stds,
            "seconds": time.perf_counter() - began}  # fmt: skip


def leaking(name: str) -> pd.DataFrame:
    """Ten minutes of the benchmark's plant with a leak at 50 Hz, without noise."""
    machine = DrawnMachine.draw(600.0, np.random.default_rng([SEED, 0]))
    inputs = inputs_at(name, pd.DataFrame(machine.driving.columns()))
    return pd.DataFrame(machine.noiseless([Fault("boost_leak", LEAK_M2)], inputs, FINE_HZ))


def discovered(name: str) -> dict[str, Any]:
    """What `discover` says of the leak at a rate."""
    recorded = at_rate(leaking(name), name, np.random.default_rng([SEED, 99, list(RATES).index(name)]))
    began = time.perf_counter()
    document = dt.discover(recorded).document
    return {"what": "discover", "number": 0, "rate": name, "seconds": time.perf_counter() - began,
            "effects": [effect.model_dump(mode="json") for effect in document.effects],
            "smallest": document.minimum_detectable["boost_leak"]}  # fmt: skip


def identify_lines(rows: list[dict[str, Any]]) -> list[str]:
    """Coverage of the 90 % intervals and its error of counting, deviations beside those at 5 Hz, and bias, by rate."""
    here = {name: [row for row in rows if row["what"] == "identify" and row["rate"] == name] for name in RATES}
    shown_rows = []
    for name, found in here.items():
        if not found:
            continue
        errors = {key: np.concatenate([row["errors"][key] for row in found]) for key in HEALTH}
        shares = [np.mean(np.abs(np.concatenate(list(row["errors"].values()))) <= Z_90) for row in found]
        of_count = 100.0 * np.std(shares, ddof=1) / np.sqrt(len(shares))  # errors of an engine go together
        everything = np.concatenate(list(errors.values()))
        paired = [
            np.mean(row["stds"][key]) / np.mean(other["stds"][key]) for row in found for other in here["5"]
            if row["number"] == other["number"] for key in HEALTH if row["stds"][key] and other["stds"][key]
        ]  # fmt: skip
        shown_rows.append([
            name, f"{100.0 * np.mean(np.abs(everything) <= Z_90):.0f} ± {of_count:.0f} % of {everything.size}",
            ", ".join(f"{100.0 * np.mean(np.abs(errors[key]) <= Z_90):.0f}" for key in HEALTH),
            f"{np.mean(paired):.2f}", ", ".join(f"{np.mean(errors[key]):+.1f}" for key in HEALTH),
            f"{np.mean([row['seconds'] for row in found]):.0f} s",
        ])  # fmt: skip
    head = ["Hz", "90 % intervals that hold the truth", f"by parameter ({', '.join(HEALTH)}) [%]",
            "deviation beside 5 Hz", "mean error [deviations]", "time"]  # fmt: skip
    return table(head, shown_rows)


def discover_lines(rows: list[dict[str, Any]]) -> list[str]:
    """What was named at each rate."""
    known = {row["rate"]: row for row in rows if row["what"] == "discover"}
    shown_rows = []
    for row in (known[name] for name in RATES if name in known):
        names = ", ".join(effect["name"].replace("_", " ") for effect in row["effects"]) or "nothing"
        first = row["effects"][0] if row["effects"] else {"magnitude": None}
        size = "" if first["magnitude"] is None else f"{1e6 * first['magnitude']:.1f} ± {1e6 * first['std']:.1f}"
        shown_rows.append([row["rate"], names, size, f"{1e6 * row['smallest']:.1f}", f"{row['seconds']:.0f} s"])
    return table(["Hz", "named", "mm² (true 25)", "smallest visible [mm²]", "time"], shown_rows)


def main() -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--engines", type=int, default=10)
    parser.add_argument("--page", action="store_true", help="write the tables into docs/formats.md")
    given = parser.parse_args()
    rows = kept_lines(given.out)
    known = {(row["what"], row["number"], row["rate"]) for row in rows}
    params = load_params()
    wanted = [("identify", number, name) for number in range(given.engines) for name in RATES]
    wanted += [("discover", 0, name) for name in RATES]
    for what, number, name in (item for item in wanted if item not in known):
        row = discovered(name) if what == "discover" else identified(number, name, params)
        rows.append(row)
        keep(given.out, row)
        print(what, number, name, f"{row['seconds']:.0f} s", flush=True)
    first, second = identify_lines(rows), discover_lines(rows)
    print("\n".join([*first, "", *second]))
    if given.page:
        write_table("formats.md", "table of rates", first)
        write_table("formats.md", "table of rates, discovery", second)


if __name__ == "__main__":
    main()
