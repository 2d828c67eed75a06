"""Checksums inside the text files that our own commands write, so that a flipped byte is named when they are read.

A checksum is verified where there is one. A person may edit any of these files: whoever does removes the line, and a
file without one is read as it stands. It is a guard against disks and transfers, not against people.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dieseltwin.errors import InputError

KEY = "content_sha256"  # files have a "sha256" of their own: that of the recording
MARK = f"# {KEY}: "
REMARK = " of all lines above; remove this line when you edit the file"
TOO_DEEP = "lists in lists thousands deep"
_DIGITS = 64


def sealed_text(text: str) -> str:
    """Text of YAML with a last line, a comment, that holds the SHA-256 of all lines before it."""
    text = text if text.endswith("\n") else f"{text}\n"
    return f"{text}{MARK}{_of_text(text)}{REMARK}\n"


def check_text(text: str, where: str) -> None:
    """Verify the last line of `sealed_text`; a text that doesn't end so passes.

    Raises:
        InputError: the text isn't the one that was written.
    """
    body, mark, tail = text.rpartition(MARK)
    if not mark or (body and not body.endswith("\n")):
        return
    if tail[:_DIGITS] != _of_text(body):
        raise InputError(where, "other content than was written (its SHA-256 differs)", "the file as it was written",
                         f"put the file back; if you edited it, remove the line that begins with {MARK.strip()!r}")


def sealed_json(content: Mapping[str, Any]) -> dict[str, Any]:
    """An object with one more key, `content_sha256`, over all others; their order and the file's layout don't count."""
    return {**content, KEY: _of_json(content)}


def opened_json(content: Any, where: str, do: str) -> Any:
    """What `sealed_json` was given; anything without the key passes.

    Args:
        content: as read.
        where: name of the file, for messages.
        do: how it is made again.

    Raises:
        InputError: the content isn't the one that was written.
    """
    if not isinstance(content, dict):
        return content
    seal = next((name for name in content if _nearly_key(name)), None)
    if seal is None:
        return content
    rest = {name: value for name, value in content.items() if name != seal}
    if seal != KEY or content[KEY] != _of_json(rest):
        raise InputError(where, "other content than was written (its SHA-256 differs)", "the file as it was written",
                         f"put the file back, or {do}; if you edited it, remove its key {KEY!r}")
    return rest


def read_json(path: Path, wanted: str, do: str) -> dict[str, Any]:
    """The object in a file, as `sealed_json` was given it.

    Args:
        wanted: what the file should be; do: how it is made again.

    Raises:
        InputError: no such file, no JSON object, or another content than was written.
    """
    try:
        content = opened_json(json.loads(path.read_text(encoding="utf-8")), str(path), do)
    except OSError as error:
        raise InputError(str(path), (error.strerror or str(error)).lower(), wanted, do) from None
    except ValueError as error:
        raise InputError(str(path), error, wanted, do) from None
    except RecursionError:
        raise InputError(str(path), TOO_DEEP, wanted, do) from None
    if not isinstance(content, dict):
        raise InputError(str(path), f"a {type(content).__name__}", wanted, do)
    return content


def _nearly_key(name: str) -> bool:
    """Whether it is the checksum's key with at most one other character: a flipped byte there hides the checksum."""
    return len(name) == len(KEY) and sum(a != b for a, b in zip(name, KEY, strict=True)) <= 1


def _of_text(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _of_json(content: Mapping[str, Any]) -> str:
    plain = json.loads(json.dumps(content, allow_nan=True))  # tuples are lists, keys are text, as in the file
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
