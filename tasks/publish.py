"""The last task of a flow: copy results from the cache to the folders that DVC owns.

DVC deletes a stage's outs before it runs the stage, so results can't live there; a copy costs a second. Run times stay
out: the folders are the same bit by bit whenever the results are.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from dieseltwin.atomic import atomic_folder
from tasks.run_context import StepFailed
from tasks.store import MANIFEST, RUNTIME, Artifact, content_hash, replace_folder


def publish(target: Path, parts: Mapping[str, Path]) -> Artifact:
    """Make the folder ``target`` hold ``parts`` (name inside it -> file or folder; "" is the folder itself).

    Written beside and renamed; a folder that agrees already is left alone. Returns it with its hash.
    """
    files = _files_of(parts)
    if not _agrees(target, files):
        replace_folder(target, files)
    return Artifact.of(target)


def publish_beside(target: Path, parts: Mapping[str, Path]) -> None:
    """Put ``parts`` into the folder ``target``, in which other flows and the user keep files and folders of their own.

    Only the folders and files that ``parts`` names are replaced.
    """
    files = _files_of(parts)
    own = {name.partition("/")[0] for name in files if "/" in name}
    if all(_agrees(target / name, _below(files, name)) for name in own) and _hold_the_same(target, files):
        return
    with atomic_folder(target, own) as partial:
        for name, source in files.items():
            (partial / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, partial / name)


def published(path: Path, maker: str) -> Artifact:
    """What an earlier flow published, hashed. Raises ``StepFailed`` (exit status 2) where it isn't there."""
    if not path.exists():
        raise StepFailed(
            f"{path.name}: not found in {path.parent}; it is made by `python -m flows.{maker}` (or `make run`)",
            exit_code=2,
        )
    return Artifact.of(path)


def _files_of(parts: Mapping[str, Path]) -> dict[str, Path]:
    """Every file of the parts by its name in the folder."""
    files: dict[str, Path] = {}
    for name, source in parts.items():
        if source.is_file():
            files[name] = source
            continue
        for path in sorted(source.rglob("*")):
            if path.is_file() and path.name not in (MANIFEST, RUNTIME):
                files[(Path(name) / path.relative_to(source)).as_posix()] = path
    return files


def _below(files: Mapping[str, Path], folder: str) -> dict[str, Path]:
    return {name.removeprefix(f"{folder}/"): source for name, source in files.items() if name.startswith(f"{folder}/")}


def _agrees(target: Path, files: Mapping[str, Path]) -> bool:
    present = {path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file()}
    return present == set(files) and _hold_the_same(target, files)


def _hold_the_same(target: Path, files: Mapping[str, Path]) -> bool:
    return all(
        (target / name).is_file() and content_hash(target / name) == content_hash(source)
        for name, source in files.items()
    )
