"""What the discoveries of all kinds of machine have in common: the question that is asked, and the findings."""

from __future__ import annotations

import os
import platform
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

from dieseltwin.api.engines import Engine
from dieseltwin.api.results import Result
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.discovery.verdict.explain import Known

COLUMNS = ("effect", "magnitude", "std", "unit", "probability", "equivalent", "law")


class Discovered(Result):
    """What the twin leaves out of a machine: the document, and the repaired engine."""

    @property
    @abstractmethod
    def document(self) -> Discrepancy:
        """What `discrepancy.json` holds."""

    @property
    @abstractmethod
    def engine(self) -> Engine:
        """The repaired engine."""

    def table(self) -> pd.DataFrame:
        """One row for each effect that was found; none where nothing is missing."""
        rows = [(e.name, e.magnitude, e.std, e.unit, e.probability, ", ".join(e.equivalent_names), e.law)
                for e in self.document.effects]
        return pd.DataFrame(rows, columns=list(COLUMNS))


class Question(ABC):
    """A recording and an engine, read and checked, ready for the search."""

    @property
    @abstractmethod
    def about(self) -> str:
        """What is going to be looked at, for one who waits."""

    @property
    @abstractmethod
    def kind(self) -> str:
        """Which machines it is about, for messages: "for settled points"."""

    def preview(self) -> Iterator[str]:
        """Lines of what this recording could show, before anything is fitted; none where that isn't known.

        Raises:
            InputError: it could show nothing.
        """
        return iter(())

    @property
    def catalogue(self) -> Mapping[str, Known]:
        """Effects that an answer can be asked about; none where answers aren't explained."""
        return {}

    def answered_in(self, folder: Path) -> bool:
        """Whether a folder holds the answer to just this question."""
        return False

    @abstractmethod
    def answer(self) -> Discovered:
        """Search, name, size, prove.

        Raises:
            InputError: what was found is no twin of what was recorded.
        """


def machine() -> dict[str, Any]:
    """Where and when it was run, for `runtime.json`."""
    return {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
    }
