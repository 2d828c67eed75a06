"""The history of one engine as it stands, what it says, and recordings that shouldn't be in it.

Apart from `watch`, which judges recordings: whoever looks at a history needn't wait until a search is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import atomic_folder
from dieseltwin.errors import InputError
from dieseltwin.learning.alarm import Course, course
from dieseltwin.learning.history import Entry, History, TakenOut
from dieseltwin.paths import file_sha256
from dieseltwin.report import history as pages
from dieseltwin.report.page import write_page
from dieseltwin.settings.defaults import default_watch
from dieseltwin.settings.names import listed
from dieseltwin.settings.watch import WatchConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE, TABLE = "history.html", "history.csv"
SHORTEST_HASH = 8  # digits of it that stand for a recording


@dataclass(frozen=True, repr=False)
class Watched(Result):
    """The history of an engine.

    Attributes:
        entries: recordings by date.
        course: evidence after each, and the alarm.
        alarms_per_year: false alarms per engine and year, at most.
        added: names of the recordings that were added now.
        verdicts: of those, each by itself.
        known: names of those that were there before.
        refused: name -> why it can't be used.
        dated_by_file: names and days of those among the added that have no other date than their file's last change.
        taken_out: recordings that don't count any more, and why; course_with_them: evidence as if they did, None for
            none of them.
    """

    entries: tuple[Entry, ...]
    course: Course
    alarms_per_year: float
    added: tuple[str, ...] = ()
    verdicts: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    refused: tuple[tuple[str, str], ...] = ()
    dated_by_file: tuple[str, ...] = ()
    taken_out: tuple[TakenOut, ...] = ()
    course_with_them: Course | None = None

    @property
    def sentence(self) -> str:
        said = pages.sentence(self.entries, self.course, self.alarms_per_year)
        if self.course_with_them is None:
            return said
        return f"{said} {pages.without(self.taken_out, self.course_with_them)}"

    def table(self) -> pd.DataFrame:
        """One row a recording: date, name, hours, ambient, health since the reference, evidence, verdict."""
        return pages.table(self.entries, self.course)

    def plot(self, name: str | None = None) -> Figure:
        """`health`: health parameters since the reference; `evidence`: that something else has changed."""
        return drawn(self, {"health": lambda self: pages.health(self.entries, self.course),
                            "evidence": lambda self: pages.evidence(self.entries, self.course)}, name)  # fmt: skip

    def save(self, out: str | Path) -> Path:
        """Write history.html and history.csv."""
        with atomic_folder(out) as folder:
            self.table().to_csv(folder / TABLE, index=False, lineterminator="\n")
            write_page(pages.page(self.entries, self.course, self.sentence, self.taken_out), folder / PAGE)
        return Path(out)

    def lines(self) -> list[str]:
        told = [f"{name}: added, {said} by itself" for name, said in zip(self.added, self.verdicts, strict=True)]
        told += [f"{name}: was there already" for name in self.known]
        told += [f"{name}: not added: {why.removeprefix(f'{name}: ')}" for name, why in self.refused]
        if self.dated_by_file:
            told.append("note: dated by the file's last change, which copying may have moved: "
                        f"{listed(self.dated_by_file)}; where that isn't the day, take it out (`dieseltwin watch "
                        "remove`), put the day into the file's name (2026-03-14.csv) and add it again")  # fmt: skip
        return [*told, self.sentence]


def history(folder: str | Path, *, settings: WatchConfig | None = None) -> Watched:
    """The history of an engine as it stands.

    Raises:
        InputError: no history there, or a damaged one.
    """
    return as_it_stands(History(folder), settings)


def remove(folder: str | Path, recording: str | Path, reason: str) -> Watched:
    """Take a recording out of a history that was added by mistake.

    It stays in the file with the day and the reason, and what the evidence is with it is said from then on: an alarm
    can't be taken out unseen.

    Args:
        folder: of the history.
        recording: its name, its date, the first digits of its hash, or the file itself.
        reason: in a few words.

    Raises:
        InputError: no history, no such recording or several, no reason.
    """
    store = History(folder)
    if not reason.strip():
        raise InputError("--reason", "no word", "why the recording shouldn't count", "say it: it stands on the page")
    entries = store.entries()
    out = [taken for taken in store.taken_out() if _meant(recording, [taken.entry])]
    if out and not _meant(recording, entries):
        raise InputError(str(recording), f"what is taken out already ({out[0]})", "a recording of the history",
                         "let it count again with `dieseltwin watch restore`, or leave it as it is")  # fmt: skip
    store.take_out(_one(recording, entries, "in the history").sha256, " ".join(reason.split()))
    return history(folder)


def restore(folder: str | Path, recording: str | Path) -> Watched:
    """Let a recording count again that was taken out; arguments and errors as of `remove`."""
    store = History(folder)
    taken = {out.entry.sha256: out for out in store.taken_out()}
    found = _one(recording, [out.entry for out in taken.values()], "taken out of the history")
    store.put_back(taken[found.sha256])
    return history(folder)


def _meant(recording: str | Path, entries: Sequence[Entry]) -> list[Entry]:
    """The entries that a name or its beginning, a date, the beginning of a hash or a file stands for."""
    text = str(recording)
    sha256 = file_sha256(Path(text)) if Path(text).is_file() else ""
    ways: list[Callable[[Entry], bool]] = [
        lambda entry: entry.sha256 == sha256,
        lambda entry: entry.path == Path(text).name,
        lambda entry: len(text) >= SHORTEST_HASH and entry.sha256.startswith(text.lower()),
        lambda entry: entry.date[:10] == text,
        lambda entry: bool(text) and entry.path.startswith(text),
    ]
    return next((some for way in ways if (some := [entry for entry in entries if way(entry)])), [])


def _one(recording: str | Path, entries: Sequence[Entry], where: str) -> Entry:
    """The one entry that is meant."""
    text, found = str(recording), _meant(recording, entries)
    if len(found) == 1:
        return found[0]
    shown = listed([f"{e.path} ({e.date[:10]}, {e.sha256[:SHORTEST_HASH]})" for e in found or entries]) or "none"
    if found:
        raise InputError(text, f"{len(found)} recordings {where}: {shown}", "one of them", "give its hash")
    raise InputError(text, f"no recording {where}", shown, "give one by its name, its hash or as a file")


def as_it_stands(store: History, settings: WatchConfig | None) -> Watched:
    """What a history says, also one that holds no recording yet; arguments as of `watch`."""
    settings = default_watch() if settings is None else settings
    entries = store.entries()
    found = _course(entries, settings)
    taken = store.taken_out()
    every = sorted([*entries, *(out.entry for out in taken)], key=lambda entry: (entry.date, entry.sha256))
    with_them = None
    if taken:
        with_them = _course(every, settings)
    return Watched(entries, found, settings.alarms_per_year, taken_out=taken, course_with_them=with_them)


def _course(entries: Sequence[Entry], settings: WatchConfig) -> Course:
    return course([entry.scores for entry in entries], [entry.moment for entry in entries], settings,
                  [entry.shown for entry in entries])  # fmt: skip
