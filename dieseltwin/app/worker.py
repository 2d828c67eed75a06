"""A job in a process of its own: `python -m dieseltwin.app.worker FOLDER JOB MEMORY_GB`.

It ends when its server does (its standard input closes), and can't take more memory than it is given. What it has to
say goes into files of the job: lines of progress, and at the end the outcome.
"""

from __future__ import annotations

import os
import resource
import sys
import threading
import traceback
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dieseltwin.app.kept import (
    ARCHIVE,
    CHANNELS,
    DETAILS,
    ENGINE,
    HISTORY,
    HISTORY_PAGE,
    LEARNED_FILE,
    MAP,
    OUTCOME,
    OVERVIEW,
    PROGRESS,
    RESULT,
    UPLOADED,
    WATCHED,
    Job,
    KeptRecording,
    Outcome,
    Store,
    save,
)  # fmt: skip
from dieseltwin.app.workplace import GIGABYTE, Limits, Workplace
from dieseltwin.atomic import atomic_path, write_json, write_text
from dieseltwin.errors import DieselTwinError, InputError, one_line
from dieseltwin.notes import counted
from dieseltwin.sealed import sealed_json, sealed_text

if TYPE_CHECKING:
    from dieseltwin.api.histories import Watched

MOST_LINES = 200  # of progress


class Worker:
    """One job, its files, and what it says."""

    def __init__(self, store: Store, job: Job) -> None:
        self.store, self.job = store, job
        self.folder = store.job_folder(job.id)
        self._said = 0

    def say(self, line: str) -> None:
        """A line of progress."""
        self._said += 1
        if self._said <= MOST_LINES:
            with (self.folder / PROGRESS).open("a", encoding="utf-8") as file:
                file.write("".join(c if c.isprintable() else " " for c in line).rstrip() + "\n")

    def stage(self, words: str) -> None:
        """The step that begins, which the page shows as such."""
        self.say(f"# {words}")

    def recording(self) -> KeptRecording:
        """The recording that the job is about."""
        return self.kept(self.job.recordings[0])

    def kept(self, key: str) -> KeptRecording:
        kept = self.store.recording(key)
        if kept is None:
            raise InputError("recording", "one that was taken away", "one that is kept", "drop it again")
        return kept

    def file_of(self, kept: KeptRecording) -> Path:
        return self.store.recording_folder(kept.id) / kept.file

    def map_of(self, kept: KeptRecording) -> Path | None:
        path = self.store.recording_folder(kept.id) / MAP
        return path if path.is_file() else None

    def engine(self) -> str | Path:
        """What the front door takes as an engine: a name, or a file."""
        kept = self.store.engine(self.job.engine)
        return self.job.engine if kept is None else self.store.engine_folder(kept.id) / ENGINE

    def result(self) -> Path:
        return self.folder / RESULT

    def readable(self, text: str) -> str:
        """A message with people's names of files instead of those of the server."""
        for key in self.job.recordings:
            kept = self.store.recording(key)
            if kept is not None:
                for path in (self.file_of(kept), self.store.recording_folder(key) / MAP):
                    shown = "the channel map" if path.name == MAP else kept.name
                    text = text.replace(str(path), shown)
        return text.replace(f"{self.store.workplace.folder}{os.sep}", "")


def _look(worker: Worker) -> str:
    from dieseltwin.api.channels import channels

    kept = worker.recording()
    folder = worker.store.recording_folder(kept.id)
    database = None if kept.database is None else folder / kept.database
    found = channels(worker.file_of(kept), database, kept.cylinders)
    if found.proposal.guesses:
        with atomic_path(folder / OVERVIEW) as temporary:
            found.plot().savefig(temporary, format="png", dpi=90)
    if not (folder / MAP).is_file():
        theirs = replace(found.proposal, raw=replace(found.proposal.raw, path=Path(kept.name)))  # not the server's name
        replace(found, proposal=theirs).save(folder / MAP)
        text = (folder / MAP).read_text(encoding="utf-8")
        write_text(folder / MAP, text.replace(f"{folder.resolve()}{os.sep}", ""))  # a DBC is found beside the map
    write_json(folder / CHANNELS, sealed_json(found.to_json()))
    return found.sentence


