"""What the discoveries of all kinds of machine have in common: the question that is asked, and the findings."""

from __future__ import annotations

import os
import platform
import time
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, Protocol

import pandas as pd

from dieseltwin.api.engines import AnyEngine, Engine
from dieseltwin.api.folders import keep_apart
from dieseltwin.api.reading import Channels, Opened, Source
from dieseltwin.api.results import Result
from dieseltwin.api.versions import versions
from dieseltwin.atomic import atomic_folder, write_json
from dieseltwin.discovery.verdict.document import FILE_NAME, Discrepancy
from dieseltwin.discovery.verdict.explain import DETAILS, Known
from dieseltwin.errors import InputError
from dieseltwin.paths import file_sha256
from dieseltwin.recordings.reader import Recording
from dieseltwin.sealed import sealed_json
from dieseltwin.settings.defaults import default_discover
from dieseltwin.settings.discovery import DiscoverConfig
from dieseltwin.settings.names import unknown_name

RUNTIME = "runtime.json"
FILES = (FILE_NAME, DETAILS, "report.html", "report.pdf", "figures", RUNTIME)
COLUMNS = ("effect", "magnitude", "std", "unit", "probability", "equivalent", "law")


@dataclass(frozen=True)
class Asked:
    """What may be asked of a discovery beside the recording and the engine.

    Attributes:
        sensors: columns to use; None is all that there are.
        withhold: effects to keep out of the catalogue.
        map_tolerance: standard deviation of the maps' smooth relative error that is believed [-]; None: the settings'.
        seed: of everything random; None: the settings'.
        reference: recordings of the engine when it was known to be well; it is learned from them first.
        settings: what is decided by; `discover` of params.yaml.
        time_s: of the whole discovery [s], after which the best answer so far is given; None: the settings'.
        explain: name of the catalogue that is to be explained with the answer.
    """

    sensors: Sequence[str] | None = None
    withhold: Sequence[str] | None = None
    map_tolerance: float | None = None
    seed: int | None = None
    reference: Sequence[Source | Recording] = ()
    settings: DiscoverConfig = field(default_factory=default_discover)
    time_s: float | None = None
    explain: str | None = None

    def __post_init__(self) -> None:
        for name in ("sensors", "withhold"):
            if isinstance(value := getattr(self, name), str):  # one name is no sequence of letters
                object.__setattr__(self, name, (value,))

    @property
    def random_seed(self) -> int:
        """Of everything random."""
        return self.settings.seed if self.seed is None else self.seed

    def check(self, catalogue: Collection[str], by_settings: Sequence[str] = ()) -> None:
        """Refuse what no kind of machine takes.

        Args:
            catalogue: effects that can be kept out of it.
            by_settings: those that the settings keep out.

        Raises:
            InputError: an effect to withhold that the catalogue doesn't hold, a negative seed.
        """
        for effect in (*(self.withhold or ()), *by_settings):
            if effect not in catalogue:
                raise unknown_name("--withhold", effect, list(catalogue))
        if self.random_seed < 0:
            raise InputError("--seed", self.random_seed, "0 or more", "choose another")


class Discovered(Result):
    """What the twin leaves out of a machine: the document, and the repaired engine.

    Attributes:
        own_files: names of the files that `save` writes beside `FILES`, and of those that an older one may have left.
    """

    own_files: ClassVar[tuple[str, ...]] = ("engine.yaml",)

    @property
    @abstractmethod
    def document(self) -> Discrepancy:
        """What `discrepancy.json` holds."""

    @property
    @abstractmethod
    def engine(self) -> Engine:
        """The repaired engine."""

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """As in `discrepancy.json`."""
        return [doubt.model_dump(mode="json") for doubt in self.document.warnings]

    def table(self) -> pd.DataFrame:
        """One row for each effect that was found; none where nothing is missing."""
        rows = [(e.name, e.magnitude, e.std, e.unit, e.probability, ", ".join(e.equivalent_names), e.law)
                for e in self.document.effects]
        return pd.DataFrame(rows, columns=list(COLUMNS))

    def save(self, out: str | Path) -> Path:
        """discrepancy.json, details.json, report.html, figures/, runtime.json and the `own_files`, into a folder."""
        keep_apart(out, FILE_NAME)
        began = time.perf_counter()
        with atomic_folder(out, owned=(*FILES, *self.own_files)) as folder:
            self.document.write(folder / FILE_NAME)
            write_json(folder / DETAILS, sealed_json(self._details()))
            write_json(folder / RUNTIME, self._write(folder, began))
        return Path(out)

    @abstractmethod
    def _details(self) -> Mapping[str, Any]:
        """What `details.json` holds, as JSON types."""

    @abstractmethod
    def _write(self, folder: Path, began: float) -> dict[str, Any]:
        """Write the report and `own_files`; what `runtime.json` holds, where saving began at clock `began` [s]."""


class Kind(Protocol):
    """A kind of machine: its module, which knows how it is asked about."""

    def ask(
        self, read: Sequence[Opened], engine: AnyEngine | None, channels: Channels | None, question: Asked
    ) -> Question:  # fmt: skip
        """Check what was read and what is asked of it; see `discovery.discover`.

        Args:
            read: one recording or several, opened.
            engine: that is meant: name, file or parameters.
            channels: channel map that the recordings were opened with.
            question: what is asked beside them.

        Raises:
            InputError: what can't be used, or can't carry a verdict.
        """
        ...


class Question(ABC):
    """A recording and an engine, read and checked, ready for the search."""

    @property
    @abstractmethod
    def about(self) -> str:
        """What is going to be looked at, for one who waits."""

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

    def getting_ready(self) -> AbstractContextManager[None]:
        """While it is open, what the answer's files need is got ready beside the search, where a core is idle."""
        return nullcontext()

    def answered_in(self, folder: Path) -> bool:
        """Whether a folder holds the answer to just this question."""
        return False

    @abstractmethod
    def answer(self) -> Discovered:
        """Search, name, size, prove.

        Raises:
            InputError: what was found is no twin of what was recorded.
        """


def channels_sha256(channels: Channels | None) -> str | None:
    """Hash of a channel map, as its file or as what it says: one and the same file is read otherwise with another."""
    if isinstance(channels, str | Path):
        return sha256_if_there(channels)
    return None if channels is None else sha256(repr(channels).encode()).hexdigest()


def sha256_if_there(path: str | Path) -> str | None:
    """Hash of a file that may be missing; the reader complains about that better."""
    return file_sha256(path) if Path(path).is_file() else None


def machine() -> dict[str, Any]:
    """Where, when and with which versions it was run, for `runtime.json`."""
    return {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "versions": {name: found for name, found in versions().items() if name != "platform"},
    }
