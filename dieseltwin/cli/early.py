"""Checks before anything slow is imported: who mistypes a path or a name hears it at once."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.errors import InputError
from dieseltwin.paths import refuse_unreadable, same_file


def check_there(path: Path | None, allowed: str = "a recording") -> None:
    """Refuse an input file that isn't there or is none; None (an option that wasn't given) passes.

    Raises:
        InputError: no such file, a folder, a pipe.
    """
    if path is not None:
        refuse_unreadable(path, allowed)


def check_apart(out: Path, *inputs: Path | str | None) -> None:
    """Refuse to write over what is read.

    Raises:
        InputError: `out` is one of the inputs, by whatever name.
    """
    for path in inputs:
        if path is not None and same_file(out, path):
            raise InputError(f"--out {out}", f"the file that is read ({path})", "another file", "choose another name")
