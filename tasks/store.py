"""Results by content: ``.cache/<step>/<key>/`` folders that are whole or absent, and are believed only if they agree.

A result is written to a temporary name, described by a manifest of file hashes, and renamed: whoever is killed leaves a
temporary folder that nobody reads. A hit counts only if every file still has the hash of the manifest: one flipped byte
and the step runs again.

The folder may be shared by several machines (:mod:`tasks.cluster`): a temporary folder's name says which machine and
which process writes it, and a machine judges by the process only what is its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shutil
import tempfile
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dieseltwin.paths import file_sha256
from tasks.failures import InputChanged

MANIFEST = "manifest.json"

# A file that a step writes under this name holds times, dates or host: kept, checked, but no part of the result's hash.
RUNTIME = "runtime.json"

_TEMPORARY = ".partial-"
SCRATCH = ".scratch-"


@dataclass(frozen=True)
class Artifact:
    """A file or folder and the sha256 of its contents (not of its name)."""

    path: Path
    sha256: str

    @classmethod
    def of(cls, path: Path) -> Artifact:
        """Hash what is there now. Raises ``FileNotFoundError``."""
        return cls(path, content_hash(path))

    @classmethod
    def from_dict(cls, value: Mapping[str, str], root: Path) -> Artifact:
        """Inverse of :meth:`to_dict`; relative paths are below ``root``."""
        return cls(root / value["path"], value["sha256"])

    def to_dict(self, root: Path) -> dict[str, str]:
        """Plain form for Prefect and JSON: path (relative to ``root`` where below it) and hash."""
        path = self.path.relative_to(root) if self.path.is_relative_to(root) else self.path
        return {"path": str(path), "sha256": self.sha256}

    def still_agrees(self) -> bool:
        """Whether the contents are those that were hashed."""
        return self.path.exists() and content_hash(self.path) == self.sha256

    def __truediv__(self, name: str) -> Artifact:
        """One file or folder inside, hashed by itself: who needs only that isn't disturbed by the others."""
        return Artifact.of(self.path / name)


def check_inputs(step: str, inputs: Mapping[str, Artifact], root: Path) -> None:
    """Raise ``InputChanged`` where an input is no longer what the key of a step's result says of it."""
    for name, artifact in inputs.items():
        if not artifact.still_agrees():
            where = artifact.to_dict(root)["path"]
            raise InputChanged(f"{step}: input {name} ({where}) changed while the run was on; run again")


class Store:
    """The results of one workspace, below ``root``."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def folder(self, step: str, key: str) -> Path:
        """Where the result of ``step`` under ``key`` lies or would lie."""
        return self.root / step / key

    def find(self, step: str, key: str) -> Artifact | None:
        """The stored result, or None where there is none or it no longer agrees with its manifest."""
        folder = self.folder(step, key)
        try:
            manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
            wanted = {**manifest["files"], **manifest["runtime_files"]}
        except (OSError, ValueError, KeyError, TypeError):
            return None
        if manifest.get("key") != key or wanted != {**_hashes(folder), **_hashes(folder, runtime=True)}:
            return None
        os.utime(folder)  # when it was last of use, for `prune`
        return Artifact(folder, _digest(manifest["files"]))

    def prune(self, unused_s: float) -> int:
        """Remove results that nobody asked for within the last ``unused_s`` seconds, and temporary folders as old,
        whoever's they were, or of processes that no longer live. Returns how many results; another run may prune at the
        same time."""
        limit = time.time() - unused_s
        removed = 0
        for manifest in self.root.glob(f"*/*/{MANIFEST}"):
            folder = manifest.parent
            if folder.name.startswith(_TEMPORARY) or not _is_older(folder, limit):
                continue
            grave = folder.parent / _temporary_name(folder.name)
            try:
                folder.rename(grave)
            except FileNotFoundError:  # the other run was first
                continue
            shutil.rmtree(grave, ignore_errors=True)
            removed += 1
        for left in self.root.glob(f"*/{_TEMPORARY}*"):
            if _is_older(left, limit) or _is_left(left.name):
                shutil.rmtree(left, ignore_errors=True)
        return removed

    def manifest(self, artifact: Artifact) -> dict[str, Any]:
        """What is written beside a stored result: key, inputs, parameters, sources."""
        manifest: dict[str, Any] = json.loads((artifact.path / MANIFEST).read_text(encoding="utf-8"))
        return manifest

    @contextmanager
    def writing(self, step: str, key: str, provenance: Mapping[str, Any]) -> Iterator[Path]:
        """A temporary folder that becomes the result of ``step`` under ``key`` when the block ends without an error."""
        target = self.folder(step, key)
        self._sweep(target)
        partial = target.parent / _temporary_name(key)
        partial.mkdir(parents=True)
        try:
            yield partial
            manifest = {
                "schema": 1,
                "step": step,
                "key": key,
                "files": _hashes(partial),
                "runtime_files": _hashes(partial, runtime=True),
                "provenance": dict(provenance),
            }
            (partial / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True), encoding="utf-8")
            self._move(partial, target, step, key)
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def _move(self, partial: Path, target: Path, step: str, key: str) -> None:
        """Rename into place; a concurrent run's good result stays, a bad one makes way."""
        for _ in range(3):
            try:
                partial.rename(target)
                return
            except OSError:
                if self.find(step, key) is not None:
                    return
                grave = target.parent / _temporary_name(key)
                try:
                    target.rename(grave)
                except FileNotFoundError:
                    continue
                shutil.rmtree(grave, ignore_errors=True)
        partial.rename(target)

    def _sweep(self, target: Path) -> None:
        """Remove temporary folders of this machine's processes that no longer live."""
        for folder in target.parent.glob(f"{_TEMPORARY}*"):
            if _is_left(folder.name):
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def scratch(out: Path) -> Iterator[Path]:
    """An empty folder for the time of the block, inside the folder ``out`` that a step writes its result into.

    A step that is killed leaves it there and not with other programs' temporary files, and the next one sweeps it.
    """
    with tempfile.TemporaryDirectory(dir=out, prefix=SCRATCH) as folder:
        yield Path(folder)


