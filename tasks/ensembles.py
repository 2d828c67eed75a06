"""Ensembles behind the paper's tables: one cached step for each method, case and batch of members.

A kill loses the batch that was running. A member's draws (start, networks, dropout, noise) depend on the seed, the
segment and its number alone, so the size of the batches changes nothing but rounding.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dieseltwin.settings.methods import find, in_order
from tasks.identify import rests_on
from tasks.run_context import Progress, Step, step
from tasks.store import RUNTIME

ESTIMATES = "estimates.npz"
SOURCES = "sources.npz"


def _clean_problems(field: Path, settings: dict[str, Any]) -> list[Any]:
    """Segments of the clean field recording, with true initial states, truth, and the noise of the recording."""
    from dataclasses import replace

    import numpy as np

    from dieseltwin.paper.datasets import MEASURED
    from tasks.identify import problems_of

    known, clean = problems_of(field, settings)
    rows = np.searchsorted(clean["time_s"], [problem.t0_s - 1e-6 for problem in known])
    made = []
    for problem, row in zip(known, rows, strict=True):
        readings = clean[list(MEASURED)].to_numpy()[row : row + len(problem.time_s)].copy()
        readings[np.isnan(problem.measured).all(axis=0)[None].repeat(len(readings), 0)] = np.nan
        made.append(replace(problem, measured=readings, noise_draws=None))
    return made


def problems_for(field: Path, settings: dict[str, Any], what: dict[str, Any], members: int) -> list[Any]:
    """The segments of one case. ``what``: case, noise_seed, channels."""
    from dieseltwin.paper.evaluation.ensembles import case_problems

    return case_problems(
        _clean_problems(field, settings), what["case"], members, what["noise_seed"], what.get("channels")
    )


def _config(settings: dict[str, Any], method: str, what: dict[str, Any]) -> Any:
    """``IdentifyConfig`` with what this ensemble changes of the start and of the method's own settings."""
    from dieseltwin.settings.evaluation import NOT_READ_BY_ALL
    from dieseltwin.settings.methods import find
    from dieseltwin.settings.params import StartConfig
    from tasks.identify import _config as read

    config = read(settings)
    start = StartConfig(**{**config.start.model_dump(), "at": what["start"]})
    named = [name for name in NOT_READ_BY_ALL if name != "start" and name in find(method).varied]
    changed = {name: what[name] for name in named if what[name] is not None}
    return config.model_copy(update={"start": start}).changed(method, **changed)


def _write(out: Path, estimates: list[Any], seconds: float) -> None:
    import json

    from dieseltwin.paper.evaluation.ensembles import save_estimates

    save_estimates(out / ESTIMATES, estimates)
    times = {"seconds": seconds, "seconds_per_run": [estimate.seconds_per_run for estimate in estimates]}
    (out / RUNTIME).write_text(json.dumps(times) + "\n", encoding="utf-8")


@step(
    "ensemble-baseline",
    "ensemble, baseline PINN",
    expected_s=300.0,
    entries=rests_on(find("baseline")),
)
def baseline(
    out: Path,
    progress: Progress,
    *,
    method: str,
    field: Path,
    maps: Path,
    operators: Path,
    settings: dict[str, Any],
    what: dict[str, Any],
    kind: str,
) -> None:
    """The first segment from scratch; its networks are the source models of multi-stage (``sources.npz``)."""
    import time

    import numpy as np

    from dieseltwin.paper.loops.baseline import METHOD
    from dieseltwin.paper.loops.pinn_training import estimates_of, make_lanes, settings_of, train_lanes
    from dieseltwin.surrogates.files import load_networks

    problems = problems_for(field, settings, what, what["members"])
    config = _config(settings, METHOD, what)
    chosen = settings_of(config, METHOD)
    given = load_networks({"maps": maps, "operators": operators})
    began = time.perf_counter()
    lanes = make_lanes(problems, [0], what["runs"], what["seed"], config.start, what["first"])
    found = train_lanes(lanes, given["operators"], given["maps"], chosen)
    share, below = chosen.average_share, config.identifiable_bound_rel
    estimates = estimates_of(problems[:1], found, what["runs"], began, METHOD, share, below)
    _write(out, estimates, time.perf_counter() - began)
    np.savez(
        out / SOURCES, weights=found.weights.numpy(), masked=found.masked.numpy(),
        health=found.trained.health[:, -1], loss=found.trained.loss[:, -1],
    )  # fmt: skip


