"""The last task of a flow: copy results from the cache to the folders that DVC owns.

DVC deletes a stage's outs before it runs the stage, so results can't live there; a copy costs a second. Run times stay
out: the folders are the same bit by bit whenever the results are.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tasks.store import MANIFEST, RUNTIME, Artifact, content_hash, replace_folder


def publish(target: Path, parts: Mapping[str, Artifact]) -> Artifact:
    """Make the folder ``target`` hold the files of ``parts`` (sub-folder, "" for the top -> result).

    Written beside and renamed; a folder that agrees already is left alone. Returns it with its hash.
    """
    files: dict[str, Path] = {}
    for name, artifact in parts.items():
        for path in sorted(artifact.path.rglob("*")):
            if path.is_file() and path.name not in (MANIFEST, RUNTIME):
                files[(Path(name) / path.relative_to(artifact.path)).as_posix()] = path
    if not _agrees(target, files):
        replace_folder(target, files)
    return Artifact.of(target)


def _agrees(target: Path, files: Mapping[str, Path]) -> bool:
    present = {path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file()}
    return present == set(files) and all(
        content_hash(target / name) == content_hash(source) for name, source in files.items()
    )
