"""Steps of the flow ``evaluate`` behind the ensembles: members of an ensemble together, tables, the page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dieseltwin.surrogates.files import CLASSES
from tasks.identify import declarations
from tasks.run_context import Progress, step
from tasks.store import scratch

TABLES = ("cells", "beside_paper", "scores", "operators", "bodies", "maps", "calibration", "over_epochs",
          "identifiability", "variants")  # fmt: skip
PAGE = "evaluation.html"
METRICS = "metrics.json"


NETWORKS = ("maps", "operators")  # what everything that follows from a member's states rests on


@step(
    "ensemble", "members together", expected_s=10.0,
    entries=tuple(f"dieseltwin.surrogates.{CLASSES[kind][0]}" for kind in NETWORKS),
)
def ensemble(
    out: Path,
    progress: Progress,
    *,
    field: Path,
    settings: dict[str, Any],
    what: dict[str, Any],
    method: str,
    variant: str,
    epochs: int | None,
    last_epoch: bool,
    kind: str,
    run_times: list[str],
    **given: Path,
) -> None:
    """All batches of one method on one case: ``members.parquet`` and what ``dieseltwin identify`` writes.

    ``given``: the batches, and files of the networks of `NETWORKS` that the method has.

    ``last_epoch``: take the members' estimates from there. ``run_times``: hashes of the batches' runtime.json, which
    are no part of their results' hashes but are shown.
    """
    import json

    import numpy as np

    from dieseltwin.atomic import write_json
    from dieseltwin.engine import HEALTH
    from dieseltwin.identification.bound import IDENTIFIABLE_BELOW, cramer_rao
    from dieseltwin.identification.in_place import InPlace
    from dieseltwin.identification.result import Identification, curves_table
    from dieseltwin.paper.evaluation.ensembles import (
        at_last_epoch,
        load_estimates,
        member_table,
        merged,
        without_diverged,
    )
    from dieseltwin.surrogates.files import load_networks
    from tasks.ensembles import ESTIMATES, problems_for
    from tasks.store import RUNTIME

    problems = problems_for(field, settings, what, what["members"])
    loaded, seconds = [], 0.0
    for name in sorted(given.keys() - NETWORKS):
        times = json.loads((given[name] / RUNTIME).read_text(encoding="utf-8"))
        loaded.append(load_estimates(given[name] / ESTIMATES, times["seconds_per_run"]))
        seconds += times["seconds"]
    starts = {round(problem.t0_s, 6): problem for problem in problems}
    problems = [starts[round(estimate.t0_s, 6)] for estimate in loaded[0]]
    batches = zip(*loaded, strict=True)
    estimates = [merged(of_segment, problem) for of_segment, problem in zip(batches, problems, strict=True)]
    if last_epoch:
        estimates = [at_last_epoch(estimate) for estimate in estimates]
    truth = problems[0].truth
    true = np.array([truth[name] for name in HEALTH])
    bounds = [cramer_rao([problem], true, problem.true_initial[:3])[0].relative for problem in problems]
    member_table(estimates, truth, bounds, what["seed"]).to_parquet(out / "members.parquet", index=False)
    about = {"method": method, "variant": variant, "epochs": epochs, "last_epoch": last_epoch or None, **what}
    write_json(out / "ensemble.json", {key: value for key, value in about.items() if value is not None})
    usable = [without_diverged(estimate, true, bound) for estimate, bound in zip(estimates, bounds, strict=True)]
    known = [i for i, estimate in enumerate(usable) if estimate is not None]
    kept = tuple(estimate for estimate in usable if estimate is not None)
    solved = tuple(problems[i] for i in known)
    learned = InPlace(**load_networks({kind: path for kind, path in given.items() if kind in NETWORKS}))
    found = Identification(method, kept, solved, seconds, IDENTIFIABLE_BELOW, learned)
    runtime = {"seconds": seconds, "seconds_per_run": [estimate.seconds_per_run for estimate in estimates]}
    if known:
        write_json(out / "identification.json", found.to_json())
        found.states.to_parquet(out / "states.parquet", index=False)
        curves = curves_table(found)
        if curves is not None:
            curves = curves.dropna(subset=["value"])  # members that diverged
            curves["segment"] = [known[i] for i in curves["segment"]]
            curves.to_parquet(out / "curves.parquet", index=False)
        runtime = {**found.runtime(), **runtime}
    write_json(out / RUNTIME, runtime)


@step("evaluation-tables", "the paper's tables", expected_s=10.0)
def tables(
    out: Path,
    progress: Progress,
    *,
    errors: Path,
    field: Path,
    bootstrap: int,
    run_times: list[str],
    **parts: Path,
) -> None:
    """One CSV file for each table, and ``metrics.json``. Parts: ensembles, and trainings by labels and number."""
    import json

    import pandas as pd

    from dieseltwin.atomic import write_json
    from dieseltwin.engine import HEALTH
    from dieseltwin.paper.evaluation import tables as evaluation
    from dieseltwin.paper.evaluation.variants import variant_scores
    from tasks.store import RUNTIME

    with _linked(out, {name: path for name, path in parts.items() if name.startswith("ensemble_")}) as folder:
        found = evaluation.load_ensembles(folder)
    clean = pd.read_parquet(field / "case_v_clean.parquet", columns=list(HEALTH))
    truth = {name: float(clean[name].iloc[0]) for name in HEALTH}
    documents: dict[str, list[Any]] = {"clean": [], "noisy": [], "bodies": []}
    for name in sorted(parts):
        if name.startswith("training_"):
            text = (parts[name] / "errors.json").read_text(encoding="utf-8")
            documents[name.split("_")[1]].append(json.loads(text))
    operators, bodies = evaluation.training_errors(documents, documents["bodies"])
    all_cells = evaluation.cells(found)
    beside = evaluation.beside_paper(all_cells)
    maps = []
    for path in sorted(errors.glob("maps_*.json")):
        kind = path.stem.removeprefix("maps_")
        for name, values in json.loads(path.read_text(encoding="utf-8")).items():
            maps.append({"kind": kind, "map": name, "test_pct": values["test"]})
    made = {
        "cells": all_cells,
        "beside_paper": beside,
        "scores": evaluation.scores(beside, found, bootstrap),
        "operators": operators,
        "bodies": bodies,
        "maps": pd.DataFrame(maps, columns=["kind", "map", "test_pct"]),
        "calibration": evaluation.calibration(found),
        "over_epochs": evaluation.over_epochs(found, truth),
        "identifiability": evaluation.identifiability(found),
        "variants": variant_scores(all_cells),
    }
    for name in TABLES:
        made[name].to_csv(out / f"{name}.csv", index=False)
    times = evaluation.run_times(found)
    write_json(out / RUNTIME, {"run_times": json.loads(times.to_json(orient="records"))})
    write_json(out / METRICS, evaluation.metrics(made["scores"], made["calibration"], all_cells))


@contextmanager
def _linked(out: Path, parts: dict[str, Path]) -> Iterator[Path]:
    """A temporary folder with the parts as subfolders."""
    with scratch(out) as temporary:
        for name, path in parts.items():
            (temporary / name).symlink_to(path.resolve(), target_is_directory=True)
        yield temporary


@step("evaluation-page", "page of the evaluation", expected_s=60.0, entries=declarations())
def page(
    out: Path,
    progress: Progress,
    *,
    field: Path,
    common: Path,
    settings: dict[str, Any],
    about: dict[str, Any],
    run_times: list[str],
    **parts: Path,
) -> None:
    """``evaluation.html`` and ``figures/``: tables beside the paper's, and its figures case by case.

    The readings shown are those of a case's first member, whose noise its ``ensemble.json`` names.
    """
    import json

    import pandas as pd

    from dieseltwin.paper.evaluation.page import build_page
    from dieseltwin.report.inputs import write_report_inputs
    from dieseltwin.report.results import load_results
    from tasks.ensembles import problems_for
    from tasks.identify import problems_of
    from tasks.store import RUNTIME

    _, clean = problems_of(field, settings)
    results = {}
    with _linked(out, {}) as folder:
        for name in sorted(parts):
            note = json.loads((parts[name] / "ensemble.json").read_text(encoding="utf-8"))
            if note["variant"] or not (parts[name] / "identification.json").exists():
                continue
            case = folder / note["case"]
            if not case.exists():
                problems = problems_for(field, settings, note, 1)
                write_report_inputs(case, problems, truth_states=clean, about=about)
            (case / note["method"]).symlink_to(parts[name].resolve(), target_is_directory=True)
        for case in sorted(path for path in folder.iterdir() if path.is_dir()):
            results[case.name] = load_results(case)
        tables_read = {}
        for path in sorted(common.glob("*.csv")):
            try:
                tables_read[path.stem] = pd.read_csv(path, keep_default_na=True)
            except pd.errors.EmptyDataError:
                tables_read[path.stem] = pd.DataFrame()
        times = json.loads((common / RUNTIME).read_text(encoding="utf-8"))["run_times"]
        tables_read["run_times"] = pd.DataFrame(times)
        build_page(tables_read, results, out / PAGE, figures_dir=out / "figures", about=about)
