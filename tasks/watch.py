"""Steps of the flow ``watch``: new recordings of a folder into the history of their engine."""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dieseltwin.atomic import write_json
from tasks.failures import InputChanged, StepFailed
from tasks.run_context import Progress, current, split_arguments, step
from tasks.store import Artifact, scratch

ENTRY = "entry.json"
REFUSED = "refused.json"  # beside the history
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
    from contextlib import chdir

    from dieseltwin.api.watch import judge
    from dieseltwin.learning.history import to_json

    with scratch(out) as folder:
        shutil.copyfile(recording, folder / name)
        if modified_s is not None:
            os.utime(folder / name, (modified_s, modified_s))
        shutil.copyfile(engine, folder / "engine.yaml")
        shutil.copyfile(learned, folder / beside)
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
    ``figures``: numbers for the tracker; ``refused``: recordings by name that are in part one of the history;
    ``failed``: those of them that the history's own file is in the way of.
    """

    history: str
    added: tuple[str, ...]
    recordings: Mapping[str, str]
    sentence: str
    page: Path | None
    figures: Mapping[str, float]
    refused: Mapping[str, StepFailed]
    failed: frozenset[str] = frozenset()


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
        if path.name.startswith(".") or path.is_dir():
            continue
        if not path.is_file():
            left[path.name] = "a link to a file that isn't there" if path.is_symlink() else "no file with contents"
            continue
        if path.suffix.lower() not in ENDINGS:
            left[path.name] = f"got the ending {path.suffix or 'of no kind'}; allowed: {' '.join(ENDINGS)}"
            continue
        try:
            if (age_s := _age_s(path)) < _SETTLED_S:
                left[path.name] = f"written to {age_s:.0f} s ago; taken {_SETTLED_S:.0f} s after the last change"
                continue
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


@dataclass(frozen=True)
class Asked:
    """Recordings of a folder that are judged now, and what is known of those that were refused.

    ``arguments``: of the step, by name; ``keys``: of the step, by name; ``before``: names of recordings that were
    refused and told by an earlier run, which aren't judged again; ``told``: sha256 of a recording -> name, why, key of
    the step that refused it ("" where the history did, which is asked again every time); ``path``: file of ``told``.
    """

    arguments: Mapping[str, Mapping[str, Any]]
    keys: Mapping[str, str]
    before: tuple[str, ...]
    told: Mapping[str, Mapping[str, str]]
    path: Path

    def new(self, refused: Mapping[str, StepFailed]) -> dict[str, StepFailed]:
        """Those of the refused that no earlier run told of."""
        return {name: error for name, error in refused.items() if self._told(name).get("why") != str(error)}

    def remember(self, refused: Mapping[str, StepFailed], batch: Batch) -> None:
        """Keep what was told; what went wrong with the tool or the history, not a recording, is told every time."""
        kept = {
            self._sha256(name): {
                "name": name, "why": str(error), "key": "" if name in batch.refused else self.keys[name]
            }
            for name, error in refused.items()
            if error.exit_code == 2 and name not in batch.failed
        }  # fmt: skip
        if kept:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_json(self.path, {**self.told, **kept})

    def _sha256(self, name: str) -> str:
        return str(self.arguments[name]["recording"].sha256)

    def _told(self, name: str) -> Mapping[str, str]:
        return self.told.get(self._sha256(name), {})


def asked(new: Mapping[str, Artifact], engine: str, history: str, settings: Mapping[str, Any]) -> Asked:
    """What is to be judged of the new recordings of a folder: not what this code refused before, under the same name
    and with the same settings."""
    path = Path(history) / REFUSED
    told, files = _read(path), engine_files(engine)
    arguments, keys, before = {}, {}, []
    for name, recording in new.items():
        given = {
            "recording": recording, "kind": Path(name).stem, "name": name,
            "modified_s": modified_s(recording.path, name), "sections": watched.sections_of(settings), **files,
        }  # fmt: skip
        key = watched.key(current(), *split_arguments(given))
        if told.get(recording.sha256, {}).get("key") == key:
            before.append(name)
        else:
            arguments[name], keys[name] = given, key
    return Asked(arguments, keys, tuple(before), told, path)


def _read(path: Path) -> dict[str, dict[str, str]]:
    """What was refused and told; nothing where the file is missing or damaged: it is told once more."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    rows = found.items() if isinstance(found, dict) else ()
    return {sha256: row for sha256, row in rows if isinstance(row, dict)}


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

    store, added, refused, failed = begun(history, engine), [], {}, set()
    for recording, artifact in found.items():
        entry = from_json((artifact.path / ENTRY).read_text(encoding="utf-8"))
        if entry is None:
            raise StepFailed(f"{artifact.path / ENTRY}: got no entry of a history; delete it and run again", 1)
        try:
            if store.add(entry):
                added.append(recording)
        except InputError as error:
            refused[recording] = StepFailed(str(error), 2)
            if error.what == str(store.path):
                failed.add(recording)
    state, name = as_it_stands(store, WatchConfig(**settings)), _name(Path(history).resolve())
    if not state.entries:
        return Batch(name, (), {}, state.sentence, None, {}, refused, frozenset(failed))
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
    return Batch(name, tuple(added), held, state.sentence, folder / PAGE, figures, refused, frozenset(failed))


def _name(history: Path) -> str:
    """What a history is called: its place in the workspace, or one of its own where another folder may be called so."""
    root = current().workspace.root.resolve()
    if history.is_relative_to(root) and history != root:
        return "-".join(history.relative_to(root).parts)
    return f"{history.name}-{hashlib.sha256(str(history).encode()).hexdigest()[:6]}"


def show(batch: Batch, asked: Asked, found: Collection[str], refused: Mapping[str, StepFailed],
         left: Mapping[str, str]) -> None:  # fmt: skip
    """Print what was added, was known by its rows, left and refused, and what the history says; a refusal that an
    earlier run told of is counted.

    Raises the first new refusal behind it.
    """
    display, new = current().display, asked.new(refused)
    for name in batch.added:
        display.say(f"{name}: added")
    for name in found:
        if name not in {*batch.added, *batch.refused}:
            display.say(f"{name}: its rows were there already")
    for name, why in left.items():
        display.say(f"{name}: left: {why}")
    for name, error in new.items():
        display.say(f"{name}: not added: {str(error).removeprefix(f'{name}: ')}")
    if before := len(asked.before) + len(refused) - len(new):
        display.say(f"refused before: {before} ({asked.path})")
    display.say(batch.sentence)
    if batch.page is not None:
        display.say(f"page: {batch.page}")
    asked.remember(new, batch)
    for error in new.values():
        raise error
