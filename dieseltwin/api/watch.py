"""The history of one engine: recordings added one by one, and an alarm that may be looked at after each."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dieseltwin.api.driving import DrivingDiscovered, DrivingQuestion, ask
from dieseltwin.api.engines import NAMED, diesel_engine
from dieseltwin.api.findings import Asked
from dieseltwin.api.histories import Watched, as_it_stands
from dieseltwin.api.reading import Channels, several
from dieseltwin.errors import InputError
from dieseltwin.learning.files import LearnedEngine, load_learned
from dieseltwin.learning.history import AND, HEALTHY, OR, Entry, History
from dieseltwin.learning.sketches import sketch
from dieseltwin.paths import file_sha256
from dieseltwin.recordings.dates import MODIFIED, Dated, dated
from dieseltwin.recordings.dates import date_in as date_in
from dieseltwin.recordings.named_columns import import_columns
from dieseltwin.settings.watch import WatchConfig


def watch(
    recordings: str | Path | Sequence[str | Path],
    engine: str | Path,
    history: str | Path,
    *,
    channels: Channels | None = None,
    sensors: Sequence[str] | None = None,
    settings: WatchConfig | None = None,
    progress: Callable[[int, int, str], object] | None = None,
    names: Mapping[str, str] | None = None,
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
        names: file -> what the history calls its recording, where that isn't the file's own name.

    Raises:
        InputError: an engine of which nothing was learned, a history of another engine, a damaged one.
    """
    learned = _learned(engine)
    store = History(history, _known_sha256(learned))
    added: dict[str, Entry] = {}
    known: list[str] = []
    refused: list[tuple[str, str]] = []
    files: Sequence[str | Path] = several(recordings)
    for k, path in enumerate(map(Path, files), 1):
        try:
            sha256 = file_sha256(path) if path.is_file() else ""
            store.refuse_taken_out([sha256], str(path), date_in(path.name))
            there = bool(sha256) and store.holds(sha256)
            name = (names or {}).get(str(path), "")
            entry = None if there else _added(store, *_asked(path, engine, learned, channels, sensors, name))
            if entry is None:
                known.append(str(path))
            else:
                added[str(path)] = entry
        except InputError as error:
            refused.append((str(path), str(error)))
        if progress is not None:
            progress(k, len(files), path.name)
    found = as_it_stands(store, settings)
    by_file = [f"{name} ({entry.date[:10]})" for name, entry in added.items() if entry.date_from == MODIFIED]
    return replace(
        found, added=tuple(added), verdicts=tuple(entry.verdict for entry in added.values()), known=tuple(known),
        refused=tuple(refused), dated_by_file=tuple(by_file),
    )  # fmt: skip


def _added(store: History, question: DrivingQuestion, day: Dated) -> Entry | None:
    """A recording, judged and now in the history; None where its rows were there already."""
    if store.holds(day.recording.rows_sha256):
        return None
    store.refuse_taken_out([day.recording.rows_sha256], str(day.recording.path), day.date)
    sketched = sketch(day.recording)
    store.refuse_shared(sketched, str(day.recording.path))
    entry = _entry(question.answer(), day, sketched)
    return entry if store.add(entry) else None


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
    path: Path, engine: str | Path, learned: LearnedEngine, channels: Channels | None, sensors: Sequence[str] | None,
    name: str = "",
) -> tuple[DrivingQuestion, Dated]:  # fmt: skip
    """A recording, read and checked, with its date; known by another name than its file's where one is given."""
    question = ask([import_columns(path, channels)], engine, channels, Asked(sensors), learned)
    day = dated(question.recording)
    if day is None:
        raise InputError(str(path), "no date", "a date in the file or in its name", "name it 2026-03-14.csv")
    if name:
        known = replace(question.recording, path=Path(name))
        question, day = replace(question, recording=known), replace(day, recording=known)
    return question, day


def _known_sha256(learned: LearnedEngine) -> str:
    """Hash of what is known of an engine: scores of recordings are in its coordinates. Beside an effect that was found
    since they are others."""
    belief = learned.belief
    since = "".join(term.model_dump_json() for term in learned.found)
    return hashlib.sha256(belief.mean.tobytes() + belief.covariance.tobytes() + since.encode()).hexdigest()


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
        verdict=AND.join(OR.join(effect.names) for effect in document.effects) or HEALTHY, sentence=found.sentence,
        rows_sha256=recording.rows_sha256, rows_sketch=sketched,
        sizes={effect.name: (effect.magnitude, effect.std) for effect in document.effects
               if effect.magnitude is not None and effect.std is not None},
    )  # fmt: skip
