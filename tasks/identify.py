"""Steps of the flow ``identify``: one for each method, each apart so that a change in one leaves the others alone.

A step writes what ``dieseltwin identify`` writes: identification.json, runtime.json, states.parquet, curves.parquet.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tasks.run_context import step

# ``dieseltwin.identification`` names all methods in its registry; a step rests on its own method alone, which stands
# in ``entries``.


def _config(settings: dict[str, Any]) -> Any:
    """``IdentifyConfig`` without the sections of the other methods."""
    from pydantic import TypeAdapter

    from dieseltwin.settings.params import IdentifyConfig

    fields = {
        name: TypeAdapter[Any](IdentifyConfig.model_fields[name].annotation).validate_python(value)  # type: ignore[arg-type]
        for name, value in settings["identify"].items()
    }
    return IdentifyConfig.model_construct(**fields)


def problems_of(field: Path, settings: dict[str, Any]) -> tuple[list[Any], Any]:
    """Segments of the noisy field recording, with the truth that the clean one holds; and the true states (a table)."""
    from dataclasses import replace

    import numpy as np
    import pandas as pd

    from dieseltwin.identification.problem import PAPER_CHANNELS, NoiseLevels, problems_from_recording
    from dieseltwin.recordings.datasets import HEALTH, MEASURED, laboratory_parameters
    from dieseltwin.recordings.reader import read_recording
    from dieseltwin.settings.params import EngineConfig, NoiseConfig

    config = _config(settings)
    parameters = laboratory_parameters(EngineConfig(**settings["engine"]))
    recording = read_recording(field / "case_v_noisy.parquet", engine=parameters)
    clean = pd.read_parquet(field / "case_v_clean.parquet")
    noise = NoiseLevels.from_signals(
        np.column_stack([recording.columns[name] for name in MEASURED]),
        relative=NoiseConfig(**settings["noise"]).channels,
    )
    truth = {name: float(clean[name].iloc[0]) for name in HEALTH}
    problems = problems_from_recording(
        recording, parameters, noise=noise, duration_s=config.segment_s, channels=PAPER_CHANNELS, truth=truth
    )
    last_s = recording.time_s[0] + 60.0 * config.minutes
    problems = [problem for problem in problems if problem.t0_s < last_s]
    states = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k"]
    at = np.searchsorted(clean["time_s"], [problem.t0_s for problem in problems])
    initial = clean[states].to_numpy()[at]
    known = [replace(problem, true_initial=row) for problem, row in zip(problems, initial, strict=True)]
    return known, clean[clean["time_s"] <= problems[-1].t1_s]


def _identify(
    out: Path,
    method: str,
    field: Path,
    settings: dict[str, Any],
    runs: int,
    seed: int,
    *,
    compiles: bool = False,
    **networks: Any,
) -> None:
    """Identify the first minutes of the noisy field recording with one method and write the results.

    ``compiles``: the method compiles on its first use, which is done beforehand.
    """
    import json

    from dieseltwin.identification import identify_segments
    from dieseltwin.identification.curves import curves_table

    config = _config(settings)
    problems, _ = problems_of(field, settings)
    threshold = config.identifiable_bound_rel
    if compiles:  # seconds per run are those of a warm machine
        identify_segments(problems[:1], method, 1, seed, config=config, threshold=threshold, **networks)
    found = identify_segments(problems, method, runs, seed, config=config, threshold=threshold, **networks)
    for name, content in (("identification.json", found.to_json()), ("runtime.json", found.runtime())):
        (out / name).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    found.states.to_parquet(out / "states.parquet", index=False)
    curves = curves_table(found)
    if curves is not None:
        curves.to_parquet(out / "curves.parquet", index=False)


@step(
    "identify-classical",
    "identification, classical",
    expected_s=30.0,
    entries=("dieseltwin.identification.classical",),
)
def classical(out: Path, progress: Any, *, field: Path, settings: dict[str, Any], runs: int, seed: int) -> None:
    """Maximum likelihood by shooting, exact formulae."""
    _identify(out, "classical", field, settings, runs, seed, compiles=True)


@step(
    "identify-newton",
    "identification, few-shot-newton",
    expected_s=60.0,
    entries=("dieseltwin.identification.fewshot_newton",),
)
def newton(
    out: Path, progress: Any, *, field: Path, bodies: Path, settings: dict[str, Any], runs: int, seed: int
) -> None:
    """Gauss-Newton on heads and parameters: conditioned bodies, exact formulae."""
    from dieseltwin.surrogates.bodies import Bodies

    _identify(out, "few-shot-newton", field, settings, runs, seed, compiles=True, bodies=Bodies.load(bodies))


@step(
    "identify-adam",
    "identification, few-shot-adam",
    expected_s=90.0,
    entries=("dieseltwin.identification.fewshot_adam",),
)
def adam(
    out: Path,
    progress: Any,
    *,
    field: Path,
    bodies: Path,
    maps: Path,
    operators: Path,
    settings: dict[str, Any],
    runs: int,
    seed: int,
) -> None:
    """The paper's loop, everything as printed: bodies, maps with dropout, actuator operators."""
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

    networks: dict[str, Any] = {
        "bodies": Bodies.load(bodies),
        "maps": EmpiricalMaps.load(maps),
        "operators": ActuatorOperators.load(operators),
    }
    _identify(out, "few-shot-adam", field, settings, runs, seed, **networks)
