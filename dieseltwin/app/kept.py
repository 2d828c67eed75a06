"""Recordings, engines and jobs as they are kept: a folder each, a small strict document in it, never half-written."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import Field, ValidationError

from dieseltwin.app.workplace import Workplace, is_id, new_id
from dieseltwin.atomic import write_json
from dieseltwin.errors import InputError
from dieseltwin.sealed import read_json, sealed_json
from dieseltwin.settings.strict import StrictModel

ABOUT, STATE, OUTCOME, PROGRESS, RESULT, ARCHIVE = (
    "about.json", "state.json", "outcome.json", "progress.txt", "result", "result.zip",
)  # fmt: skip
CHANNELS, MAP, OVERVIEW = "channels.json", "map.yaml", "overview.png"
ENGINE, UPLOADED, DETAILS = "engine.yaml", "uploaded.yaml", "details.json"
HISTORY, HISTORY_PAGE, WATCHED = "history", "history.html", "watched.json"
LEARNED_FILE = "engine.learned.parquet"
BESIDE = {
    ".parquet": LEARNED_FILE, ".calibration.json": "engine.calibration.json", ".steady.json": "engine.steady.json",
}  # fmt: skip
"""Ending of a file that belongs to an engine file -> its name here."""

Kind = Literal["channels", "check", "engine", "discover", "identify", "learn", "watch", "history"]
Status = Literal["waiting", "running", "done", "failed", "stopped", "interrupted"]
ANALYSES = ("discover", "identify", "learn", "watch", "history")
ACTIVE = ("waiting", "running")


def now() -> str:
    """The time as it is kept."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class KeptRecording(StrictModel):
    """A recording: its server-made file name, the browser's name for people, and the jobs that looked into it."""

    id: str
    name: str
    file: str
    size: int
    added: str
    database: str | None = None
    cylinders: int | None = None
    look: str = ""
    check: str | None = None


class KeptEngine(StrictModel):
    """An engine: who made it (a file that was uploaded, or a job), and the job that checked the upload."""

    id: str
    name: str
    added: str
    origin: Literal["uploaded", "learned", "repaired"]
    check: str | None = None
    job: str | None = None


class Job(StrictModel):
    """Work for a worker process; it never changes.

    `engine` is the name of a shipped engine, or the id of a kept one.
    """

    id: str
    kind: Kind
    title: str
    created: str
    recordings: tuple[str, ...] = ()
    engine: str = "we2011"
    options: dict[str, Any] = Field(default_factory=dict)

    @property
    def long(self) -> bool:
        """Whether people wait for it in the list of analyses."""
        return self.kind in ANALYSES


class JobState(StrictModel):
    """How far a job is; written by the server alone."""

    status: Status = "waiting"
    started: str | None = None
    ended: str | None = None


class Outcome(StrictModel):
    """What a worker ended with: a sentence, or the line that says what is wrong."""

    sentence: str = ""
    error: str = ""
    defect: bool = False
    details: dict[str, Any] = Field(default_factory=dict)


Document = TypeVar("Document", bound=StrictModel)


def load(model: type[Document], path: Path) -> Document | None:
    """A document, None where there is none or it can't be read."""
    content = content_of(path)
    try:
        return None if content is None else model.model_validate_json(json.dumps(content))
    except ValidationError:
        return None


def content_of(path: Path) -> dict[str, Any] | None:
    """The object in a file of ours, None where there is none or it isn't as it was written."""
    try:
        return read_json(path, "a file of `dieseltwin app`", "make it again")
    except InputError:
        return None


def save(document: StrictModel, path: Path) -> None:
    """Write a document, all or nothing."""
    write_json(path, sealed_json(document.model_dump(mode="json")))


class Store:
    """Everything that is kept, by id. An id that isn't one finds nothing."""

    def __init__(self, workplace: Workplace) -> None:
        self.workplace = workplace

    # --- recordings

    def recording(self, key: str) -> KeptRecording | None:
        return load(KeptRecording, self.recording_folder(key) / ABOUT) if is_id(key) else None

    def recording_folder(self, key: str) -> Path:
        return self.workplace.recordings / key

    def recordings(self) -> list[KeptRecording]:
        """Newest first."""
        found = [self.recording(key) for key in _names(self.workplace.recordings)]
        return sorted((item for item in found if item is not None), key=lambda item: item.added, reverse=True)

    def keep_recording(self, recording: KeptRecording) -> None:
        save(recording, self.recording_folder(recording.id) / ABOUT)

    def channels(self, key: str) -> dict[str, Any] | None:
        """What a worker found in a recording."""
        return content_of(self.recording_folder(key) / CHANNELS)

    # --- engines

    def engine(self, key: str) -> KeptEngine | None:
        return load(KeptEngine, self.engine_folder(key) / ABOUT) if is_id(key) else None

    def engine_folder(self, key: str) -> Path:
        return self.workplace.engines / key

    def engines(self) -> list[KeptEngine]:
        """Newest first."""
        found = [self.engine(key) for key in _names(self.workplace.engines)]
        return sorted((item for item in found if item is not None), key=lambda item: item.added, reverse=True)

    def keep_engine(self, engine: KeptEngine) -> None:
        save(engine, self.engine_folder(engine.id) / ABOUT)

    # --- jobs

    def job(self, key: str) -> Job | None:
        return load(Job, self.job_folder(key) / ABOUT) if is_id(key) else None

    def job_folder(self, key: str) -> Path:
        return self.workplace.jobs / key

    def state(self, key: str) -> JobState:
        return load(JobState, self.job_folder(key) / STATE) or JobState(status="interrupted")

    def outcome(self, key: str) -> Outcome | None:
        return load(Outcome, self.job_folder(key) / OUTCOME)

    def progress(self, key: str) -> list[str]:
        """Lines that the worker wrote so far."""
        try:
            text = (self.job_folder(key) / PROGRESS).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return []
        return text.splitlines()

    def jobs(self) -> list[Job]:
        """Newest first, short ones included."""
        found = [self.job(key) for key in _names(self.workplace.jobs)]
        return sorted((item for item in found if item is not None), key=lambda item: item.created, reverse=True)

    def new_job(self, kind: Kind, title: str, recordings: tuple[str, ...] = (), engine: str = "we2011",
                **options: Any) -> Job:  # fmt: skip
        """A job that waits."""
        job = Job(id=new_id(), kind=kind, title=title, created=datetime.now(UTC).isoformat(), recordings=recordings,
                  engine=engine, options=options)  # fmt: skip
        self.job_folder(job.id).mkdir(mode=0o700)
        self.keep_state(job.id, JobState())
        save(job, self.job_folder(job.id) / ABOUT)
        return job

    def keep_state(self, key: str, state: JobState) -> None:
        save(state, self.job_folder(key) / STATE)

    # --- all

    def remove(self, folder: Path) -> None:
        """Take a folder of this store away."""
        shutil.rmtree(folder, ignore_errors=True)


def _names(folder: Path) -> list[str]:
    return [item.name for item in folder.iterdir() if is_id(item.name)]
