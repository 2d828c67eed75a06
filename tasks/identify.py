"""Steps of the flow ``identify``: one for each method, each apart so that a change in one leaves the others alone.

A step writes what ``dieseltwin identify`` writes: identification.json, runtime.json, states.parquet, curves.parquet.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dieseltwin.settings.methods import Method, in_order
from dieseltwin.surrogates.files import CLASSES, files_of
from tasks.run_context import Progress, Step, step


def _config(settings: dict[str, Any]) -> Any:
    """``IdentifyConfig`` with the section of one method alone; how many runs there are is an argument of its own."""
    from dieseltwin.settings.params import IdentifyConfig

    return IdentifyConfig(**{"runs": 1, **settings["identify"]})


def problems_of(field: Path, settings: dict[str, Any]) -> tuple[list[Any], Any]:
    """Segments of the noisy field recording, with the truth that the clean one holds; and the true states (a table)."""
    from dataclasses import replace

    import numpy as np
    import pandas as pd

    from dieseltwin.identification.problem import PAPER_CHANNELS, NoiseLevels, problems_from_recording
    from dieseltwin.paper.datasets import HEALTH, laboratory_parameters, noise_sigma
    from dieseltwin.recordings.reader import read_recording
    from dieseltwin.settings.params import EngineConfig, NoiseConfig
    from dieseltwin.symbols import STATES

    config = _config(settings)
    parameters = laboratory_parameters(EngineConfig(**settings["engine"]))
    recording = read_recording(field / "case_v_noisy.parquet", engine=parameters)
    clean = pd.read_parquet(field / "case_v_clean.parquet")
    noise = NoiseLevels(noise_sigma(clean, NoiseConfig(**settings["noise"])))
    truth = {name: float(clean[name].iloc[0]) for name in HEALTH}
    problems = problems_from_recording(
        recording, parameters, noise=noise, duration_s=config.segment_s, channels=PAPER_CHANNELS, truth=truth
    )
    last_s = recording.time_s[0] + 60.0 * config.minutes
    problems = [problem for problem in problems if problem.t0_s < last_s]
    at = np.searchsorted(clean["time_s"], [problem.t0_s for problem in problems])
    initial = clean[list(STATES)].to_numpy()[at]
    known = [replace(problem, true_initial=row) for problem, row in zip(problems, initial, strict=True)]
    return known, clean[clean["time_s"] <= problems[-1].t1_s]


def identified(
    out: Path,
    progress: Progress,
    *,
    method: str,
    field: Path,
    settings: dict[str, Any],
    runs: int,
    seed: int,
    **networks: Path,
) -> None:
    """Identify the first minutes of the noisy field recording with one method and write the results.

    ``networks``: files of what the method has learned, by their kind.
    """
    import json

    from dieseltwin.identification.identify import identify_segments
    from dieseltwin.identification.result import curves_table
    from dieseltwin.settings.methods import find
    from dieseltwin.surrogates.files import load_networks

    config = _config(settings)
    problems, _ = problems_of(field, settings)
    learned = load_networks(networks)
    if not find(method).with_epochs:  # it compiles on its first use: seconds per run are those of a warm machine
        identify_segments(problems[:1], method, 1, seed, config=config, **learned)
    found = identify_segments(problems, method, runs, seed, config=config, **learned)
    for name, content in (("identification.json", found.to_json()), ("runtime.json", found.runtime())):
        (out / name).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    found.states.to_parquet(out / "states.parquet", index=False)
    curves = curves_table(found)
    if curves is not None:
        curves.to_parquet(out / "curves.parquet", index=False)


def rests_on(method: Method) -> tuple[str, ...]:
    """Modules of the library that a method's result rests on: its own ones, and those of the networks that it is given.

    All are found by name when they run, so that a change in one method leaves the others' results alone.
    """
    return (*method.modules, *(f"dieseltwin.surrogates.{CLASSES[kind][0]}" for kind in files_of(method.needs)))


def declarations() -> tuple[str, ...]:
    """Modules that declare the methods, for steps that show results of any of them: with its name, rank and style."""
    return tuple(method.modules[0] for method in in_order())


def steps_of_all() -> dict[str, Step]:
    """Method -> its step, for every estimator that the library has."""
    return {
        method.name: step(
            f"identify-{method.name}", f"identification, {method.name}", expected_s=60.0, entries=rests_on(method)
        )(identified)
        for method in in_order()
    }


STEPS = steps_of_all()
