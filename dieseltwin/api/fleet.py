"""Histories of many engines: which of them calls for somebody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import pandas as pd

from dieseltwin.api.histories import PAGE, Watched, history
from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import atomic_folder
from dieseltwin.errors import InputError
from dieseltwin.report import fleet as pages
from dieseltwin.report.page import write_page
from dieseltwin.settings.defaults import default_watch
from dieseltwin.settings.watch import WatchConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLEET_PAGE, FLEET_TABLE = "fleet.html", "fleet.csv"


@dataclass(frozen=True, repr=False)
class Fleet(Result):
    """Histories of many engines.

    Attributes:
        engines: name -> its history.
        alarms_per_year: false alarms per engine and year, at most.
        refused: folder -> why its history can't be read.
    """

    engines: dict[str, Watched]
    alarms_per_year: float
    refused: tuple[tuple[str, str], ...] = ()

    @property
    def _judged(self) -> list[pages.OfEngine]:
        return [pages.OfEngine(name, one.entries, one.course) for name, one in self.engines.items()]

    @property
    def sentence(self) -> str:
        return pages.sentence(self._judged, self.alarms_per_year)

    def table(self) -> pd.DataFrame:
        """One row an engine, those that call for somebody first: state, alarm, health since the reference."""
        return pages.table(self._judged)

    def plot(self, name: str | None = None) -> Figure:
        """`health`: of every engine by its last recording, since its reference."""
        return drawn(self._judged, {"health": pages.health}, name)

    def save(self, out: str | Path) -> Path:
        """Write fleet.html, fleet.csv, and a folder for each engine with the page and the table of its history."""
        with atomic_folder(out) as folder:
            self.table().to_csv(folder / FLEET_TABLE, index=False, lineterminator="\n")
            links = {name: f"{quote(name)}/{PAGE}" for name in self.engines}
            for name, one in self.engines.items():
                one.save(folder / name)
            write_page(pages.page(self._judged, self.sentence, links), folder / FLEET_PAGE)
        return Path(out)

    def lines(self) -> list[str]:
        told = [f"{one.name}: {one.state}{': ' if one.words else ''}{one.words}"
                for one in pages.ordered(self._judged)]  # fmt: skip
        told += [f"{where}: not read: {why.removeprefix(f'{where}: ')}" for where, why in self.refused]
        return [*told, self.sentence]


def fleet(histories: str | Path | Sequence[str | Path], *, settings: WatchConfig | None = None) -> Fleet:
    """The histories of many engines as they stand, side by side.

    An engine is called as the folder of its history is, and by the folder above as well where two are called alike.
    A history that can't be read stops none of the others.

    Args:
        histories: folders of histories.
        settings: when to raise an alarm; `watch` of params.yaml.

    Raises:
        InputError: no folder, or the same one twice.
    """
    settings = default_watch() if settings is None else settings
    given = [histories] if isinstance(histories, str | Path) else list(histories)
    folders = [Path(folder).resolve() for folder in given]
    if not folders:
        raise InputError("HISTORY", "nothing", "folders of histories", "name one or more")
    for folder in folders:
        if folders.count(folder) > 1:
            raise InputError(str(folder), "the same history twice", "each once", "name it once")
    engines: dict[str, Watched] = {}
    refused: list[tuple[str, str]] = []
    for folder in folders:
        alike = sum(other.name == folder.name for other in folders) > 1
        name = f"{folder.parent.name}-{folder.name}" if alike else folder.name
        try:
            engines[name if name not in engines else f"{name} ({len(engines) + 1})"] = history(
                folder, settings=settings)  # fmt: skip
        except InputError as error:
            refused.append((str(folder), str(error)))
    return Fleet(engines, settings.alarms_per_year, tuple(refused))
