"""A report as PDF: a browser that is installed prints it, offline and without reading anything of its user's."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from dieseltwin.atomic import atomic_path
from dieseltwin.errors import InputError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
_FLAGS = (
    "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-quic", "--disable-extensions", "--no-pdf-header-footer", "--virtual-time-budget=5000",
)  # fmt: skip
LONGEST_S = 120.0
REPORT, PDF = "report.html", "report.pdf"


def browser() -> str:
    """The browser that prints.

    Raises:
        InputError: none is installed.
    """
    found = next((path for path in map(shutil.which, BROWSERS) if path is not None), None)
    if found is None:
        raise InputError("--pdf", "no browser that could print", "Chromium or Chrome on the PATH",
                         "install one (apt-get install chromium), or print report.html by hand")
    return found


def print_pdf(page: str | Path, out: str | Path) -> Path:
    """Print an HTML file to a PDF file.

    Raises:
        InputError: no browser, or one that doesn't print.
    """
    program, page = browser(), Path(page).resolve()
    with tempfile.TemporaryDirectory(prefix="dieseltwin-pdf-") as profile, atomic_path(out) as temporary:
        # The page is ours and loads nothing; the sandbox needs rights that containers and root don't have.
        command = [program, *_FLAGS, "--no-sandbox", f"--user-data-dir={profile}",
                   f"--print-to-pdf={temporary.resolve()}", page.as_uri()]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, timeout=LONGEST_S, check=False)
        except subprocess.TimeoutExpired:
            raise InputError("--pdf", f"no page from {program} within {LONGEST_S:g} s", "a browser that prints",
                             "print report.html by hand") from None
        if not temporary.is_file() or not temporary.read_bytes().startswith(b"%PDF"):
            words = done.stderr.decode("utf-8", errors="replace").strip().splitlines()
            raise InputError("--pdf", f"no page from {program} ({words[-1] if words else done.returncode})",
                             "a browser that prints", "print report.html by hand")  # fmt: skip
    return Path(out)


def print_report(folder: str | Path) -> Path:
    """Print the report of a result folder to `report.pdf` beside it.

    Raises:
        InputError: no report there, or no browser that prints.
    """
    page = Path(folder) / REPORT
    if not page.is_file():
        raise InputError(str(page), "no report", "the folder of a result that has one", "leave --pdf out")
    return print_pdf(page, page.with_name(PDF))
