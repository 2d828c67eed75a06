"""The file beside a learned engine's YAML: found, unchanged, and the mean corrections in it.

What else is in it is read by `dieseltwin.learning.files`.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.engine.map_corrections import basis
from dieseltwin.errors import InputError

LEARNED, SHA256 = "learned", "learned_sha256"
"""Keys of an engine file that name the second file and its hash."""

WITHOUT_THREADS: Mapping[str, Any] = {"use_threads": False, "pre_buffer": False}
"""For small Parquet files: pools of threads take longer to start than to read, and may still run when Python ends."""

LEARN_AGAIN = "put the file back, or learn the engine again with `dieseltwin learn`"


def learned_beside(path: Path) -> Path:
    """The file that `learn` writes beside an engine file."""
    return path.with_name(f"{path.stem if path.suffix == '.yaml' else path.name}.learned.parquet")


def replaced_by(target: Path) -> Path:
    """Where the file that another one takes the place of is kept, until the engine file names the new one."""
    return target.with_name(f"{target.name}.before")


def learned_bytes(path: Path, document: Mapping[str, Any]) -> bytes:
    """Content of the file that an engine file names.

    Args:
        path: of the engine file; document: its content.

    Raises:
        InputError: no such file beside it, or not the one that was written with it.
    """
    name = document[LEARNED]
    if not isinstance(name, str) or name in ("", ".", "..") or Path(name).name != name:
        raise InputError(f"{path}: learned", repr(name), "the name of a file beside it", LEARN_AGAIN)
    target = path.with_name(name)
    wanted = str(document.get(SHA256))
    try:
        content = target.read_bytes()
        if hashlib.sha256(content).hexdigest() != wanted and replaced_by(target).is_file():
            content = replaced_by(target).read_bytes()  # learning more was ended before the engine file was written
    except (OSError, ValueError):
        raise InputError(f"{path}: learned", f"no {target.name} beside it", "both files", LEARN_AGAIN) from None
    got = hashlib.sha256(content).hexdigest()
    if got != wanted:
        raise InputError(str(target), f"SHA-256 {got[:12]}...", f"{wanted[:12]}..., as {path.name} says", LEARN_AGAIN)
    return content


def mean_coefficients(path: Path, document: Mapping[str, Any]) -> tuple[float, ...]:
    """Mean coefficients (K,) of the maps' corrections that an engine file names [-].

    Raises:
        InputError: the file is missing, changed, not readable or of another version's corrections.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = learned_bytes(path, document)
    try:
        table = pq.read_table(io.BytesIO(content), columns=["name", "mean"], **WITHOUT_THREADS)
        found = dict(zip(table["name"].to_pylist(), np.array(table["mean"], dtype=np.float64), strict=True))
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError):
        raise InputError(str(document[LEARNED]), "not readable", "what `dieseltwin learn` wrote", LEARN_AGAIN) from None
    if any(name not in found for name in basis().names):
        raise InputError(str(document[LEARNED]), "other corrections", "those of this program", LEARN_AGAIN)
    return tuple(float(found[name]) for name in basis().names)
