"""What was worked out from texts, kept in a file of the cache for the next process.

Reading the library's 240 modules takes seconds, and nearly all of them say what they said the last time. A value is
found by the hash of all that it was worked out from, this code included; a file that is damaged is as good as none.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError

# Beyond that many only those are kept that this process asked for: half a megabyte.
_MOST = 4096

# Files whose code decides what a text says.
_READERS = ("code_reading.py", "library_files.py", "sources.py", "remembered.py")


class Remembered:
    """Values by what they were worked out from, in the file ``path``; None: in this process alone."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._kept: dict[str, Any] = {} if path is None else _read(path)
        self._asked: dict[str, Any] = {}
        self._new = False

    def value(self, work: Callable[[], Any], *parts: str) -> Any:
        """What ``work`` gives, a plain JSON value; ``parts``: all that it depends on, and what it is."""
        key = hashlib.sha256("\0".join((_reader(), *parts)).encode()).hexdigest()[:32]
        if key not in self._asked:
            if key not in self._kept:
                self._kept[key], self._new = work(), True
            self._asked[key] = self._kept[key]
        return self._asked[key]

    def save(self) -> None:
        """Write what is new. A disk that is full or can't be written to costs the next process some seconds."""
        if self._path is None or not self._new:
            return
        self._new = False
        kept = dict(self._kept if len(self._kept) <= _MOST else self._asked)
        text = json.dumps(kept, sort_keys=True)
        with suppress(OSError, InputError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self._path, f"{_sha256(text)}\n{text}\n")


def _read(path: Path) -> dict[str, Any]:
    try:
        digest, _, text = path.read_text(encoding="utf-8").partition("\n")
    except (OSError, UnicodeDecodeError):
        return {}
    return cast(dict[str, Any], json.loads(text)) if _sha256(text.rstrip("\n")) == digest else {}


@lru_cache(maxsize=1)
def _reader() -> str:
    """The code that reads texts, and the Python whose grammar it reads them by."""
    here = Path(__file__).parent
    return _sha256(sys.version + "".join((here / name).read_text(encoding="utf-8") for name in _READERS))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
