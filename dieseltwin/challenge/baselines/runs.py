"""Run the baselines on a fixed part of a benchmark; bands come from healthy machines of seeds of their own."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.atomic import write_json
from dieseltwin.challenge.baselines import health_only, kalman, neural
from dieseltwin.challenge.baselines.model import Bound, Net
from dieseltwin.challenge.cases import Plan, Tier, build_case, make_plans
from dieseltwin.challenge.processes import in_processes
from dieseltwin.challenge.records import CaseRow
from dieseltwin.challenge.run import read_manifest
from dieseltwin.challenge.seal import SEALED
from dieseltwin.discovery.verdict.explain import plain
from dieseltwin.engine import we2011
from dieseltwin.recordings.named_columns import read_table
from dieseltwin.sealed import read_json, sealed_json

FOLDER = "baselines"
BASELINES = ("health only", "Kalman", "neural")
BAND_CASES, BAND_SEED = 24, 240_711  # healthy machines that the bands are drawn from; no benchmark uses this seed
BAND_FILE = "bands.json"
_OURS = ("a file of `challenge baselines`", "remove it and run that again")
_LEAST_BAND = 1e-9


def run_baselines(
    folder: Path, *, only: Sequence[str] = (), limit: int = 60, jobs: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> int:  # fmt: skip
    """Run every baseline on the first `limit` cases (or `only`); cases with a result are kept. Returns their number."""
    manifest = read_manifest(folder)
    write_bands(folder, jobs=jobs, progress=progress)
    entries = [e for e in manifest["cases"] if not only or e["case"] in only][: None if only else limit]
    pending = [e for e in entries if not (folder / FOLDER / f"{e['case']}.json").is_file()]
    for done, (k, _) in enumerate(in_processes(partial(_of_case, folder), pending, jobs), start=1):
        if progress is not None:
            progress(done, len(pending), str(pending[k]["case"]))
    return len(entries)


def write_bands(folder: Path, *, jobs: int = 1, progress: Callable[[int, int, str], None] | None = None) -> Path:
    """Write the bands beyond which a baseline alarms, unless they are there.

    They are the largest values on 24 healthy machines made in the same way (their own seed): a threshold that an owner
    of healthy machines could set.
    """
    path = folder / FOLDER / BAND_FILE
    if path.is_file():
        return path
    path.parent.mkdir(exist_ok=True)
    manifest = read_manifest(folder)
    plans = make_plans(BAND_CASES, BAND_SEED, sensors=manifest["sensors"], healthy_only=True)
    work = partial(_of_healthy, manifest["tier"], manifest["sensors"], manifest["duration_s"])
    found: list[dict[str, float]] = []
    for _, statistics in in_processes(work, plans, jobs):
        found.append(statistics)
        if progress is not None:
            progress(len(found), len(plans), "healthy, for the bands")
    write_json(path, sealed_json({name: max(one[name] for one in found) for name in found[0]}))
    return path


def _of_healthy(tier: Tier, sensors: int, duration_s: float, plan: Plan) -> dict[str, float]:
    laboratory = we2011.PARAMETERS.model_dump()
    made = build_case(
        plan, BAND_SEED, laboratory, tier=tier, sensors=sensors, duration_s=duration_s, reference_min=0.0
    )
    return dict(one_recording(made.recording, laboratory)["statistics"])


def _of_case(folder: Path, entry: Mapping[str, Any]) -> None:
    found = one_recording(read_table(folder / entry["recording"]), we2011.PARAMETERS.model_dump())
    write_json(folder / FOLDER / f"{entry['case']}.json", sealed_json(plain({"case": entry["case"], **found})))


def one_recording(frame: pd.DataFrame, laboratory: Mapping[str, Any]) -> dict[str, Any]:
    """All three baselines on one recording: statistics, health parameters, the net's weights, seconds of each."""
    start = time.perf_counter()
    bound = Bound.of(frame, laboratory)
    fit = health_only.fit_health(bound)
    statistics = {f"health {name}": value for name, value in health_only.statistics(fit).items()}
    after_fit = time.perf_counter()
    filtered = kalman.filter_biases(bound, fit.health)
    statistics |= {f"bias {name}": value for name, value in kalman.statistics(bound, filtered).items()}
    after_filter = time.perf_counter()
    net = neural.train(bound, fit, filtered)
    first = round(neural.TRAIN_SHARE * bound.time_s.size)
    statistics["net gain"] = neural.gain_per_sample(bound, fit, net, first)
    after_net = time.perf_counter()
    seconds = {"health only": after_fit - start, "Kalman": after_filter - start, "neural": after_net - start}
    return {"statistics": statistics, "health": fit.health, "seconds": seconds,
            "net": {name: value.tolist() for name, value in asdict(net).items()}}  # fmt: skip


def baseline_rows(folder: Path, rows: Sequence[CaseRow]) -> dict[str, list[CaseRow]]:
    """What the baselines say of the cases that they were run on, as rows of the scorer; {} if they were not run."""
    out = folder / FOLDER
    if not (out / BAND_FILE).is_file():
        return {}
    bands = read_json(out / BAND_FILE, *_OURS)
    found: dict[str, list[CaseRow]] = {name: [] for name in BASELINES}
    for row in rows:
        path = out / f"{row.case}.json"
        if not path.is_file():
            continue
        result = read_json(path, *_OURS)
        # a band is never below 0, which is what a perfect twin reaches on average
        over = {name: value / max(bands[name], _LEAST_BAND) for name, value in result["statistics"].items()}
        seconds = result["seconds"]
        silent = replace(
            row, said=(), site=None, law_error=None, p_value=None, problem=None,
            health_after=result["health"], health_before=result["health"], nll_after=row.nll_before,
        )  # fmt: skip
        found["health only"].append(replace(
            silent, mismatch=max(over["health chi2"], over["health whiteness"]) > 1.0, seconds=seconds["health only"]
        ))  # fmt: skip
        biases = {site: over[f"bias {site}"] for site in kalman.SITES}
        worst = max(biases, key=lambda site: biases[site])
        alarm = biases[worst] > 1.0
        found["Kalman"].append(replace(
            silent, mismatch=alarm, site=worst if alarm else None, seconds=seconds["Kalman"]
        ))  # fmt: skip
        gain = _net_gain(folder, row, result)
        found["neural"].append(replace(
            silent, mismatch=over["net gain"] > 1.0, seconds=seconds["neural"],
            nll_after=None if row.nll_before is None else row.nll_before - gain,
        ))  # fmt: skip
    return found if any(found.values()) else {}


def _net_gain(folder: Path, row: CaseRow, result: dict[str, Any]) -> float:
    """Log-likelihood a sample that the net gains on the second recording, kept in the case's file."""
    if "later_gain" not in result:
        laboratory = we2011.PARAMETERS.model_dump()
        bound = Bound.of(read_table(folder / SEALED / f"{row.case}_held_out.csv"), laboratory)
        net = Net(**{name: np.array(value) for name, value in result["net"].items()})
        result["later_gain"] = neural.gain_per_sample(bound, neural.without_net(bound, result["health"]), net, 0)
        write_json(folder / FOLDER / f"{row.case}.json", sealed_json(plain(result)))
    return float(result["later_gain"])