@step(
    "ensemble-multi-stage",
    "ensemble, multi-stage",
    expected_s=300.0,
    entries=rests_on(find("multi-stage")),
)
def multi_stage(
    out: Path,
    progress: Progress,
    *,
    method: str,
    field: Path,
    maps: Path,
    operators: Path,
    source: Path,
    settings: dict[str, Any],
    what: dict[str, Any],
    kind: str,
) -> None:
    """The segments behind the first, each member from the source model of the same number."""
    import time
    from types import SimpleNamespace

    import numpy as np
    import torch

    from dieseltwin.paper.loops.multi_stage import METHOD, later_segments, source_models
    from dieseltwin.surrogates.files import load_networks

    problems = problems_for(field, settings, what, what["members"])
    config = _config(settings, METHOD, what)
    given = load_networks({"maps": maps, "operators": operators})
    with np.load(source / SOURCES) as stored:
        found: Any = SimpleNamespace(
            weights=torch.tensor(stored["weights"]),
            masked=torch.tensor(stored["masked"]),
            trained=SimpleNamespace(health=stored["health"][:, None], loss=stored["loss"][:, None]),
        )
    began = time.perf_counter()
    estimates = later_segments(
        problems, source_models(found, what["runs"]), what["runs"], what["seed"], config, given["operators"],
        given["maps"], what["first"],
    )  # fmt: skip
    _write(out, estimates, time.perf_counter() - began)


OWN_STEPS: dict[str, Step] = {"baseline": baseline, "multi-stage": multi_stage}


def members(
    out: Path,
    progress: Progress,
    *,
    method: str,
    field: Path,
    settings: dict[str, Any],
    what: dict[str, Any],
    kind: str,
    **networks: Path,
) -> None:
    """One batch of members of any method. ``networks``: files of what it has learned, by their kind."""
    import time

    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import load_networks

    problems = problems_for(field, settings, what, what["members"])
    chosen, config = find(method), _config(settings, method, what)
    given: dict[str, Any] = load_networks(networks)
    if chosen.with_epochs:
        given["first_run"] = what["first"]
    else:  # it compiles on its first use: seconds are those of a warm machine
        chosen.run(problems[:1], 1, what["seed"], config=config, **given)
    began = time.perf_counter()
    estimates = chosen.run(problems, what["runs"], what["seed"], config=config, **given)
    _write(out, estimates, time.perf_counter() - began)


def steps_of_all() -> dict[str, Step]:
    """Method -> the step of its ensembles: one text for all but the PINN, whose networks are kept and carried on."""
    found = {
        method.name: step(
            f"ensemble-{method.name}", f"ensemble, {method.name}", expected_s=100.0, entries=rests_on(method)
        )(members)
        for method in in_order()
        if method.name not in OWN_STEPS
    }
    return found | OWN_STEPS


STEPS = steps_of_all()


@step("training-operators", "repeated training, actuator operators", expected_s=80.0)
def operators_training(
    out: Path,
    progress: Progress,
    *,
    lab: Path,
    field: Path,
    config: dict[str, Any],
    engine: dict[str, Any],
    seed: int,
    label_noise_rel: float,
    kind: str,
) -> None:
    """``errors.json`` of one training of the operators with or without label noise, errors against clean data."""
    import json

    import pandas as pd

    from dieseltwin.paper.datasets import laboratory_parameters
    from dieseltwin.settings.params import EngineConfig, OperatorsConfig
    from dieseltwin.surrogates.operators import train_operators
    from tasks.pretrain import _cases, _symbol

    cases = _cases(lab)
    parameters = laboratory_parameters(EngineConfig(**engine))
    trained = train_operators(cases, OperatorsConfig(**config), seed, parameters, label_noise_rel=label_noise_rel)
    test = trained.errors(pd.read_parquet(field / "case_v_clean.parquet"))
    train = trained.training_errors(cases)
    errors = {_symbol(label): {"train": train[label], "test": test[label]} for label in test}
    (out / "errors.json").write_text(json.dumps(errors, indent=1, sort_keys=True) + "\n", encoding="utf-8")


@step("training-bodies", "repeated training, multi-head bodies", expected_s=60.0)
def bodies_training(out: Path, progress: Progress, *, lab: Path, config: dict[str, Any], seed: int, kind: str) -> None:
    """``errors.json`` of one training of the bodies as printed: training errors."""
    import json

    from dieseltwin.settings.params import BodiesConfig
    from dieseltwin.surrogates.bodies import BODIES, train_bodies
    from tasks.pretrain import _cases, _symbol

    cases = _cases(lab)
    trained = train_bodies(cases, BodiesConfig(**config), seed, "paper")
    table = trained.training_errors(cases)
    columns = [column for group in BODIES.values() for column in group]
    errors = {_symbol(column): {"train": float(table[column])} for column in columns}
    (out / "errors.json").write_text(json.dumps(errors, indent=1, sort_keys=True) + "\n", encoding="utf-8")
