"""Pages of a recording: dropped, looked into, mapped, tried, asked about."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, BinaryIO

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.responses import FileResponse, Response

from dieseltwin.api.channels import ENDINGS
from dieseltwin.app.desk import Desk, desk_of, see
from dieseltwin.app.kept import CHANNELS, MAP, OVERVIEW, KeptRecording, now
from dieseltwin.app.mapping import (
    common_values,
    content_of,
    cylinders_of,
    form_rows,
    read_content,
    whole_number,
    write_content,
)
from dieseltwin.app.workplace import MEGABYTE, MOST_RECORDINGS, new_id, shown_name
from dieseltwin.errors import InputError
from dieseltwin.settings.params import default_params_path

router = APIRouter()
MOST_FIELDS = 300
FIELD_BYTES = 100_000
DATABASE = "bus.dbc"
DATABASE_MB = 20


@router.get("/")
def home(request: Request) -> Response:
    return _home(desk_of(request))


def _home(desk: Desk, status: int = 200, error: str = "") -> Response:
    recordings = desk.store.recordings()
    readable = [kept for kept in recordings if desk.store.channels(kept.id) is not None]
    return desk.page("home.html.j2", status, tab="recordings", recordings=recordings, analyses=desk.analyses(),
                     readable=readable, engines=desk.engine_choices(), engine_name=desk.engine_name,
                     error=error)  # fmt: skip


@router.post("/recordings/ask-together")
async def ask_together(request: Request) -> Response:
    """What the twin leaves out of several recordings of one engine, in one verdict."""
    desk = desk_of(request)
    form = await sent_form(request)
    chosen = tuple(dict.fromkeys(str(key) for key in form.getlist("together")
                                 if desk.store.recording(str(key)) is not None))
    engine = str(form.get("engine", ""))
    if not 2 <= len(chosen) <= MOST_RECORDINGS:
        return _home(desk, 422, f"Choose two to {MOST_RECORDINGS} recordings of one engine.")
    if engine not in dict(desk.engine_choices()):
        return _home(desk, 422, "Choose an engine of the list.")
    job = desk.store.new_job("discover", f"What is left out of {len(chosen)} recordings", chosen, engine)
    desk.lanes.put(job)
    return see(f"/jobs/{job.id}")


async def sent_form(request: Request) -> FormData:
    """A form without files, within limits; `app.security` counts its bytes."""
    return await request.form(max_files=0, max_fields=MOST_FIELDS, max_part_size=FIELD_BYTES)


@router.post("/recordings")
async def drop(request: Request) -> Response:
    desk = desk_of(request)
    async with request.form(max_files=2, max_fields=10, max_part_size=FIELD_BYTES) as form:
        upload, database = form.get("file"), form.get("dbc")
        if not isinstance(upload, UploadFile) or not upload.filename:
            return desk.refused(422, "No file came with the form: choose a recording, or drop one.")
        size = upload.size or 0
        if not size:
            return desk.refused(422, f"{shown_name(upload.filename)} is empty: record again or copy it again.")
        if not await run_in_threadpool(desk.workplace.room_for, size):
            return desk.refused(507, "There is no room for this file here: take old recordings or results away.")
        bus = database if isinstance(database, UploadFile) and database.size else None
        if bus is not None and (bus.size or 0) > DATABASE_MB * MEGABYTE:
            return desk.refused(413, f"The DBC is larger than {DATABASE_MB} MB: drop the DBC of this bus alone.")
        kept = await run_in_threadpool(_keep, desk, shown_name(upload.filename), upload.file,
                                       None if bus is None else bus.file, size)  # fmt: skip
    return see(f"/recordings/{kept.id}")


def _keep(desk: Desk, name: str, content: BinaryIO, database: BinaryIO | None, size: int) -> KeptRecording:
    """Store a recording under a name of our own and let a worker look into it."""
    key = new_id()
    ending = Path(name).suffix.lower()
    file = f"recording{ending if ending in ENDINGS else '.bin'}"
    folder = desk.store.recording_folder(key)
    folder.mkdir(mode=0o700)
    for source, target in ((content, file), (database, DATABASE)):
        if source is not None:
            with (folder / target).open("wb") as out:
                shutil.copyfileobj(source, out, MEGABYTE)
    kept = KeptRecording(id=key, name=name, file=file, size=size, added=now(),
                         database=None if database is None else DATABASE)  # fmt: skip
    return look_into(desk, kept)


def look_into(desk: Desk, kept: KeptRecording) -> KeptRecording:
    """Ask a worker what is in a recording, which it is kept with."""
    job = desk.store.new_job("channels", f"Looking into {kept.name}", (kept.id,))
    kept = kept.model_copy(update={"look": job.id, "check": None})
    desk.store.keep_recording(kept)
    desk.lanes.put(job)
    return kept


@router.get("/recordings/{key}")
def show(request: Request, key: str) -> Response:
    desk = desk_of(request)
    return _page(desk, desk.recording(key))


def _page(desk: Desk, kept: KeptRecording, status: int = 200, error: str = "") -> Response:
    folder = desk.store.recording_folder(kept.id)
    found = desk.store.channels(kept.id)
    values: dict[str, Any] = {"found": found}
    if found is not None:
        content = read_content(folder / MAP)
        values |= {"rows": form_rows(found, content), "common": common_values(content, found)}
    asked = [desk.analysis(job) for job in desk.store.jobs() if job.long and kept.id in job.recordings]
    return desk.page("recording.html.j2", status, tab="recordings", kept=kept, look=desk.short(kept.look),
                     check=desk.short(kept.check), overview=(folder / OVERVIEW).is_file(), error=error,
                     engines=desk.engine_choices(), asked=asked, engine_name=desk.engine_name, **values)  # fmt: skip


@router.get("/recordings/{key}/look")
def look_part(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.recording(key)
    look = desk.short(kept.look)
    over = look is None or not look.active
    return desk.page("look_part.html.j2", headers={"HX-Refresh": "true"} if over else None, kept=kept, look=look)


@router.get("/recordings/{key}/check")
def check_part(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.recording(key)
    return desk.page("check_part.html.j2", kept=kept, check=desk.short(kept.check))


@router.post("/recordings/{key}/map")
async def save_map(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.recording(key)
    form = await sent_form(request)
    fields = {name: value for name, value in form.items() if isinstance(value, str)}
    return await run_in_threadpool(_save_map, desk, kept, fields)


def _save_map(desk: Desk, kept: KeptRecording, fields: dict[str, str]) -> Response:
    found = desk.store.channels(kept.id)
    if found is None:
        return desk.refused(409, "Nothing is known of this file's channels yet: wait until it was looked into.",
                            f"/recordings/{kept.id}")  # fmt: skip
    path = desk.store.recording_folder(kept.id) / MAP
    names = [channel["channel"] for channel in found["channels"]]
    try:
        content = content_of(fields, names, read_content(path))
    except InputError as error:
        return _page(desk, kept, 422, error.line())
    write_content(content, path)
    job = desk.store.new_job("check", f"Reading {kept.name}", (kept.id,))
    desk.store.keep_recording(kept.model_copy(update={"check": job.id}))
    desk.lanes.put(job)
    return see(f"/recordings/{kept.id}#reading")


@router.post("/recordings/{key}/look")
async def look_again(request: Request, key: str) -> Response:
    """Look into a file once more, with the engine's number of cylinders; the map starts anew."""
    desk = desk_of(request)
    kept = desk.recording(key)
    form = await sent_form(request)
    try:
        cylinders = cylinders_of(str(form.get("cylinders", "")).strip())
    except InputError as error:
        return _page(desk, kept, 422, error.line())
    await run_in_threadpool(desk.lanes.stop, kept.look)  # it would write the map that it finds with the old number
    for name in (MAP, CHANNELS):
        (desk.store.recording_folder(key) / name).unlink(missing_ok=True)
    look_into(desk, kept.model_copy(update={"cylinders": cylinders}))
    return see(f"/recordings/{key}")


