"""Steps of the flow ``watch``: new recordings of a folder into the history of their engine."""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tasks.failures import InputChanged, StepFailed
from tasks.run_context import Progress, current, step
from tasks.store import Artifact

ENTRY = "entry.json"
PAGE = "history.html"

_SETTLED_S = 30.0  # since a file was last written to: what is still being copied is left for the next time


@step("watched", "recording for the history", expected_s=40.0, sections=("discover", "learn"))
def watched(
    out: Path,
    progress: Progress,
    *,
    recording: Path,
    kind: str,
    name: str,
    modified_s: float | None,
    engine: Path,
    learned: Path,
    beside: str,
) -> None:
    """entry.json, the recording's row of the history; ``kind`` and ``name`` are its name, which may hold its date.

    ``modified_s`` as of the function of that name; ``engine`` and ``learned`` are the two files of a learned engine;
    ``beside`` is what the first calls the second.
    """
    import os
    import shutil
    import tempfile
    from contextlib import chdir

    from dieseltwin.api.watch import judge
    from dieseltwin.learning.history import to_json

    with tempfile.TemporaryDirectory() as folder:
        shutil.copyfile(recording, Path(folder) / name)
        if modified_s is not None:
            os.utime(Path(folder) / name, (modified_s, modified_s))
        shutil.copyfile(engine, Path(folder) / "engine.yaml")
        shutil.copyfile(learned, Path(folder) / beside)
        with chdir(folder):  # what is refused is named as it is in its folder
            entry = judge(name, "engine.yaml")
    (out / ENTRY).write_text(to_json(entry) + "\n", encoding="utf-8")


def modified_s(recording: Path, name: str) -> float | None:
    """When a recording was last written to [s since 1970], by which it is dated where neither its name nor its stamps
    say a date; None where the name does."""
    from dieseltwin.api.watch import date_in

    return recording.stat().st_mtime if date_in(name) is None else None


@dataclass(frozen=True)
class Batch:
    """What one run of the flow added.

    ``history``: its name; ``added``: recordings by name that weren't in it; ``recordings``: all that it holds now,
    sha256 of the file -> name; ``sentence``: what it says now; ``page``: file, None of a history without a recording;
    ``figures``: numbers for the tracker; ``refused``: recordings by name that are in part one of the history.
    """

    history: str
    added: tuple[str, ...]
    recordings: Mapping[str, str]
    sentence: str
    page: Path | None
    figures: Mapping[str, float]
    refused: Mapping[str, StepFailed]


def options(parser: argparse.ArgumentParser) -> None:
    """What the command takes beside the profile."""
    parser.add_argument("folder", help="folder in which recordings of the engine arrive")
    parser.add_argument("--engine", required=True, help="engine file that `dieseltwin learn` wrote")
    parser.add_argument("--history", required=True, help="folder of the engine's history")


def check(parameters: Mapping[str, Any]) -> None:
    """Raise ``StepFailed`` or ``InputError`` (exit status 2 both) for files that aren't there or of no use."""
    from dieseltwin.api.watch import begun

    if not Path(parameters["folder"]).is_dir():
        raise StepFailed(f"{parameters['folder']}: got no such folder; allowed: one with recordings; check the path", 2)
    engine_files(parameters["engine"])
    begun(parameters["history"], parameters["engine"])


def engine_files(text: str) -> dict[str, Any]:
    """The arguments ``engine``, ``learned`` and ``beside`` of the step. Raises ``StepFailed`` for an engine that wasn't
    learned, ``InputError`` for what is no engine file (exit status 2 both)."""
    from dieseltwin.settings.strict import read_mapping

    path = Path(text).resolve()
    beside = str(read_mapping(path).get("learned", ""))
    if not beside or not path.with_name(beside).is_file():
        raise StepFailed(f"{text}: got no learned engine; allowed: what `dieseltwin learn` wrote, with the file beside "
                         "it; learn the engine first", 2)  # fmt: skip
    return {"engine": Artifact.of(path), "learned": Artifact.of(path.with_name(beside)), "beside": beside}


@dataclass(frozen=True)
class Arrived:
    """Files of a folder by name.

    ``new``: recordings that the history doesn't hold; ``left``: files that aren't taken now, and why. What the history
    holds is in neither.
    """

    new: Mapping[str, Artifact]
    left: Mapping[str, str]


