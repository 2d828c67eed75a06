"""What every page needs: the store, the lanes, the templates, and words for what is kept."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response

from dieseltwin.api.saved import Saved, saved, with_symbols
from dieseltwin.app.kept import (
    ABOUT,
    ACTIVE,
    BESIDE,
    RESULT,
    UPLOADED,
    Job,
    JobState,
    KeptEngine,
    KeptRecording,
    Outcome,
    Store,
    now,
)  # fmt: skip
from dieseltwin.app.lanes import Lanes
from dieseltwin.app.security import REPORT_POLICY
from dieseltwin.app.workplace import Workplace, new_id
from dieseltwin.errors import InputError
from dieseltwin.version import __version__

SHIPPED: Mapping[str, str] = {"we2011": "Published engine (Wahlström and Eriksson 2011)"}
REPAIRED = ("engine.yaml", "repaired.yaml")
STATUS_WORDS = {
    "waiting": "waits", "running": "runs", "done": "done", "failed": "failed", "stopped": "stopped",
    "interrupted": "interrupted",
}  # fmt: skip
KIND_WORDS = {"discover": "what is left out", "identify": "health parameters", "learn": "learned engine",
              "watch": "added to the history", "history": "mended history"}


@dataclass(frozen=True)
class Analysis:
    """A job as a page shows it."""

    job: Job
    state: JobState
    outcome: Outcome | None

    @property
    def active(self) -> bool:
        """Whether it waits or runs."""
        return self.state.status in ACTIVE

    @property
    def words(self) -> str:
        """Its state."""
        return STATUS_WORDS[self.state.status]

    @property
    def seconds(self) -> float | None:
        """How long it has run, or ran [s]."""
        if self.state.started is None:
            return None
        end = datetime.now(UTC) if self.state.ended is None else datetime.fromisoformat(self.state.ended)
        return max((end - datetime.fromisoformat(self.state.started)).total_seconds(), 0.0)


class Desk:
    """The server's state, and how its pages are made."""

    def __init__(self, workplace: Workplace) -> None:
        self.workplace = workplace
        self.store = Store(workplace)
        self.lanes = Lanes(self.store, self.finished)
        self.environment = Environment(
            loader=PackageLoader("dieseltwin.app"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
            lstrip_blocks=True,
        )  # fmt: skip
        self.environment.filters |= {"moment": moment, "size": size_words, "duration": duration_words,
                                     "marked": with_symbols}  # fmt: skip
        self.environment.globals |= {"version": __version__, "largest_mb": workplace.limits.upload_mb,
                                     "kind_words": KIND_WORDS}  # fmt: skip

    # --- pages

    def page(self, template: str, status: int = 200, headers: Mapping[str, str] | None = None,
             **values: Any) -> HTMLResponse:  # fmt: skip
        """A page, or a part of one, from its template."""
        text = self.environment.get_template(template).render(**values)
        return HTMLResponse(text, status, headers=None if headers is None else dict(headers))

    def refused(self, status: int, words: str, back: str = "/") -> HTMLResponse:
        """The page that says what is wrong."""
        return self.page("error.html.j2", status, words=words, back=back, tab="")

    def download(self, path: Path | None, name: str, missing: str, back: str,
                 media_type: str = "application/octet-stream") -> Response:  # fmt: skip
        """A file to take away under a name; the page that says what is missing where there is none."""
        if path is None or not path.is_file():
            return self.refused(404, missing, back)
        return FileResponse(path, media_type=media_type, filename=name)

    def report(self, path: Path | None, missing: str, back: str) -> Response:
        """A page without any right on this one: what it embeds can't reach the server."""
        if path is None or not path.is_file():
            return self.refused(404, missing, back)
        return FileResponse(path, media_type="text/html", headers={"Content-Security-Policy": REPORT_POLICY})

    # --- what is asked for, or 404

    def recording(self, key: str) -> KeptRecording:
        return _there(self.store.recording(key), "recording")

    def engine(self, key: str) -> KeptEngine:
        return _there(self.store.engine(key), "engine")

    def job(self, key: str) -> Job:
        return _there(self.store.job(key), "result")

    def analysis(self, job: Job) -> Analysis:
        """A job with its state."""
        return Analysis(job, self.store.state(job.id), self.store.outcome(job.id))

    def short(self, key: str | None) -> Analysis | None:
        """A quick job by its id; None where there is none."""
        job = None if key is None else self.store.job(key)
        return None if job is None else self.analysis(job)

    def analyses(self) -> list[Analysis]:
        """Every analysis, newest first."""
        return [self.analysis(job) for job in self.store.jobs() if job.long]

    def verdict(self, job: Job) -> Saved | None:
        """What a finished analysis says in numbers; None for a learned engine or nothing readable."""
        try:
            return saved(self.store.job_folder(job.id) / RESULT)
        except InputError:
            return None

    # --- engines

    def engine_name(self, key: str) -> str:
        """What people call an engine."""
        kept = self.store.engine(key)
        return SHIPPED.get(key, "an engine that was taken away") if kept is None else kept.name

    def engine_choices(self) -> list[tuple[str, str]]:
        """Engines that an analysis can take: id or name, and words."""
        choices = list(SHIPPED.items())
        for kept in self.store.engines():
            check = self.short(kept.check)
            if check is not None and check.state.status == "done":
                choices.append((kept.id, f"{kept.name} ({kept.origin})"))
        return choices

    def engine_made(self, job: Job) -> tuple[Path, dict[str, Path]] | None:
        """The engine file that a job made, and the files that belong to it by their names here; None without one."""
        result = self.store.job_folder(job.id) / RESULT
        source = next((result / file for file in REPAIRED if (result / file).is_file()), None)
        if source is None:
            return None
        beside = {stored: source.with_name(source.stem + ending) for ending, stored in BESIDE.items()}
        beside[BESIDE[".parquet"]] = result / BESIDE[".parquet"]
        return source, {stored: path for stored, path in beside.items() if path.is_file()}

    def adopt_engine(self, job: Job, origin: str, name: str) -> KeptEngine | None:
        """Keep the engine that a job made; None where it made none."""
        made = self.engine_made(job)
        if made is None:
            return None
        source, beside = made
        files = {stored: path.read_bytes() for stored, path in beside.items()}
        return self.keep_engine(name, origin, source.read_bytes(), files, job.id)

    def keep_engine(self, name: str, origin: str, content: bytes, beside: Mapping[str, bytes],
                    job: str | None = None) -> KeptEngine:  # fmt: skip
        """Keep an engine file and those beside it under names of our own, and let a worker read them."""
        key = new_id()
        folder = self.store.engine_folder(key)
        folder.mkdir(mode=0o700)
        (folder / UPLOADED).write_bytes(content)
        for stored, data in beside.items():
            (folder / stored).write_bytes(data)
        check = self.store.new_job("engine", f"Reading {name}", engine=key)
        kept = KeptEngine.model_validate({"id": key, "name": name, "added": now(), "origin": origin,
                                          "check": check.id, "job": job})  # fmt: skip
        self.store.keep_engine(kept)
        self.lanes.put(check)
        return kept

    # --- jobs

    def finished(self, job: Job) -> None:
        """A learned engine is kept as one."""
        if job.kind == "learn":
            self.adopt_engine(job, "learned", str(job.options.get("name", "learned engine")))

    def clean(self) -> None:
        """Take away what was left half-made: folders without their document."""
        for parent in (self.workplace.recordings, self.workplace.engines, self.workplace.jobs):
            for folder in parent.iterdir():
                if folder.is_dir() and not (folder / ABOUT).is_file():
                    shutil.rmtree(folder, ignore_errors=True)


def desk_of(request: Request) -> Desk:
    """The desk of the server that answers."""
    found = request.app.state.desk
    if not isinstance(found, Desk):
        raise RuntimeError("the server was made without a desk")
    return found


def see(path: str) -> RedirectResponse:
    """After a change: look there."""
    return RedirectResponse(path, 303)


def _there(found: Any, what: str) -> Any:
    if found is None:
        raise HTTPException(404, f"There is no such {what} here; it may have been taken away.")
    return found


def moment(text: str | None) -> Markup | str:
    """A kept time for people, in the server's own zone."""
    if text is None:
        return ""
    return datetime.fromisoformat(text).astimezone().strftime("%d %b %Y, %H:%M")


def size_words(count: int) -> str:
    """A number of bytes for people."""
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"


def duration_words(seconds: float | None) -> str:
    """A duration for people."""
    if seconds is None:
        return ""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min {seconds % 60:.0f} s"
