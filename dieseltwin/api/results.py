"""What every function of the front door hands back: words, a table, a figure, and the files of its command."""

from __future__ import annotations

import html
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from dieseltwin.errors import InputError
from dieseltwin.settings.names import unknown_name

if TYPE_CHECKING:  # a simulation without a figure needn't load matplotlib
    import pandas as pd
    from matplotlib.figure import Figure

    from dieseltwin.report.style import ReportFigure

Found = TypeVar("Found")


class Result(ABC):
    """A finished answer. Immutable; nothing is computed anew but drawings and tables."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """What was found, in words."""

    @abstractmethod
    def table(self) -> pd.DataFrame:
        """The numbers, units in the names or in a column of their own."""

    @abstractmethod
    def plot(self, name: str | None = None) -> Figure:
        """A figure: the one of that name, or the one that says most.

        Raises:
            InputError: an unknown name, or nothing to draw under it.
        """

    @abstractmethod
    def save(self, out: str | Path) -> Path:
        """Write what the command writes to its --out (a folder or a file), all or nothing; returns `out`.

        Raises:
            InputError: a place that can't be written to.
        """

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """All that is doubtful: code, text, affects; with --strict a command ends with 3 where there is any."""
        return []

    def lines(self) -> list[str]:
        """What the command prints."""
        return [self.sentence]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.sentence}>"

    def __str__(self) -> str:
        return "\n".join(self.lines()).strip()

    def _repr_html_(self) -> str:
        """For notebooks: the sentence and the table."""
        return f"<p>{html.escape(self.sentence)}</p>{self.table().to_html(max_rows=20, float_format='{:.6g}'.format)}"


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
