"""What the report is built from: documents and tables on disk, read into one frozen structure.

The report never needs the objects of a running identification: everything comes from ``identification.json``,
``runtime.json``, ``states.parquet``, ``curves.parquet`` and a few optional files, so that it can be rebuilt any time.
All values are SI; missing values (``null``) become NaN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dieseltwin.discovery.verdict.health_value import SinceReference
from dieseltwin.errors import InputError
from dieseltwin.notes import OF_THE_FIT
from dieseltwin.sealed import read_json
from dieseltwin.settings.methods import known
from dieseltwin.symbols import HEALTH_NAMES

PARAMETERS = HEALTH_NAMES
FILE_NAME = "identification.json"
_WRITTEN = ("a JSON document", "write it again with `dieseltwin identify`")


@dataclass(frozen=True)
class Estimate:
    """One parameter's estimate, in SI units: value, standard deviation, 90 % interval, Cramer-Rao bound (a std), and
    over what it was when the engine was learned."""

    mean: float
    std: float
    interval_90: tuple[float, float]
    bound: float
    identifiable: bool
    since_reference: SinceReference | None = None

    @property
    def finite(self) -> bool:
        """True where there is a value to show (diverged or masked estimates have none)."""
        return math.isfinite(self.mean)


@dataclass(frozen=True)
class SegmentResult:
    """The estimates of one segment, from ``t0_s`` to ``t1_s`` [s]."""

    t0_s: float
    t1_s: float
    parameters: Mapping[str, Estimate]

    @property
    def minutes(self) -> str:
        """The segment's name in the figures, e.g. ``2–3`` (minutes), as in the paper's tables."""
        return f"{self.t0_s / 60:.4g}–{self.t1_s / 60:.4g}"


@dataclass(frozen=True)
class MethodResult:
    """Everything that one method delivered for one recording.

    ``runs`` is a long table (segment, run, parameter, value [SI], converged); ``states`` and ``curves`` may be absent.
    ``with_tolerances`` are health parameters of a fit beside tolerances of maps and sensors, where there was one.
    ``warnings`` are the document's: code, text, affects.
    """

    method: str
    pooled: Mapping[str, Estimate]
    segments: tuple[SegmentResult, ...]
    runs: pd.DataFrame
    runtime: Mapping[str, Any] = field(default_factory=dict)
    states: pd.DataFrame | None = None
    curves: pd.DataFrame | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    with_tolerances: Mapping[str, Estimate] = field(default_factory=dict)
    warnings: tuple[Mapping[str, Any], ...] = ()

    @property
    def misfit(self) -> str:
        """That the twin doesn't fit the recording, in a sentence without its full stop; empty where it does."""
        return next((str(doubt["text"]) for doubt in self.warnings if doubt["code"] in OF_THE_FIT), "")

    @property
    def number_of_runs(self) -> int:
        """Runs per segment."""
        if len(self.runs):
            return int(self.runs.groupby("segment")["run"].nunique().max())
        return int(self.runtime.get("runs", 0) or 0)

    @property
    def number_not_converged(self) -> int:
        """Runs, over all segments, that did not converge."""
        if not len(self.runs):
            return 0
        return int((~self.runs.groupby(["segment", "run"])["converged"].all()).sum())

    @property
    def seconds_per_run(self) -> float:
        """Wall seconds per run of one segment [s]; NaN where no run time was kept."""
        return number(self.runtime.get("seconds_per_run"))


@dataclass(frozen=True)
class Results:
    """All that one report shows. ``truth`` and ``truth_states`` exist for simulated recordings only."""

    methods: tuple[MethodResult, ...]
    truth: Mapping[str, float] | None = None
    truth_states: pd.DataFrame | None = None
    measured: pd.DataFrame | None = None
    sigma: Mapping[str, float] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    pretraining: Mapping[str, Any] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    pictures: tuple[Path, ...] = ()

    @property
    def segments(self) -> tuple[SegmentResult, ...]:
        """The segments of the method that covers most of the recording (methods may have been given fewer)."""
        return max((m.segments for m in self.methods), key=len, default=())

    def segment_index(self, segment: SegmentResult) -> int:
        """Position of ``segment`` on the common axis of all methods, by its start time."""
        starts = [s.t0_s for s in self.segments]
        return int(np.argmin(np.abs(np.asarray(starts) - segment.t0_s)))

    def flagged_by_any(self, segment: SegmentResult, parameter: str) -> bool:
        """Whether any method calls ``parameter`` not identifiable there: the bound belongs to the driving, and a method
        that is far off may take its own wrong value for a well-known one."""
        return any(
            not other.parameters[parameter].identifiable
            for method in self.methods
            for other in method.segments
            if other.t0_s == segment.t0_s
        )

    def true_value(self, parameter: str) -> float:
        """The true parameter [SI] or NaN where it is unknown."""
        return number((self.truth or {}).get(parameter))


def number(value: Any) -> float:
    """A float from JSON: ``null``, text and absent values become NaN."""
    if isinstance(value, bool) or value is None:
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _estimate(entry: Mapping[str, Any]) -> Estimate:
    low, high = entry.get("interval_90") or (None, None)
    since = entry.get("since_reference")
    return Estimate(
        mean=number(entry.get("mean")),
        std=number(entry.get("std")),
        interval_90=(number(low), number(high)),
        bound=number(entry.get("bound")),
        identifiable=bool(entry.get("identifiable")),
        since_reference=None if since is None else SinceReference(**since),
    )


