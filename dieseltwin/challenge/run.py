"""Run the tool over a benchmark, case by case; never opens the sealed part."""

from __future__ import annotations

import os
import resource
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, Field

from dieseltwin.atomic import atomic_folder, write_json, write_text
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import Options, discover_points
from dieseltwin.calibration.verdict import document
from dieseltwin.challenge.cases import MAP_RMS, PETROL, POINTS, Tier
from dieseltwin.challenge.make import MANIFEST
from dieseltwin.challenge.processes import in_processes
from dieseltwin.challenge.seal import check_file
from dieseltwin.challenge.stamps import code_sha256
from dieseltwin.discovery.verdict.document import FILE_NAME, Discrepancy
from dieseltwin.discovery.verdict.explain import plain
from dieseltwin.engine import EngineParameters, we2011
from dieseltwin.paths import file_sha256
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.parameters import PetrolParameters, load_petrol, save_petrol
from dieseltwin.petrol.recording import read_petrol
from dieseltwin.recordings.reader import Recording, read_recording
from dieseltwin.recordings.steady_points import SteadyPoints, beside_reference, read_points
from dieseltwin.sealed import read_json, sealed_json, sealed_text
from dieseltwin.settings.strict import unknown_name, validate

RESULTS = "results"
FAILED = "failed.json"
_PACKAGE = Path(__file__).parents[1]
_OURS = ("a file of `challenge run`", "remove it and run it again")

Discover = Callable[..., Any]
"""(recording, engine, withhold=, map_tolerance=, seed=) -> `curves.Discovery`."""


class ManifestReference(BaseModel):
    """A recording of the engine when it was well: its file in the benchmark's folder, and its hash."""

    recording: str = Field(pattern=r"^([A-Za-z0-9_-]{1,100}/)?[A-Za-z0-9_.-]{1,100}$")
    sha256: str


class ManifestCase(BaseModel):
    """What a manifest says of one case: names and hashes; the recording lies in the benchmark's folder."""

    case: str = Field(pattern=r"^[A-Za-z0-9_-]{1,100}$")
    recording: str = Field(pattern=r"^[A-Za-z0-9_-]{1,100}(/[A-Za-z0-9_.-]{1,100})?$")
    recording_sha256: str
    answers_salted_sha256: str
    held_out_salted_sha256: str | None = None
    held_out_clean_salted_sha256: str | None = None
    references: list[ManifestReference] = []
    withhold: list[str]


class Manifest(BaseModel):
    """What running and scoring read of a manifest."""

    n: int = Field(ge=1)
    tier: Tier
    sensors: Literal[5, 6] | None
    duration_s: float | None = Field(gt=0, allow_inf_nan=False)
    seed_sha256: str | None = None
    cases: list[ManifestCase]


def read_manifest(folder: Path) -> dict[str, Any]:
    """The open part of a benchmark.

    Raises:
        InputError: no benchmark, or not readable.
    """
    path = folder / MANIFEST
    content = read_json(path, "the manifest of `challenge make`", "give the folder that `challenge make` wrote")
    validate(Manifest, content, str(path))
    return content


def the_tool(
    recording: Recording, engine: EngineParameters, *, references: Sequence[Recording] = (), **options: Any
) -> Any:
    """`discover` with its defaults but for the options given; with references the engine is learned from them first."""
    from dieseltwin.discovery.discover import Options, discover
    from dieseltwin.discovery.reference.learn import learn_engine

    if not references:
        return discover(recording, engine, Options(**options))
    learned, _ = learn_engine(references, engine, options.pop("map_tolerance"))
    return discover(recording, learned.engine, Options(**options), learned)


