"""Answers sealed apart from the recordings: salted hashes are published first and checked when the seal is opened."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dieseltwin.atomic import write_bytes, write_text
from dieseltwin.errors import InputError

SEALED = "sealed"
"""Folder of the answers inside a benchmark; `run` never opens it."""

SALT_FILE = "salt.hex"


def new_salt() -> bytes:
    """32 secret bytes: without them a hash could be tried against every possible answer."""
    return secrets.token_bytes(32)


def salted_sha256(salt: bytes, content: bytes) -> str:
    """Hex digest of salt + content."""
    return hashlib.sha256(salt + content).hexdigest()


def write_salt(folder: Path, salt: bytes) -> None:
    """Keep the salt with the answers."""
    write_text(folder / SALT_FILE, salt.hex() + "\n")


def write_answers(folder: Path, name: str, answers: Mapping[str, Any], salt: bytes) -> str:
    """Write `name`.json into the sealed folder; returns the hash to publish."""
    content = (json.dumps(answers, indent=1, sort_keys=True, allow_nan=False) + "\n").encode()
    write_bytes(folder / f"{name}.json", content)
    return salted_sha256(salt, content)


def open_answers(folder: Path, name: str, published: str) -> dict[str, Any]:
    """Answers of one case.

    Raises:
        InputError: missing, or not what was sealed.
    """
    salt = read_salt(folder)
    path = folder / f"{name}.json"
    content = _bytes(path)
    if salted_sha256(salt, content) != published:
        raise InputError(str(path), "answers that do not fit the hash published in manifest.json",
                         "the answers that were sealed", "restore the sealed folder; a changed answer is no proof")
    return dict(json.loads(content))


def read_salt(folder: Path) -> bytes:
    """The salt of a sealed folder.

    Raises:
        InputError: missing or no hexadecimal number.
    """
    path = folder / SALT_FILE
    try:
        return bytes.fromhex(_bytes(path).decode().strip())
    except ValueError:
        raise InputError(str(path), "no hexadecimal number", "the salt of the seal", "restore the file") from None


def check_file(path: Path, published: str, salt: bytes = b"") -> None:
    """Raise InputError unless the (salted) hash of a file is the published one."""
    if salted_sha256(salt, _bytes(path)) != published:
        raise InputError(str(path), "another content than published in manifest.json", "the file that was made",
                         "restore it; scores of changed recordings mean nothing")


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        raise InputError(str(path), "no readable file", "a file of the benchmark", "give the folder of `challenge make`"
                         ) from None
