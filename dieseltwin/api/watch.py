"""The history of one engine: recordings added one by one, and an alarm that may be looked at after each."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from dieseltwin.api.driving import DrivingDiscovered, DrivingQuestion, ask
from dieseltwin.api.engines import NAMED, diesel_engine
from dieseltwin.api.findings import Asked
from dieseltwin.api.reading import Channels, several
from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import atomic_folder
from dieseltwin.errors import InputError
from dieseltwin.learning.alarm import Course, course
from dieseltwin.learning.files import LearnedEngine, load_learned
from dieseltwin.learning.history import Entry, History, TakenOut
from dieseltwin.learning.sketches import sketch
from dieseltwin.paths import file_sha256
from dieseltwin.recordings.dates import Dated, dated
from dieseltwin.recordings.dates import date_in as date_in
from dieseltwin.recordings.named_columns import import_columns
from dieseltwin.report import history as pages
from dieseltwin.report.page import write_page
from dieseltwin.settings.names import listed
from dieseltwin.settings.params import default_watch
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
        return [*told, *(f"{name}: not added: {why}" for name, why in self.refused), self.sentence]


def watch(
    recordings: str | Path | Sequence[str | Path],
    engine: str | Path,
    history: str | Path,
    *,
    channels: Channels | None = None,
    sensors: Sequence[str] | None = None,
    settings: WatchConfig | None = None,
    progress: Callable[[int, int, str], object] | None = None,
) -> Watched:
    """Judge recordings one by one, add them to the history of their engine, and say whether it has changed.

    A recording that is there already is passed over. One that can't be used, or is in part one of the history, stops
    none of the others.

    Args:
        recordings: files; their dates are in them, in their names (2026-03-14), or those of the files.
        engine: file that `learn` wrote.
        history: folder of the history, made where there is none.
        channels: channel map of the recordings.
        sensors: columns to use; None is all that there are.
        settings: when to raise an alarm; `watch` of params.yaml.
        progress: is told of every recording when it is through: how many are, of how many, its name.

    Raises:
        InputError: an engine of which nothing was learned, a history of another engine, a damaged one.
    """
    learned = _learned(engine)
    store = History(history, _known_sha256(learned))
    added: dict[str, str] = {}  # name -> verdict
    known: list[str] = []
    refused: list[tuple[str, str]] = []
    files: Sequence[str | Path] = several(recordings)
    for k, path in enumerate(map(Path, files), 1):
        try:
            sha256 = file_sha256(path) if path.is_file() else ""
            store.refuse_taken_out([sha256], str(path))
            there = bool(sha256) and store.holds(sha256)
            verdict = None if there else _added(store, *_asked(path, engine, learned, channels, sensors))
            if verdict is None:
                known.append(str(path))
            else:
                added[str(path)] = verdict
        except InputError as error:
            refused.append((str(path), str(error)))
        if progress is not None:
            progress(k, len(files), path.name)
    found = as_it_stands(store, settings)
    return replace(
        found, added=tuple(added), verdicts=tuple(added.values()), known=tuple(known), refused=tuple(refused)
    )


def _added(store: History, question: DrivingQuestion, day: Dated) -> str | None:
    """What a recording shows by itself, now in the history; None where its rows were there already."""
    if store.holds(day.recording.rows_sha256):
        return None
    store.refuse_taken_out([day.recording.rows_sha256], str(day.recording.path))
    sketched = sketch(day.recording)
    store.refuse_shared(sketched, str(day.recording.path))
    entry = _entry(question.answer(), day, sketched)
    return entry.verdict if store.add(entry) else None


def judge(
    recording: str | Path, engine: str | Path, *, channels: Channels | None = None, sensors: Sequence[str] | None = None
) -> Entry:
    """What `watch` would add for one recording, without a history to add it to; arguments and errors as there."""
    question, day = _asked(Path(recording), engine, _learned(engine), channels, sensors)
    return _entry(question.answer(), day, sketch(day.recording))


def begun(folder: str | Path, engine: str | Path) -> History:
    """The history in a folder to add entries to, made where there is none.

    Raises:
        InputError: an engine of which nothing was learned, a history of another engine, a damaged one.
    """
    return History(folder, _known_sha256(_learned(engine)))


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
    store.take_out(_one(recording, store.entries(), "in the history").sha256, " ".join(reason.split()))
    return history(folder)


def restore(folder: str | Path, recording: str | Path) -> Watched:
    """Let a recording count again that was taken out; arguments and errors as of `remove`."""
    store = History(folder)
    taken = {out.entry.sha256: out for out in store.taken_out()}
    found = _one(recording, [out.entry for out in taken.values()], "taken out of the history")
    store.put_back(taken[found.sha256])
    return history(folder)


def _one(recording: str | Path, entries: Sequence[Entry], where: str) -> Entry:
    """The one entry that a name, a date, the beginning of a hash or a file stands for."""
    text = str(recording)
    sha256 = file_sha256(Path(text)) if Path(text).is_file() else ""
    ways: list[Callable[[Entry], bool]] = [
        lambda entry: entry.sha256 == sha256,
        lambda entry: entry.path == Path(text).name,
        lambda entry: len(text) >= SHORTEST_HASH and entry.sha256.startswith(text.lower()),
        lambda entry: entry.date[:10] == text,
    ]
    found = next((some for way in ways if (some := [entry for entry in entries if way(entry)])), [])
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
    found = course([entry.scores for entry in entries], [entry.moment for entry in entries], settings)
    taken = store.taken_out()
    every = sorted([*entries, *(out.entry for out in taken)], key=lambda entry: (entry.date, entry.sha256))
    with_them = None
    if taken:
        with_them = course([entry.scores for entry in every], [entry.moment for entry in every], settings)
    return Watched(entries, found, settings.alarms_per_year, taken_out=taken, course_with_them=with_them)


def _learned(engine: str | Path) -> LearnedEngine:
    there = Path(engine).is_file()
    learned = load_learned(Path(engine)) if there else None
    if learned is None:
        if there or str(engine) in NAMED:
            diesel_engine(engine)  # a petrol engine that was learned has no history
        raise InputError(str(engine), "no learned engine", "a file that `dieseltwin learn` wrote",
                         "learn the engine from recordings of when it was well")  # fmt: skip
    return learned


def _asked(
    path: Path, engine: str | Path, learned: LearnedEngine, channels: Channels | None, sensors: Sequence[str] | None
) -> tuple[DrivingQuestion, Dated]:
    """A recording, read and checked, with its date."""
    question = ask([import_columns(path, channels)], engine, channels, Asked(sensors), learned)
    day = dated(question.recording)
    if day is None:
        raise InputError(str(path), "no date", "a date in the file or in its name", "name it 2026-03-14.csv")
    return question, day


def _known_sha256(learned: LearnedEngine) -> str:
    """Hash of what is known of an engine: scores of recordings are in its coordinates."""
    belief = learned.belief
    return hashlib.sha256(belief.mean.tobytes() + belief.covariance.tobytes()).hexdigest()


def _entry(found: DrivingDiscovered, day: Dated, sketched: str) -> Entry:
    """A judged recording, and the sketch of its rows, as a row of the history."""
    seen, document, recording = found.found.observed, found.document, day.recording
    if seen is None:
        raise InputError(str(recording.path), "no fit with an interval", "one that the engine's maps explain",
                         "look at it with `dieseltwin discover`")  # fmt: skip
    return Entry(
        sha256=recording.sha256, path=str(recording.path.name if recording.path else "recording"),
        date=day.date.isoformat(), date_from=day.date_from,
        hours=recording.running_s / 3600.0,
        p_amb_pa=recording.p_amb_pa, t_amb_k=recording.t_amb_k, health=seen.health,
        health_covariance=seen.health_covariance, since=seen.since, since_std=seen.since_std, scores=seen.scores,
        verdict=" + ".join(effect.name for effect in document.effects) or "healthy", sentence=found.sentence,
        rows_sha256=recording.rows_sha256, rows_sketch=sketched,
    )  # fmt: skip