def _runs_table(runs: Sequence[Mapping[str, Any]], segments: Sequence[SegmentResult]) -> pd.DataFrame:
    """One row for each start, segment and parameter of the document's runs."""
    index = {segment.t0_s: i for i, segment in enumerate(segments)}
    rows = []
    for entry in runs:
        for part in entry["segments"]:
            for parameter in PARAMETERS:
                value = number(part["parameters"][parameter]["value"])
                converged = bool(part["converged"]) and math.isfinite(value)
                rows.append((index[part["t0_s"]], entry["run"], parameter, value, converged))
    return pd.DataFrame(rows, columns=["segment", "run", "parameter", "value", "converged"])


def method_from_document(
    document: Mapping[str, Any],
    *,
    runtime: Mapping[str, Any] | None = None,
    states: pd.DataFrame | None = None,
    curves: pd.DataFrame | None = None,
) -> MethodResult:
    """Read one ``identification.json`` document (schema 1).

    Errors: InputError where the document lacks ``method``, ``parameters`` or ``segments``.
    """
    if not isinstance(document, Mapping):
        kind = type(document).__name__
        raise InputError(
            "identification document", f"a {kind}", "a JSON object", "write it with `dieseltwin identify`"
        )
    missing = [key for key in ("method", "parameters", "segments") if key not in document]
    if missing:
        raise InputError(
            f"identification document: {', '.join(missing)}",
            f"only {', '.join(sorted(document)) or 'an empty document'}",
            "schema 1 (method, parameters, segments, runs)",
            "write it with `dieseltwin identify`",
        )
    segments = tuple(
        SegmentResult(
            t0_s=number(entry.get("t0_s")),
            t1_s=number(entry.get("t1_s")),
            parameters={p: _estimate(entry["parameters"].get(p) or {}) for p in PARAMETERS},
        )
        for entry in document["segments"]
    )
    known = {"schema", "method", "parameters", "segments", "runs", "with_tolerances", "warnings", "content_sha256"}
    return MethodResult(
        method=str(document["method"]),
        pooled={p: _estimate(document["parameters"].get(p) or {}) for p in PARAMETERS},
        segments=segments,
        runs=_runs_table(document.get("runs") or (), segments),
        runtime=dict(runtime or {}),
        states=states,
        curves=curves,
        settings={key: value for key, value in document.items() if key not in known},
        with_tolerances={p: _estimate(entry) for p, entry in document.get("with_tolerances", {}).items()},
        warnings=tuple(document.get("warnings", ())),
    )


def _optional_json(path: Path) -> dict[str, Any]:
    return read_json(path, *_WRITTEN) if path.exists() else {}


def _optional_table(path: Path) -> pd.DataFrame | None:
    if not path.exists():
        return None
    try:
        return pd.read_parquet(path, page_checksum_verification=True)
    except (OSError, ValueError) as error:  # pyarrow's errors derive from these
        raise InputError(str(path), error, "a Parquet table", "make it again") from error


def load_method(directory: Path) -> MethodResult:
    """Read what ``dieseltwin identify --out DIRECTORY`` wrote."""
    directory = Path(directory)
    path = directory / FILE_NAME
    if not path.exists():
        raise InputError(
            str(directory),
            "no identification.json",
            "a folder of `dieseltwin identify --out`",
            "check the path",
        )
    return method_from_document(
        read_json(path, *_WRITTEN),
        runtime=_optional_json(directory / "runtime.json"),
        states=_optional_table(directory / "states.parquet"),
        curves=_optional_table(directory / "curves.parquet"),
    )


def _rank(result: MethodResult) -> tuple[int, str]:
    """The quick methods first; one that this version doesn't know comes last."""
    found = known(result.method)
    return 1000 if found is None else found.rank, result.method


def load_results(results_dir: Path) -> Results:
    """Read a folder of stored results (every ``identification.json`` up to two levels down, and the optional files).

    Errors: InputError where the folder holds no ``identification.json`` or a file is broken.
    """
    root = Path(results_dir)
    # not rglob: it doesn't enter linked folders, and a pipeline may link results instead of copying them
    patterns = (FILE_NAME, f"*/{FILE_NAME}", f"*/*/{FILE_NAME}")
    folders = sorted({path.parent for pattern in patterns for path in root.glob(pattern)})
    if not folders:
        raise InputError(
            str(root),
            "no identification.json below it",
            "a folder of results",
            "run `dieseltwin identify` or `make run` first",
        )
    measured_notes = _optional_json(root / "measured.json")
    about = _optional_json(root / "report.json")
    truth = _optional_json(root / "truth.json")
    return Results(
        methods=tuple(sorted((load_method(folder) for folder in folders), key=_rank)),
        truth={p: number(truth[p]) for p in PARAMETERS if p in truth} or None,
        truth_states=_optional_table(root / "truth.parquet"),
        measured=_optional_table(root / "measured.parquet"),
        sigma={key: number(value) for key, value in dict(measured_notes.get("sigma", {})).items()},
        nominal={key: number(value) for key, value in dict(about.get("nominal", {})).items()},
        pretraining=_optional_json(root / "pretraining.json"),
        about=about,
        pictures=tuple(sorted(p for p in (root / "driving").glob("*") if p.suffix in (".png", ".svg"))),
    )
