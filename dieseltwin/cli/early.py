"""Checks before anything slow is imported: who mistypes a path or a name hears it at once."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.errors import InputError


def check_there(path: Path | None, allowed: str = "a recording") -> None:
    """Refuse an input file that isn't there; None (an option that wasn't given) passes.

    Raises:
        InputError: no such file. What is there but may not be read is for the reader to say.
    """
    try:
        if path is not None:
            path.stat()
    except FileNotFoundError:
        raise InputError(str(path), "no such file", allowed, "check the path") from None
    except OSError:
        return
