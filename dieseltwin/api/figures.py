"""One drawing of a result by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, TypeVar

from dieseltwin.errors import InputError
from dieseltwin.settings.names import unknown_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dieseltwin.report.style import ReportFigure

Found = TypeVar("Found")


def drawn(found: Found, drawings: Mapping[str, Callable[[Found], ReportFigure | None]], name: str | None) -> Figure:
    """The drawing of that name; None takes the first that there is data for.

    Raises:
        InputError: an unknown name, or no data for what was asked.
    """
    if name is not None and name not in drawings:
        raise unknown_name("plot", name, list(drawings))
    for draw in drawings.values() if name is None else [drawings[name]]:
        figure = draw(found)
        if figure is not None:
            return figure.figure
    raise InputError("plot", f"no data for {name or 'any figure'}", ", ".join(drawings), "choose another")