def _check(worker: Worker) -> str:
    from dieseltwin.api.reading import description, read

    kept = worker.recording()
    return "\n".join(description(read(worker.file_of(kept), worker.map_of(kept), worker.engine())))


def _discover(worker: Worker) -> str:
    from dieseltwin.api.discovery import ask
    from dieseltwin.api.driving import DrivingQuestion
    from dieseltwin.api.reading import named

    worker.stage(f"Reading {counted(len(worker.job.recordings), 'recording')}")
    if len(worker.job.recordings) > 1:
        dropped = sorted(map(worker.kept, worker.job.recordings), key=lambda kept: (kept.added, kept.name))
        own = [named(worker.file_of(kept), worker.map_of(kept), kept.name) for kept in dropped]  # names may say dates
        question = ask(own, worker.engine())
    else:
        kept = worker.recording()
        question = ask(worker.file_of(kept), worker.engine(), channels=worker.map_of(kept))
        if isinstance(question, DrivingQuestion):  # people forward the report: it names their file, not the server's
            question = replace(question, recording=replace(question.recording, path=Path(kept.name)))
    worker.stage("What could be seen at all")
    for line in question.preview():
        worker.say(line)
    worker.stage("Searching for what the twin leaves out")
    found = question.answer()
    worker.stage("Writing the report")
    found.save(worker.result())
    return found.sentence


def _identify(worker: Worker) -> str:
    from dieseltwin.api.engines import diesel_engine
    from dieseltwin.api.identification import Setup, ask, sensors_of
    from dieseltwin.api.reading import diesel_recording

    kept = worker.recording()
    worker.stage("Reading the recording")
    engine = diesel_engine(worker.engine())
    source = diesel_recording(worker.file_of(kept), worker.map_of(kept), engine, sensors=())
    setup = Setup(params=worker.job.options.get("params"), sensors=sensors_of(source))
    question = ask(source, engine, runs=int(worker.job.options.get("runs", 1)), setup=setup)
    for note in question.notes:
        worker.say(note)
    worker.stage(f"Fitting {len(question.problems)} segments")
    found = replace(question, recording_name=kept.name).answer()
    worker.stage("Writing the report")
    found.save(worker.result())
    return found.sentence


def _learn(worker: Worker) -> str:
    from dieseltwin.api.engines import diesel_engine
    from dieseltwin.api.learning import learn
    from dieseltwin.api.reading import diesel_recording

    base = worker.engine()
    worker.stage(f"Reading {counted(len(worker.job.recordings), 'recording')}")
    sources = []
    for key in worker.job.recordings:
        kept = worker.kept(key)
        sources.append(diesel_recording(worker.file_of(kept), worker.map_of(kept), diesel_engine(base), sensors=()))
    worker.stage("Learning the engine's maps, health and sensors")
    found = learn(sources, base)
    for line in found.lines():
        worker.say(line)
    worker.result().mkdir(exist_ok=True)
    found.save(worker.result() / ENGINE)
    return found.sentence


def _watch(worker: Worker) -> str:
    """Add a recording to the history of its engine, under the date that its name says, if any."""
    from dieseltwin.api.watch import date_in, watch

    kept = worker.recording()
    source = worker.file_of(kept)
    date = date_in(kept.name)
    named = worker.folder / f"{date.strftime('%Y-%m-%dT%H%M') if date else 'recording'}{source.suffix}"
    named.unlink(missing_ok=True)
    named.symlink_to(source)
    folder = worker.store.engine_folder(worker.job.engine)
    worker.stage("Judging the recording")
    found = watch([named], worker.engine(), folder / HISTORY, channels=worker.map_of(kept),
                  names={str(named): kept.name})  # fmt: skip
    if found.refused:
        raise DieselTwinError(found.refused[0][1].replace(str(named), kept.name))
    for line in found.lines():
        worker.say(line.replace(str(named), kept.name))
    return _keep_history(worker, found)


def _history(worker: Worker) -> str:
    """Take a recording out of the history of an engine, or let it count again."""
    from dieseltwin.api.histories import remove, restore

    folder = worker.store.engine_folder(worker.job.engine) / HISTORY
    which, reason = str(worker.job.options["recording"]), worker.job.options.get("reason")
    return _keep_history(worker, restore(folder, which) if reason is None else remove(folder, which, str(reason)))


