"""The page of a discovery on driving, in the process beside: what loads, what it draws ahead, and the page itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from dieseltwin.discovery.verdict.curves import Discovery

if TYPE_CHECKING:
    from dieseltwin.report.style import ReportFigure

_ahead: dict[str, ReportFigure | None] = {}
"""Figures that this process has drawn before it was given the page; none in any other than the one beside."""


def load() -> None:
    """Have everything at hand that draws."""
    import dieseltwin.report.discovery_page  # noqa: F401
    from dieseltwin.report import style

    style.load()


def draw_ahead(wanted: Callable[[], bool], found: Discovery) -> None:
    """The figures that are final before health is, until the page itself is wanted; it draws what is left."""
    from dieseltwin.report.discovery_page import of_curves  # loads matplotlib
    from dieseltwin.report.encoding import finished

    for name, drawing in of_curves(found).items():
        if wanted():
            return
        _ahead[name] = finished(drawing)


def write(found: Discovery, folder: Path) -> None:
    """The page and its figures as files."""
    from dieseltwin.report.discovery_page import build_discovery_report  # loads matplotlib

    build_discovery_report(found, folder / "report.html", figures_dir=folder / "figures", ahead=_ahead)
