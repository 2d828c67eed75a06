"""Steps of the flow ``prove``: make a concealed benchmark, run the tool case by case, compare, count.

A case is a step of its own, so a stopped run goes on with the next case, and a changed library runs all of them again.
The step that runs the tool is given the recording alone; the answers stay in the benchmark's folder, which only the
steps that open the seal afterwards receive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tasks.run_context import Progress, step
from tasks.store import Artifact, scratch

# Files of a score that two equal runs make alike (run times are in the others).
METRICS, LINES, FAILURES = "metrics.json", "lines.csv", "failures.csv"
COMPARED = (METRICS, LINES, FAILURES)

_BENCHMARK = "benchmark"  # a folder below the step's own, whose manifest has the same name
_MANIFEST = "manifest.json"
_TIMED_LINES = {"time"}

# Sections of params.yaml that discovery, oracle and baselines look up by themselves.
_LOOKED_UP = ("discover", "learn")


@step("benchmark", "concealed recordings", expected_s=60.0)
def benchmark(
    out: Path, progress: Progress, *, cases: int, seed: int, tier: str, sensors: int, duration_s: float, jobs: int
) -> None:
    """``benchmark/``: ``case_0001/recording.csv`` ..., ``manifest.json`` with the salted hashes, ``sealed/``."""
    from dieseltwin.challenge.make import make_challenge

    make_challenge(
        out / _BENCHMARK,
        cases,
        seed,
        tier=tier,  # type: ignore[arg-type]
        sensors=sensors,
        duration_s=duration_s,
        jobs=jobs,
        progress=progress,
    )


@step("case", "discovery", expected_s=60.0, many=True, sections=_LOOKED_UP)
def case(out: Path, progress: Progress, *, recording: Path, kind: str, withhold: list[str], tier: str) -> None:
    """What ``challenge run`` writes of one case (``kind``): discrepancy.json, engine.yaml, ... or failed.json."""
    import json
    from contextlib import chdir

    from dieseltwin.challenge.cases import MAP_RMS
    from dieseltwin.challenge.run import FAILED, RESULTS, run_case
    from dieseltwin.paths import file_sha256
    from dieseltwin.sealed import read_json

    entry = {
        "case": kind,
        "recording": f"{kind}/{recording.name}",
        "recording_sha256": file_sha256(recording),
        "withhold": withhold,
    }
    recording = recording.resolve()
    _one_thread()
    with _elsewhere() as folder:
        _copied(recording, folder / str(entry["recording"]))
        # Relative, because the document names the recording's path.
        with chdir(folder):
            run_case(Path(), entry, map_tolerance=MAP_RMS[tier])  # type: ignore[index]
        for path in sorted((folder / RESULTS / kind).iterdir()):
            _copied(path, out / path.name)
    failed = out / FAILED
    if failed.exists():
        content = read_json(failed, "a failure of `run_case`", "run again")
        (out / "runtime.json").write_text(json.dumps({"seconds": content.pop("seconds", None)}), encoding="utf-8")
        failed.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")


@step("opened", "seal opened, oracle", expected_s=30.0, many=True, sections=_LOOKED_UP)
def opened(out: Path, progress: Progress, *, benchmark: Path, result: Path, kind: str) -> None:
    """``scored.json`` of one case: held-out scores before and after, the oracle's, separability, the law's error."""
    from dieseltwin.challenge.records import Scoring, case_row
    from dieseltwin.challenge.run import RESULTS, read_manifest
    from dieseltwin.challenge.score import verified_answers

    _one_thread()
    with _laid_out(out, benchmark, {f"{RESULTS}/{kind}": [result]}) as folder:
        manifest = read_manifest(folder)
        only = manifest | {"cases": [entry for entry in manifest["cases"] if entry["case"] == kind]}
        scoring = Scoring.of_the_tool(manifest["tier"])
        case_row(folder, verified_answers(folder, only)[0], scoring)
        computed = folder / RESULTS / kind / _SCORED
        if computed.exists():
            _copied(computed, out / _SCORED)


_SCORED = "scored.json"


@step("baseline-bands", "bands of the baselines", expected_s=150.0, sections=_LOOKED_UP)
def bands(out: Path, progress: Progress, *, benchmark: Path, jobs: int) -> None:
    """``baselines/bands.json``: what healthy machines reach; the baselines alarm beyond it."""
    from dieseltwin.challenge.baselines import write_bands

    with _laid_out(out, benchmark, {}) as folder:
        path = write_bands(folder, jobs=jobs, progress=lambda done, of, _note: progress(done, of))
        _copied(path, out / BASELINES_FOLDER / path.name)


@step("baseline", "baselines", expected_s=15.0, many=True, sections=_LOOKED_UP)
def baseline(out: Path, progress: Progress, *, benchmark: Path, bands: Path, kind: str) -> None:
    """What ``challenge baselines`` writes of one case, as it lies below the benchmark's folder."""
    import shutil

    from dieseltwin.challenge.baselines import run_baselines

    _one_thread()
    with _laid_out(out, benchmark, {BASELINES_FOLDER: [bands / BASELINES_FOLDER]}) as folder:
        run_baselines(folder, only=(kind,), limit=1, jobs=1)
        shutil.copytree(folder / BASELINES_FOLDER, out / BASELINES_FOLDER)


BASELINES_FOLDER = "baselines"


