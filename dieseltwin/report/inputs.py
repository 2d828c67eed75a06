"""From a finished identification to the report: the structure it draws, and the files it is rebuilt from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from dieseltwin.atomic import atomic_path, write_json
from dieseltwin.identification.result import curves_table
from dieseltwin.report.results import PARAMETERS, Results, method_from_document
from dieseltwin.sensors import MEASURED
from dieseltwin.symbols import INPUT_COLUMNS

if TYPE_CHECKING:
    from dieseltwin.identification.problem import SegmentProblem
    from dieseltwin.identification.result import Identification


def measured_table(problems: Sequence[SegmentProblem]) -> pd.DataFrame:
    """The readings that the estimators saw: time_s, the inputs and the six measured columns [SI], NaN where masked."""
    parts = []
    for problem in problems:
        start = problem.inputs.n_history
        part = pd.DataFrame({"time_s": problem.time_s})
        for column in INPUT_COLUMNS:
            part[column] = np.asarray(getattr(problem.inputs, column))[start:]
        for index, column in enumerate(MEASURED):
            part[column] = problem.measured[:, index]
        parts.append(part)
    # segments share their boundary sample
    return pd.concat(parts, ignore_index=True).drop_duplicates("time_s", ignore_index=True)


def noise_levels(problems: Sequence[SegmentProblem]) -> dict[str, float]:
    """Standard deviation of the noise of each measured column [SI]; the recording's, so the first segment's will do."""
    return {column: float(value) for column, value in zip(MEASURED, problems[0].sigma, strict=True)}


def known_truth(problems: Sequence[SegmentProblem]) -> dict[str, float] | None:
    """True health parameters [SI] where the problems carry them (simulated recordings)."""
    truth = problems[0].truth
    return None if truth is None else {p: float(truth[p]) for p in PARAMETERS if p in truth}


def nominal_values(problems: Sequence[SegmentProblem]) -> dict[str, float]:
    """Health parameters of the engine file [SI], where the search starts: what "nominal" means in the report."""
    return {p: float(getattr(problems[0].parameters, p)) for p in PARAMETERS}


def results_of(
    identification: Identification,
    problems: Sequence[SegmentProblem],
    document: Mapping[str, Any] | None = None,
    *,
    about: Mapping[str, Any] | None = None,
) -> Results:
    """The report's structure from one identification in memory, with the same content as from its files.

    Args:
        identification, problems: what was found, and where.
        document: what stands in `identification.json`, where that is more than the identification itself says.
        about: of the recording.
    """
    method = method_from_document(
        identification.to_json() if document is None else document,
        runtime=identification.runtime(),
        states=identification.states,
        curves=curves_table(identification),
    )
    return Results(
        methods=(method,),
        truth=known_truth(problems),
        measured=measured_table(problems),
        sigma=noise_levels(problems),
        nominal=nominal_values(problems),
        about=dict(about or {}),
    )


def write_report_inputs(
    folder: str | Path,
    problems: Sequence[SegmentProblem],
    *,
    truth_states: pd.DataFrame | None = None,
    about: Mapping[str, Any] | None = None,
) -> None:
    """Write what `build_report` needs besides the methods' own folders, each file atomically.

    measured.parquet and measured.json (noise levels), truth.json where the problems carry the truth, truth.parquet
    where ``truth_states`` is given, report.json with the nominal values and ``about`` (title, recording, seed, ...).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / "measured.parquet") as path:
        measured_table(problems).to_parquet(path, index=False)
    write_json(folder / "measured.json", {"sigma": noise_levels(problems)})
    truth = known_truth(problems)
    if truth is not None:
        write_json(folder / "truth.json", truth)
    if truth_states is not None:
        with atomic_path(folder / "truth.parquet") as path:
            truth_states.to_parquet(path, index=False)
    write_json(folder / "report.json", {"nominal": nominal_values(problems), **(about or {})})