def arrived(folder: str, engine: str, history: str) -> Arrived:
    """What lies in a folder, each content once. Hidden files, as copying programs write first, are passed over."""
    from dieseltwin.api.watch import begun, date_in
    from dieseltwin.errors import InputError
    from dieseltwin.recordings.importers.content import ENDINGS

    store, new, left = begun(history, engine), {}, {}
    first: dict[str, str] = {}  # content -> name
    for path in sorted(Path(folder).iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.suffix.lower() not in ENDINGS:
            left[path.name] = f"got the ending {path.suffix or 'of no kind'}; allowed: {' '.join(ENDINGS)}"
            continue
        if (age_s := _age_s(path)) < _SETTLED_S:
            left[path.name] = f"written to {age_s:.0f} s ago; taken {_SETTLED_S:.0f} s after the last change"
            continue
        try:
            artifact = Artifact.of(path.resolve())
        except OSError as error:
            left[path.name] = f"can't be read: {error.strerror or error}"
            continue
        if store.holds(artifact.sha256):
            continue
        try:
            store.refuse_taken_out([artifact.sha256], path.name, date_in(path.name))
        except InputError as error:
            left[path.name] = str(error).removeprefix(f"{path.name}: ")
            continue
        if (other := first.setdefault(artifact.sha256, path.name)) != path.name:
            left[path.name] = f"the same as {other}"
            continue
        new[path.name] = artifact
    return Arrived(new, left)


def _age_s(path: Path) -> float:
    """Time since a file was last written to [s]; where its clock was ahead of this one's, since it came."""
    now, about = time.time(), path.stat()
    return max(now - (about.st_mtime if about.st_mtime <= now else about.st_ctime), 0.0)


def parted(refused: Mapping[str, StepFailed]) -> tuple[dict[str, StepFailed], dict[str, str]]:
    """What was refused for good, and what was written to while it was read, as `Arrived.left` says it."""
    growing = {name: str(error) for name, error in refused.items() if isinstance(error, InputChanged)}
    return {name: error for name, error in refused.items() if name not in growing}, growing


def add(found: Mapping[str, Artifact], engine: str, history: str, settings: Mapping[str, Any]) -> Batch:
    """Add entries to the history and write its page."""
    from dieseltwin.api.histories import as_it_stands
    from dieseltwin.api.watch import begun
    from dieseltwin.engine import HEALTH
    from dieseltwin.errors import InputError
    from dieseltwin.learning.history import from_json
    from dieseltwin.settings.watch import WatchConfig

    store, added, refused = begun(history, engine), [], {}
    for recording, artifact in found.items():
        entry = from_json((artifact.path / ENTRY).read_text(encoding="utf-8"))
        if entry is None:
            raise StepFailed(f"{artifact.path / ENTRY}: got no entry of a history; delete it and run again", 1)
        try:
            if store.add(entry):
                added.append(recording)
        except InputError as error:
            refused[recording] = StepFailed(str(error), 2)
    state, name = as_it_stands(store, WatchConfig(**settings)), _name(Path(history).resolve())
    if not state.entries:
        return Batch(name, (), {}, state.sentence, None, {}, refused)
    folder = state.save(current().workspace.reports / "watch" / name)
    last = state.entries[-1]
    figures = {
        "recordings": float(len(state.entries)),
        "alarm": float(state.course.alarm is not None),
        "evidence": float(state.course.evidence[-1]),
        "hours": sum(entry.hours for entry in state.entries),
    }
    figures |= {f"{health}_since_reference": float(value) for health, value in zip(HEALTH, last.since, strict=True)}
    held = {entry.sha256: entry.path for entry in state.entries}
    return Batch(name, tuple(added), held, state.sentence, folder / PAGE, figures, refused)


def _name(history: Path) -> str:
    """What a history is called: its place in the workspace, or one of its own where another folder may be called so."""
    root = current().workspace.root.resolve()
    if history.is_relative_to(root) and history != root:
        return "-".join(history.relative_to(root).parts)
    return f"{history.name}-{hashlib.sha256(str(history).encode()).hexdigest()[:6]}"


def show(batch: Batch, known: Collection[str], refused: Mapping[str, StepFailed], left: Mapping[str, str]) -> None:
    """Print what was added, was known by its rows, left and refused, and what the history says.

    Raises the first refusal behind it.
    """
    display = current().display
    for name in batch.added:
        display.say(f"{name}: added")
    for name in known:
        display.say(f"{name}: its rows were there already")
    for name, why in left.items():
        display.say(f"{name}: left: {why}")
    for name, error in refused.items():
        display.say(f"{name}: not added: {error}")
    display.say(batch.sentence)
    if batch.page is not None:
        display.say(f"page: {batch.page}")
    for error in refused.values():
        raise error
