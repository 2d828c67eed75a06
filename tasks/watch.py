"""Steps of the flow ``watch``: new recordings of a folder into the history of their engine."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dieseltwin.paths import file_sha256
from tasks.failures import StepFailed
from tasks.run_context import current, step
from tasks.store import Artifact

ENTRY = "entry.json"
PAGE = "history.html"

_ENDINGS = {".csv", ".parquet", ".xlsx", ".mat", ".mf4", ".mdf", ".dat", ".asc", ".blf", ".trc", ".log", ".gz"}
_SETTLED_S = 30.0  # since a file was last written to: what is still being copied is left for the next time


@step("watched", "recording for the history", expected_s=40.0, sections=("discover", "learn"))
def watched(
    out: Path, progress: Any, *, recording: Path, kind: str, name: str, engine: Path, learned: Path, beside: str
) -> None:
    """entry.json, the recording's row of the history; ``kind`` and ``name`` are its name, which may hold its date.

    ``engine`` and ``learned`` are the two files of a learned engine; ``beside`` is what the first calls the second.
    """
    import shutil
    import tempfile
    from contextlib import chdir

    from dieseltwin.api.watch import judge
    from dieseltwin.learning.history import to_json

    with tempfile.TemporaryDirectory() as folder:
        shutil.copy2(recording, Path(folder) / name)  # with its date
        shutil.copyfile(engine, Path(folder) / "engine.yaml")
        shutil.copyfile(learned, Path(folder) / beside)
        with chdir(folder):  # what is refused is named as it is in its folder
            entry = judge(name, "engine.yaml")
    (out / ENTRY).write_text(to_json(entry) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Batch:
    """What one run of the flow added.

    ``added``: recordings by name that weren't in the history; ``sentence``: what the history says now; ``page``: file;
    ``figures``: numbers for the tracker.
    """

    added: tuple[str, ...]
    sentence: str
    page: Path
    figures: Mapping[str, float]


def options(parser: argparse.ArgumentParser) -> None:
    """What the command takes beside the profile."""
    parser.add_argument("folder", help="folder in which recordings of the engine arrive")
    parser.add_argument("--engine", required=True, help="engine file that `dieseltwin learn` wrote")
    parser.add_argument("--history", required=True, help="folder of the engine's history")


def check(parameters: Mapping[str, Any]) -> None:
    """Raise ``StepFailed`` (exit status 2) for files that aren't there, ``InputError`` for a history of no use."""
    from dieseltwin.api.watch import begun

    if not Path(parameters["folder"]).is_dir():
        raise StepFailed(f"{parameters['folder']}: got no such folder; allowed: one with recordings; check the path", 2)
    engine_files(parameters["engine"])
    begun(parameters["history"], parameters["engine"])


def engine_files(text: str) -> dict[str, Any]:
    """The arguments ``engine``, ``learned`` and ``beside`` of the step. Raises ``StepFailed`` (exit status 2)."""
    path = Path(text).resolve()
    content = yaml.safe_load(path.read_text(encoding="utf-8")) if path.is_file() else None
    beside = str(content.get("learned", "")) if isinstance(content, dict) else ""
    if not beside or not path.with_name(beside).is_file():
        raise StepFailed(f"{text}: got no learned engine; allowed: what `dieseltwin learn` wrote, with the file beside "
                         "it; learn the engine first", 2)  # fmt: skip
    return {"engine": Artifact.of(path), "learned": Artifact.of(path.with_name(beside)), "beside": beside}


def new_recordings(folder: str, engine: str, history: str) -> dict[str, Path]:
    """Recordings of a folder that its history doesn't hold, by name; what is still being written is left."""
    from dieseltwin.api.watch import begun

    store, now, found = begun(history, engine), time.time(), {}
    for path in sorted(Path(folder).iterdir()):
        if path.suffix.lower() not in _ENDINGS or not path.is_file() or now - path.stat().st_mtime < _SETTLED_S:
            continue
        if not store.holds(file_sha256(path)):
            found[path.name] = path.resolve()
    return found


def add(found: Mapping[str, Artifact], engine: str, history: str, settings: Mapping[str, Any]) -> Batch:
    """Add entries to the history and write its page."""
    from dieseltwin.api.watch import begun
    from dieseltwin.api.watch import history as history_of
    from dieseltwin.engine import HEALTH
    from dieseltwin.learning.history import from_json
    from dieseltwin.settings.watch import WatchConfig

    store, added = begun(history, engine), []
    for name, artifact in found.items():
        entry = from_json((artifact.path / ENTRY).read_text(encoding="utf-8"))
        if entry is None:
            raise StepFailed(f"{artifact.path / ENTRY}: got no entry of a history; delete it and run again", 1)
        if store.add(entry):
            added.append(name)
    state = history_of(history, settings=WatchConfig(**settings))
    folder = state.save(current().workspace.reports / "watch" / Path(history).name)
    figures = {"recordings": float(len(state.entries)), "alarm": float(state.course.alarm is not None)}
    if state.entries:
        last = state.entries[-1]
        figures |= {"evidence": float(state.course.evidence[-1]), "hours": sum(entry.hours for entry in state.entries)}
        figures |= {f"{name}_since_reference": float(value) for name, value in zip(HEALTH, last.since, strict=True)}
    return Batch(tuple(added), state.sentence, folder / PAGE, figures)


def show(batch: Batch, refused: Mapping[str, StepFailed]) -> None:
    """Print what was added, what was refused and why, and what the history says; raise the first refusal behind it."""
    display = current().display
    for name in batch.added:
        display.say(f"{name}: added")
    for name, error in refused.items():
        display.say(f"{name}: not added: {error}")
    display.say(batch.sentence)
    display.say(f"page: {batch.page}")
    for error in refused.values():
        raise error