def run_challenge(
    folder: Path, *, only: Sequence[str] = (), limit: int | None = None, jobs: int = 1,
    discover: Discover = the_tool, progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, int]:  # fmt: skip
    """Run the tool on every case that has no result yet; a killed run goes on where it was.

    Args:
        folder: of `make`; only: names of cases; limit: at most so many cases in this call; jobs: processes, one thread
            each; discover: what to run (`the_tool`).

    Returns:
        Counts: done (now), failed (now), kept (had a result before), left.

    Raises:
        InputError: no benchmark, an unknown case, a recording that is not the one that was made.
    """
    manifest = read_manifest(folder)
    entries = {entry["case"]: entry for entry in manifest["cases"]}
    for name in only:
        if name not in entries:
            raise unknown_name("challenge: --only", name, list(entries))
    wanted = [entries[name] for name in only] if only else list(entries.values())
    pending = [entry for entry in wanted if not (folder / RESULTS / entry["case"] / FILE_NAME).is_file()]
    kept = len(wanted) - len(pending)
    now = pending[:limit] if limit is not None else pending
    if manifest["tier"] == PETROL:
        if not now:
            return {"done": 0, "failed": 0, "kept": kept, "left": len(pending)}
        work: Callable[[Mapping[str, Any]], str] = partial(
            run_drawn_case, folder, know=partial(_known_petrol, _calibrated(folder, now[0])), judge=_judge_petrol
        )
    elif manifest["tier"] == POINTS:
        work = partial(run_drawn_case, folder, know=_healthy_points, judge=_judge_points)
    else:
        work = partial(run_case, folder, map_tolerance=MAP_RMS[manifest["tier"]], discover=discover)
    failed, done = 0, 0

    def count(name: str, note: str) -> None:
        nonlocal failed, done
        done += 1
        failed += note.startswith("failed")
        if progress is not None:
            progress(done, len(now), f"{name} {note}")

    for k, note in in_processes(work, now, jobs):
        count(now[k]["case"], note)
    return {"done": done - failed, "failed": failed, "kept": kept, "left": len(pending) - len(now)}