def host() -> str:
    """This machine's name as temporary names hold it: letters, digits and underscores."""
    return re.sub(r"[^A-Za-z0-9]", "_", platform.node()) or "unknown"


def content_hash(path: Path) -> str:
    """sha256 of a file's bytes, or of a folder's (relative name, sha256) pairs; manifests and run times don't count."""
    return _digest(_hashes(path)) if path.is_dir() else file_sha256(path)


def replace_folder(target: Path, files: Mapping[str, Path]) -> None:
    """Make ``target`` hold exactly ``files`` (relative name -> source), through a temporary folder beside it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    for stale in target.parent.glob(f"{target.name}.*.partial"):
        if _is_abandoned(stale.name.split(".")[-3:-1]):
            shutil.rmtree(stale, ignore_errors=True)
    partial = target.with_name(f"{target.name}.{host()}.{os.getpid()}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir()
    try:
        for name, source in sorted(files.items()):
            destination = partial / name
            destination.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, destination)
        if target.exists():
            # Renamed away before it is deleted: at no time is there a folder with a part of the files.
            old = target.with_name(f"{target.name}.old.{host()}.{os.getpid()}.partial")
            target.rename(old)
            partial.rename(target)
            shutil.rmtree(old, ignore_errors=True)
        else:
            partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _hashes(folder: Path, *, runtime: bool = False) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): file_sha256(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != MANIFEST and (path.name == RUNTIME) is runtime
    }


def _digest(hashes: Mapping[str, str]) -> str:
    text = "\n".join(f"{digest} {name}" for name, digest in sorted(hashes.items()))
    return hashlib.sha256(text.encode()).hexdigest()


def _temporary_name(key: str) -> str:
    return f"{_TEMPORARY}{key}-{host()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"


def _is_left(temporary: str) -> bool:
    """Whether a temporary folder of the store, by its name, is this machine's and its process lives no longer."""
    return _is_abandoned(temporary.split("-")[-3:-1])


def _is_abandoned(machine_and_pid: list[str]) -> bool:
    """Whether a temporary folder is this machine's and its process lives no longer."""
    if len(machine_and_pid) != 2 or machine_and_pid[0] != host():
        return False
    return not (machine_and_pid[1].isdigit() and _is_alive(int(machine_and_pid[1])))


def _is_older(folder: Path, limit: float) -> bool:
    """Whether it was last of use before ``limit`` [s since 1970]; no for what is gone."""
    try:
        return folder.stat().st_mtime < limit
    except FileNotFoundError:
        return False


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
