"""Pages of the engines: shipped, uploaded, learned, repaired; what was found of each over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.responses import Response

from dieseltwin.app.desk import SHIPPED, Desk, desk_of, see
from dieseltwin.app.history import Past, alarms_of, history_of, trends_of
from dieseltwin.app.kept import BESIDE, DETAILS, ENGINE, HISTORY_PAGE, WATCHED, KeptEngine, content_of
from dieseltwin.app.workplace import MEGABYTE, MOST_RECORDINGS, shown_name

router = APIRouter()
ENGINE_MB, BESIDE_MB = 2, 100
MOST_LETTERS = 200  # of a reason or a title


@router.get("/engines")
def engines(request: Request) -> Response:
    return _page(desk_of(request))


def _page(desk: Desk, status: int = 200, error: str = "") -> Response:
    rows: list[tuple[str, str, KeptEngine | None, list[Past]]] = [
        (key, words, None, history_of(desk, key)) for key, words in SHIPPED.items()
    ]
    rows += [(kept.id, kept.name, kept, history_of(desk, kept.id)) for kept in desk.store.engines()]
    shown = [{"key": key, "name": name, "kept": kept, "count": len(past),
              "alarms": len(alarms_of(past)) + bool((_watched(desk, kept) or {}).get("alarm")),
              "check": None if kept is None else desk.short(kept.check)} for key, name, kept, past in rows]  # fmt: skip
    usable = [kept for kept in desk.store.recordings() if desk.store.channels(kept.id) is not None]
    return desk.page("engines.html.j2", status, tab="engines", engines=shown, recordings=usable,
                     choices=desk.engine_choices(), error=error)  # fmt: skip


@router.post("/engines")
async def upload(request: Request) -> Response:
    desk = desk_of(request)
    async with request.form(max_files=4, max_fields=10, max_part_size=100_000) as form:
        files = [item for _, item in form.multi_items() if isinstance(item, UploadFile) and item.filename]
        content, beside, name = b"", {}, ""
        for item in files:
            shown = shown_name(item.filename)
            if shown.lower().endswith((".yaml", ".yml")):
                if (item.size or 0) > ENGINE_MB * MEGABYTE:
                    return _page(desk, 413, f"{shown} is larger than {ENGINE_MB} MB: an engine file has some kB.")
                content, name = await item.read(), shown
                continue
            ending = next((ending for ending in BESIDE if shown.lower().endswith(ending)), None)
            if ending is None or (item.size or 0) > BESIDE_MB * MEGABYTE:
                allowed = f"a .yaml, and beside it {', '.join(BESIDE)} of at most {BESIDE_MB} MB"
                return _page(desk, 422, f"{shown}: got another file; allowed: {allowed}; choose these")
            beside[BESIDE[ending]] = await item.read()
        if not content:
            return _page(desk, 422, "No engine file came with the form: choose a .yaml.")
        if not await run_in_threadpool(desk.workplace.room_for, len(content) + sum(map(len, beside.values()))):
            return desk.refused(507, "There is no room for this file here: take old recordings or results away.")
    kept = await run_in_threadpool(desk.keep_engine, name, "uploaded", content, beside)
    return see(f"/engines/{kept.id}")


@router.post("/engines/learn")
async def learn(request: Request) -> Response:
    """Learn an engine from recordings of when it was well."""
    desk = desk_of(request)
    form = await request.form(max_files=0, max_fields=100)
    chosen = tuple(str(key) for key in form.getlist("healthy") if desk.store.recording(str(key)) is not None)
    name, base = shown_name(str(form.get("name", ""))), str(form.get("engine", ""))
    if not 1 <= len(chosen) <= MOST_RECORDINGS:
        return _page(desk, 422, f"Choose one to {MOST_RECORDINGS} recordings of the engine when it was well.")
    if base not in dict(desk.engine_choices()):
        return _page(desk, 422, "Choose an engine of the list to begin with.")
    job = desk.store.new_job("learn", f"Learn {name}", chosen, base, name=name)
    desk.lanes.put(job)
    return see(f"/jobs/{job.id}")


@router.get("/engines/{key}")
def show(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = None if key in SHIPPED else desk.engine(key)
    past = history_of(desk, key)
    return desk.page(
        "engine.html.j2", tab="engines", key=key, kept=kept, name=desk.engine_name(key), past=past,
        check=None if kept is None else desk.short(kept.check), details=_details(desk, kept),
        alarms=alarms_of(past), trends=trends_of(past), watched=_watched(desk, kept),
    )  # fmt: skip


def _watched(desk: Desk, kept: KeptEngine | None) -> dict[str, Any] | None:
    """What the history of an engine says, and whether it calls for a look; None without a history."""
    return None if kept is None else content_of(desk.store.engine_folder(kept.id) / WATCHED)


@router.get("/engines/{key}/history")
def watched_page(request: Request, key: str) -> Response:
    desk = desk_of(request)
    path = desk.store.engine_folder(desk.engine(key).id) / HISTORY_PAGE
    return desk.report(path, "This engine has no history yet.", f"/engines/{key}")


@router.post("/engines/{key}/history")
async def mend_history(request: Request, key: str) -> Response:
    """Take a recording out of the history with a reason, or let it count again without one."""
    desk = desk_of(request)
    kept = desk.engine(key)
    form = await request.form(max_files=0, max_fields=5)
    which, reason = str(form.get("recording", "")), form.get("reason")
    watched = _watched(desk, kept) or {}
    there = watched.get("taken_out" if reason is None else "recordings", [])
    found = next((item for item in there if item["sha256"] == which), None)
    if found is None:
        return desk.refused(422, "Choose a recording of the history.", f"/engines/{key}")
    options = {"recording": which}
    if reason is not None:
        options["reason"] = " ".join(str(reason).split())[:MOST_LETTERS]
        if not options["reason"]:
            return desk.refused(422, "Say why it shouldn't count: the reason stands on the page.", f"/engines/{key}")
    title = f"{found['words'].partition(',')[0]} {'counts again' if reason is None else 'taken out of the history'}"
    job = desk.store.new_job("history", title[:MOST_LETTERS], (), kept.id, **options)
    desk.lanes.put(job)
    return see(f"/jobs/{job.id}")


@router.get("/engines/{key}/part")
def part(request: Request, key: str) -> Response:
    desk = desk_of(request)
    kept = desk.engine(key)
    check = desk.short(kept.check)
    over = check is None or not check.active
    return desk.page("engine_part.html.j2", headers={"HX-Refresh": "true"} if over else None, kept=kept, check=check)


@router.get("/engines/{key}/engine.yaml")
def file(request: Request, key: str) -> Response:
    desk = desk_of(request)
    path = desk.store.engine_folder(desk.engine(key).id) / ENGINE
    return desk.download(path, "engine.yaml", "This engine could not be read.", f"/engines/{key}")


@router.get("/engines/{key}/beside/{number}")
def file_beside(request: Request, key: str, number: int) -> Response:
    """A file that belongs to an engine's."""
    desk = desk_of(request)
    names = list(BESIDE.values())
    path = desk.store.engine_folder(desk.engine(key).id) / names[number % len(names)]
    return desk.download(path, path.name, "There is no such file beside this engine.", f"/engines/{key}")


@router.post("/engines/{key}/remove")
def remove(request: Request, key: str) -> Response:
    desk = desk_of(request)
    desk.store.remove(desk.store.engine_folder(desk.engine(key).id))
    return see("/engines")


def _details(desk: Desk, kept: KeptEngine | None) -> dict[str, Any]:
    """What a worker read in an engine file: where it differs from the published set, what was learned, files beside."""
    nothing: dict[str, Any] = {"changes": [], "learned": [], "beside": []}
    if kept is None:
        return nothing
    folder: Path = desk.store.engine_folder(kept.id)
    found = content_of(folder / DETAILS)
    if found is None:
        return nothing
    beside = [(number, name) for number, name in enumerate(BESIDE.values()) if (folder / name).is_file()]
    return {**nothing, **found, "beside": beside}