@step("score", "score", expected_s=20.0, sections=_LOOKED_UP)
def score(out: Path, progress: Progress, *, benchmark: Path, **parts: Path) -> None:
    """The table (score.json, score.md, lines.csv), every case (rows.json), failures.csv, figures/, metrics.json.

    ``parts``: result_NAME, opened_NAME and baseline_NAME of the cases.
    """
    import json
    import shutil

    import pandas as pd

    from dieseltwin.challenge.run import RESULTS
    from dieseltwin.challenge.score import score_challenge, write_score

    placed: dict[str, list[Path]] = {}
    for name, path in parts.items():
        role, _, number = name.partition("_")
        placed.setdefault(BASELINES_FOLDER if role == "baseline" else f"{RESULTS}/{number}", []).append(
            path / BASELINES_FOLDER if role == "baseline" else path
        )
    with _laid_out(out, benchmark, placed) as folder:
        found = score_challenge(folder, progress=progress)
        shutil.copytree(write_score(found, folder), out, dirs_exist_ok=True)
    document = json.loads((out / "score.json").read_text(encoding="utf-8"))
    table = pd.DataFrame(document["lines"]).drop(columns="numbers")
    kept = table[~table["key"].isin(_TIMED_LINES)]
    (out / LINES).write_text(kept.to_csv(index=False, lineterminator="\n"), encoding="utf-8")
    numbers = {line["key"]: line["numbers"] for line in document["lines"] if line["key"] not in _TIMED_LINES}
    flat = {name: value for key, values in numbers.items() for name, value in flat_numbers(key, values)}
    (out / METRICS).write_text(json.dumps(flat, indent=1, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")


def cases_of(made: Artifact) -> list[dict[str, Any]]:
    """What the manifest publishes of each case."""
    import json

    manifest: dict[str, Any] = json.loads((made.path / _BENCHMARK / _MANIFEST).read_text(encoding="utf-8"))
    return list(manifest["cases"])


def recording_of(made: Artifact, entry: Mapping[str, Any]) -> Artifact:
    """The one file of a case that the tool sees."""
    return made / f"{_BENCHMARK}/{entry['recording']}"


def files_to_publish(scored: Artifact) -> dict[str, Path]:
    """Names in ``proof/`` -> files."""
    return {name: scored.path / name for name in COMPARED}


def files_to_show(scored: Artifact) -> dict[str, Path]:
    """Names in ``reports/proof/`` -> files."""
    names = ("score.md", "score.json", "rows.json", LINES, FAILURES)
    shown = {name: scored.path / name for name in names if (scored.path / name).exists()}
    return shown | {f"figures/{path.name}": path for path in sorted((scored.path / "figures").glob("*"))}


def show(scored: Artifact, folder: Path) -> None:
    """Print the table, and where the rest is."""
    import json

    from rich.table import Table

    from tasks.run_context import current

    document = json.loads((scored.path / "score.json").read_text(encoding="utf-8"))
    title = f"Concealed benchmark: {document['cases']} cases, tier {document['tier']}, {document['sensors']} sensors"
    table = Table(title=title, title_justify="left")
    for column in ("", "value", "pass", "aim"):
        table.add_column(column)
    for line in document["lines"]:
        colour = {True: "green", False: "red", None: "dim"}[line["passed"]]
        table.add_row(line["metric"], f"[{colour}]{line['value']}[/]", line["pass_at"], line["aim"])
    display = current().display
    display.say("")
    display.say(table)
    display.say(f"report: {folder / 'score.md'}")


def flat_numbers(key: str, value: Any) -> Iterator[tuple[str, float]]:
    """Numbers below ``key`` as dotted names; an interval as ``_low`` and ``_high``, the value itself under the key."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from flat_numbers(key if name == "value" else f"{key}_{name}", inner)
    elif isinstance(value, list):
        for name, inner in zip(("low", "high"), value, strict=False):
            yield from flat_numbers(f"{key.removesuffix('_interval')}_{name}", inner)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, float(value)


def _one_thread() -> None:
    """The simulator takes all cores for a batch; here two machines run beside each other."""
    import os

    os.environ.setdefault("DIESELTWIN_THREADS", "1")


@contextmanager
def _elsewhere() -> Iterator[Path]:
    """A folder outside the workspace, from which no path leads to the answers."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def _copied(source: Path, target: Path) -> None:
    import shutil

    target.parent.mkdir(parents=True, exist_ok=True)
    if source.is_dir():
        shutil.copytree(source, target, dirs_exist_ok=True)
    else:
        shutil.copyfile(source, target)


@contextmanager
def _laid_out(out: Path, benchmark: Path, placed: Mapping[str, list[Path]]) -> Iterator[Path]:
    """The benchmark's folder as the library expects it, for the time of the block: its parts lie apart in the cache.

    ``placed``: name below the folder -> folders whose files are copied there; the benchmark itself is linked.
    """
    with scratch(out) as folder:
        for path in (benchmark / _BENCHMARK).resolve().iterdir():
            (folder / path.name).symlink_to(path, target_is_directory=path.is_dir())
        for name, sources in placed.items():
            for source in sources:
                for path in sorted(source.iterdir()):
                    if path.name not in (_MANIFEST, "step"):  # the cache's own
                        _copied(path, folder / name / path.name)
        yield folder