def run_case(folder: Path, entry: Mapping[str, Any], *, map_tolerance: float, discover: Discover = the_tool) -> str:
    """Run the tool on one case and write its result folder whole or not at all; returns a note of what was said."""
    path = folder / entry["recording"]
    check_file(path, entry["recording_sha256"])
    healthy = _checked_references(folder, entry)
    _reset_peak()
    start = time.perf_counter()
    try:
        recording = read_recording(path)
        references = [read_recording(reference) for reference in healthy]
        found = discover(
            recording, we2011.PARAMETERS, withhold=tuple(entry["withhold"]), map_tolerance=map_tolerance, seed=0,
            **({"references": references} if references else {}),
        )
    except Exception as error:  # one case must not end the run; it is listed as a failure by the scorer
        return _failed(folder, entry, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    with atomic_folder(folder / RESULTS / entry["case"]) as result:
        write_engine(found.engine, result / "engine.yaml")
        write_engine(found.engine_before, result / "engine_before.yaml")
        write_json(result / "laws.json", plain(found.curves.laws))
        write_json(result / "candidates.json", plain(found.curves.candidates))
        write_json(result / "details.json", plain(found.details))
        _write_document(result, found.document, seconds, plain(found.runtime))
    return _said(folder, entry, found.document, seconds)


Said = tuple[Discrepancy, Callable[[Path], object]]
"""What is said, and what writes the repaired engine into a file."""

Known = TypeVar("Known")


def run_drawn_case(
    folder: Path, entry: Mapping[str, Any], *, know: Callable[[Sequence[Path]], Known],
    judge: Callable[[Path, Known], Said],
) -> str:  # fmt: skip
    """As `run_case`, of a tier of `cases.DRAWN`: verdict and engine are all that is written.

    Args:
        folder: of the benchmark; entry: of the case.
        know: what is known of the engine from the files of its references; its time doesn't count.
        judge: what is said of a recording then.
    """
    recording = folder / entry["recording"]
    check_file(recording, entry["recording_sha256"])
    references = _checked_references(folder, entry)
    _reset_peak()
    start = time.perf_counter()
    try:
        known = know(references)
        start = time.perf_counter()
        said, write = judge(recording, known)
    except Exception as error:  # as in `run_case`
        return _failed(folder, entry, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    with atomic_folder(folder / RESULTS / entry["case"]) as result:
        write(result / "engine.yaml")
        _write_document(result, said, seconds, {})
    return _said(folder, entry, said, seconds)


def _checked_references(folder: Path, entry: Mapping[str, Any]) -> list[Path]:
    """Files of a case's references, each the one that was made."""
    for item in entry.get("references", ()):
        check_file(folder / item["recording"], item["sha256"])
    return [folder / item["recording"] for item in entry.get("references", ())]


def _judge_petrol(recording: Path, engine: PetrolParameters) -> Said:
    found = discover_petrol(read_petrol(recording), engine)
    return found.document, partial(save_petrol, found.engine)


def _healthy_points(references: Sequence[Path]) -> list[SteadyPoints]:
    return [read_points(path) for path in references]


def _judge_points(recording: Path, healthy: Sequence[SteadyPoints]) -> Said:
    """What `discover POINTS --reference HEALTHY` does."""
    points, options = read_points(recording), Options()
    used = beside_reference(points, healthy) if healthy else points
    found = discover_points(calibrate(used, we2011.PARAMETERS, believed=options.search), options)
    return document(found), partial(write_engine, found.engine())


def _calibrated(folder: Path, entry: Mapping[str, Any]) -> Path:
    """File of the engine of a petrol benchmark, calibrated on its healthy recording and kept in `results`: that takes
    longer than a verdict. Done again where recording or calibration are no longer those that it came from.

    Args:
        folder: of the benchmark; entry: of any of its cases, as all have the same reference.
    """
    healthy = _checked_references(folder, entry)[0]
    kept, stamp = folder / RESULTS / "petrol_engine.yaml", folder / RESULTS / "petrol_engine.json"
    of = {"of": f"{file_sha256(healthy)} {code_sha256('petrol')}"}
    if not (kept.is_file() and stamp.is_file() and read_json(stamp, *_OURS) == of):
        kept.parent.mkdir(parents=True, exist_ok=True)
        stamp.unlink(missing_ok=True)
        save_petrol(fit_maps(read_petrol(healthy).signals, PetrolParameters())[0], kept)
        write_json(stamp, sealed_json(of))
    return kept


def _known_petrol(engine: Path, _: Sequence[Path]) -> PetrolParameters:
    return load_petrol(engine)


def _failed(folder: Path, entry: Mapping[str, Any], error: Exception, seconds: float) -> str:
    """The error as the case's result, with the last line of this package that it passed."""
    own = [f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).is_relative_to(_PACKAGE)]
    where = f"{Path(own[-1].filename).relative_to(_PACKAGE)}:{own[-1].lineno}" if own else ""
    with atomic_folder(folder / RESULTS / entry["case"]) as result:
        told = {"error": f"{type(error).__name__}: {error}", "where": where, "seconds": seconds}
        write_json(result / FAILED, sealed_json(told))
    return f"failed after {seconds:.1f} s: {type(error).__name__}: {error} ({where})"


def _write_document(result: Path, document: Discrepancy, seconds: float, steps: Any) -> None:
    write_json(result / "runtime.json", sealed_json({
        "seconds": seconds, "peak_rss_mib": peak_rss_mib(), "duration_s": document.recording.duration_s,
        "threads": os.environ.get("DIESELTWIN_THREADS", "all"), "steps": steps,
    }))  # fmt: skip
    document.write(result / FILE_NAME)


def _said(folder: Path, entry: Mapping[str, Any], document: Discrepancy, seconds: float) -> str:
    (folder / RESULTS / entry["case"] / FAILED).unlink(missing_ok=True)
    return f"{seconds:.1f} s: {', '.join(effect.name for effect in document.effects) or 'healthy'}"


def write_engine(engine: EngineParameters, path: Path) -> None:
    """An engine file that `load_engine` reads back: the values that differ from the published set, terms included."""
    published = we2011.PARAMETERS.model_dump(mode="json")
    changed = {k: v for k, v in engine.model_dump(mode="json").items() if v != published.get(k)}
    write_text(path, sealed_text(yaml.safe_dump(changed, sort_keys=False, allow_unicode=True) if changed else "{}\n"))


def _reset_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def peak_rss_mib() -> float:
    """Largest resident memory of this process since the case began (since the process began where not known) [MiB]."""
    try:
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