def _keep_history(worker: Worker, found: Watched) -> str:
    """Write what a history says beside its engine; its sentence."""
    worker.stage("Writing the history")
    folder = worker.store.engine_folder(worker.job.engine)
    found.save(worker.result())
    write_text(folder / HISTORY_PAGE, (worker.result() / HISTORY_PAGE).read_text(encoding="utf-8"))
    there = [{"sha256": e.sha256, "words": f"{e.path}, {e.date[:10]}, {e.verdict}"} for e in found.entries]
    out = [{"sha256": one.entry.sha256, "words": str(one)} for one in found.taken_out]
    calls = found.course.alarm is not None or bool(found.entries and found.entries[-1].shown.names)
    said = {"sentence": found.sentence, "alarm": calls, "recordings": there, "taken_out": out}
    write_json(folder / WATCHED, sealed_json(said))
    return found.sentence


def _engine(worker: Worker) -> str:
    """An uploaded engine, whose second file has another name here than its author gave it."""
    import yaml

    from dieseltwin.api.engines import engine, parameter_changes
    from dieseltwin.api.learning import learned_summary
    from dieseltwin.settings.strict import read_mapping

    folder = worker.store.engine_folder(worker.job.engine)
    document = read_mapping(folder / UPLOADED)
    if "learned" in document:
        document["learned"] = LEARNED_FILE
    write_text(folder / ENGINE, sealed_text(yaml.safe_dump(document, sort_keys=False, allow_unicode=True)))
    machine = engine(folder / ENGINE)
    learned = learned_summary(folder / ENGINE)
    write_json(folder / DETAILS, sealed_json({"changes": parameter_changes(machine), "learned": learned}))
    return f"{type(machine).__name__.removesuffix('Parameters').lower()} engine"


_KINDS: dict[str, Callable[[Worker], str]] = {
    "channels": _look, "check": _check, "discover": _discover, "identify": _identify, "learn": _learn,
    "engine": _engine, "watch": _watch, "history": _history,
}  # fmt: skip


def _archive(worker: Worker, channel_map: bytes | None) -> None:
    """Everything of a result in one file to take away, with the channel map that it was read by."""
    with (atomic_path(worker.folder / ARCHIVE) as temporary,
          zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as zipped):
        for path in sorted(worker.result().rglob("*")):
            if path.is_file():
                zipped.write(path, path.relative_to(worker.result()).as_posix())
        if channel_map is not None:
            zipped.writestr(MAP, channel_map)


def _map_read_by(worker: Worker) -> bytes | None:
    """The channel map of a job's only recording: who takes that away later, or maps it anew, spoils no result."""
    if len(worker.job.recordings) != 1:
        return None
    path = worker.map_of(worker.recording())
    return None if path is None else path.read_bytes()


def work(worker: Worker) -> Outcome:
    """Do the job; whatever happens is an outcome."""
    try:
        channel_map = _map_read_by(worker) if worker.job.long else None
        sentence = _KINDS[worker.job.kind](worker)
        if worker.job.long:
            _archive(worker, channel_map)
    except DieselTwinError as error:
        text = error.line() if isinstance(error, InputError) else one_line(str(error))
        return Outcome(error=worker.readable(text))
    except MemoryError:
        return Outcome(error="it needs more memory than this server gives a job; cut the recording")
    except Exception as error:
        traceback.print_exc()  # into the job's log
        return Outcome(error=worker.readable(one_line(f"{type(error).__name__}: {error}")), defect=True)
    return Outcome(sentence=worker.readable(sentence))


def _end_with_the_server() -> None:
    """Wait until the server closes our standard input, which it does by ending, however it ends."""
    os.read(0, 1)
    os._exit(3)


def main(arguments: list[str]) -> None:
    """Run one job of a workplace."""
    folder, key, memory_gb = arguments
    threading.Thread(target=_end_with_the_server, daemon=True).start()
    resource.setrlimit(resource.RLIMIT_AS, (int(memory_gb) * GIGABYTE, int(memory_gb) * GIGABYTE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    store = Store(Workplace(Path(folder), Limits()))
    job = store.job(key)
    if job is not None:
        worker = Worker(store, job)
        save(work(worker), worker.folder / OUTCOME)


if __name__ == "__main__":
    main(sys.argv[1:])