@router.post("/recordings/{key}/ask")
async def ask(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.recording(key)
    form = await sent_form(request)
    kind, engine = str(form.get("kind", "")), str(form.get("engine", ""))
    if kind not in ("discover", "identify", "watch"):
        return _page(desk, kept, 422, "Choose what is to be found.")
    if engine not in dict(desk.engine_choices()):
        return _page(desk, kept, 422, "Choose an engine of the list.")
    if kind == "watch":
        if desk.store.engine(engine) is None:
            return _page(desk, kept, 422, "A history belongs to an engine that was learned: choose it.")
        job = desk.store.new_job("watch", f"{kept.name} in the history", (key,), engine)
    elif kind == "discover":
        job = desk.store.new_job("discover", f"What is left out of {kept.name}", (key,), engine)
    else:
        count = whole_number(str(form.get("runs", "1")), 1, 20) or 1
        job = desk.store.new_job("identify", f"Health in {kept.name}", (key,), engine, runs=count,
                                 params=str(default_params_path().resolve()))  # fmt: skip
    desk.lanes.put(job)
    return see(f"/jobs/{job.id}")


@router.get("/recordings/{key}/map.yaml")
def map_file(request: Request, key: str) -> Response:
    desk = desk_of(request)
    path = desk.store.recording_folder(desk.recording(key).id) / MAP
    return desk.download(path, "map.yaml", "There is no channel map yet.", f"/recordings/{key}", "application/yaml")


@router.get("/recordings/{key}/overview.png")
def overview(request: Request, key: str) -> Response:
    desk = desk_of(request)
    path = desk.store.recording_folder(desk.recording(key).id) / OVERVIEW
    return FileResponse(path, media_type="image/png") if path.is_file() else desk.refused(404, "There is no picture.")


@router.post("/recordings/{key}/remove")
def remove(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.recording(key)
    for job in desk.store.jobs():
        if kept.id in job.recordings and not job.long:
            desk.lanes.stop(job.id)
            desk.store.remove(desk.store.job_folder(job.id))
    desk.store.remove(desk.store.recording_folder(kept.id))
    return see("/")
