"""The folders that results are saved in: each belongs to one command, as all of them write a `report.html`."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.discovery.verdict.document import FILE_NAME as DISCREPANCY
from dieseltwin.errors import InputError
from dieseltwin.report.results import FILE_NAME as IDENTIFICATION

_SAVED_BY = {DISCREPANCY: "discover", IDENTIFICATION: "identify"}


def keep_apart(out: str | Path, document: str) -> None:
    """Refuse a folder with results of another command, whose page and figures would be replaced.

    Args:
        out: where results shall go; it may not be there yet.
        document: what they are read from, which tells whose they are.

    Raises:
        InputError: it holds another command's document.
    """
    for other, command in _SAVED_BY.items():
        if other != document and (Path(out) / other).exists():
            raise InputError(f"folder {out}", f"the results of {command}, whose page would be lost",
                             f"a new folder, or one of {_SAVED_BY[document]}", "choose another folder")  # fmt: skip
