"""Reports on paper."""

from __future__ import annotations

from pathlib import Path

from dieseltwin.errors import InputError
from dieseltwin.report.pdf import browser, print_pdf

REPORT, PDF = "report.html", "report.pdf"


def check_printable() -> None:
    """Make sure that reports can be printed, before the work.

    Raises:
        InputError: no browser is installed.
    """
    browser()


def print_report(folder: str | Path) -> Path:
    """Print the report of a result folder to `report.pdf` beside it.

    Raises:
        InputError: no report there, or no browser that prints.
    """
    page = Path(folder) / REPORT
    if not page.is_file():
        raise InputError(str(page), "no report", "the folder of a result that has one", "leave --pdf out")
    return print_pdf(page, page.with_name(PDF))
