"""Pages of an analysis: progress, verdict, files to take away; and two of them side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from dieseltwin.api.saved import Difference, differences
from dieseltwin.app.desk import REPAIRED, Analysis, Desk, desk_of, see
from dieseltwin.app.kept import ARCHIVE, HISTORY_PAGE, RESULT, Job

router = APIRouter()
FILES: Mapping[str, tuple[tuple[str, ...], str]] = {
    "report.html": (tuple(f"{RESULT}/{name}" for name in ("report.html", HISTORY_PAGE)), "report.html"),
    "engine.yaml": (tuple(f"{RESULT}/{name}" for name in REPAIRED), "engine.yaml"),
    "result.zip": ((ARCHIVE,), "dieseltwin-result.zip"),
}
"""File to take away, as its address ends -> where in an analysis's folder it may lie, and the name that it gets."""
STAGE = "# "
LAST_LINES = 60


def progress_values(desk: Desk, analysis: Analysis) -> dict[str, Any]:
    """How far an analysis is: the stages so far, and the lines that it said since the last one."""
    lines = desk.store.progress(analysis.job.id)
    stages = [line.removeprefix(STAGE) for line in lines if line.startswith(STAGE)]
    ahead = desk.lanes.ahead(analysis.job) if analysis.state.status == "waiting" else 0
    said = [line for line in lines if not line.startswith(STAGE)]
    return {"analysis": analysis, "stages": stages, "said": said[-LAST_LINES:], "ahead": ahead}


@router.get("/jobs/{key}")
def show(request: Request, key: str) -> Response:
    desk = desk_of(request)
    job = desk.job(key)
    if not job.long:
        return desk.refused(404, "There is no such result here.")
    analysis = desk.analysis(job)
    recordings = [desk.store.recording(item) for item in job.recordings]
    return desk.page(
        "job.html.j2", tab="recordings", oob=False, **progress_values(desk, analysis), verdict=desk.verdict(job),
        recordings=[item for item in recordings if item is not None], engine_name=desk.engine_name,
        report=_file_of(desk, job, "report.html") is not None, engine=_file_of(desk, job, "engine.yaml") is not None,
        archive=_file_of(desk, job, "result.zip") is not None, beside=list((desk.engine_made(job) or (None, {}))[1]),
        kept_as=[item for item in desk.store.engines() if item.job == key],
    )  # fmt: skip


@router.get("/jobs/{key}/state")
def state_part(request: Request, key: str) -> Response:
    desk = desk_of(request)
    analysis = desk.analysis(desk.job(key))
    headers = None if analysis.active else {"HX-Refresh": "true"}
    return desk.page("job_part.html.j2", headers=headers, oob=True, **progress_values(desk, analysis))


@router.get("/parts/analyses")
def analyses_part(request: Request) -> Response:
    desk = desk_of(request)
    return desk.page("analyses_part.html.j2", analyses=desk.analyses(), engine_name=desk.engine_name)


@router.post("/jobs/{key}/stop")
def stop(request: Request, key: str) -> Response:
    desk = desk_of(request)
    desk.lanes.stop(desk.job(key).id)
    return see(f"/jobs/{key}")


@router.post("/jobs/{key}/again")
def again(request: Request, key: str) -> Response:
    desk = desk_of(request)
    job = desk.job(key)
    if not desk.analysis(job).active:
        desk.lanes.again(job)
    return see(f"/jobs/{key}")


@router.post("/jobs/{key}/remove")
def remove(request: Request, key: str) -> Response:
    desk = desk_of(request)
    job = desk.job(key)
    desk.lanes.stop(job.id)
    desk.store.remove(desk.store.job_folder(job.id))
    return see("/")


@router.post("/jobs/{key}/keep-engine")
def keep_engine(request: Request, key: str) -> Response:
    """Keep the repaired engine among the engines."""
    desk = desk_of(request)
    job = desk.job(key)
    kept = desk.adopt_engine(job, "repaired", f"{desk.engine_name(job.engine)}, repaired by {job.title}"[:120])
    return desk.refused(404, "This result holds no engine.", f"/jobs/{key}") if kept is None else see(
        f"/engines/{kept.id}")  # fmt: skip


@router.get("/jobs/{key}/report")
def report(request: Request, key: str) -> Response:
    desk = desk_of(request)
    return desk.report(_file_of(desk, desk.job(key), "report.html"), "This result has no report.", f"/jobs/{key}")


@router.get("/jobs/{key}/report.html")
@router.get("/jobs/{key}/engine.yaml")
@router.get("/jobs/{key}/result.zip")
def download(request: Request, key: str) -> Response:
    desk = desk_of(request)
    name = request.url.path.rpartition("/")[2]
    path, label = _file_of(desk, desk.job(key), name), FILES[name][1]
    return desk.download(path, label, f"This result has no {label}.", f"/jobs/{key}")


@router.get("/jobs/{key}/beside/{name}")
def file_beside(request: Request, key: str, name: str) -> Response:
    """A file that belongs to the engine that was made: without what was learned, its file is refused."""
    desk = desk_of(request)
    made = desk.engine_made(desk.job(key))
    path = None if made is None else made[1].get(name)
    return desk.download(path, name, "There is no such file beside this engine.", f"/jobs/{key}")


def _file_of(desk: Desk, job: Job, name: str) -> Path | None:
    """Where a file of `FILES` lies, None where the analysis has none."""
    folder = desk.store.job_folder(job.id)
    return next((folder / place for place in FILES[name][0] if (folder / place).is_file()), None)


@router.get("/compare")
def compare(request: Request, one: str = "", other: str = "") -> Response:
    """Two results side by side; `one` and `other` are their ids."""
    desk = desk_of(request)
    done = [item for item in desk.analyses()
            if item.state.status == "done" and item.job.kind in ("discover", "identify")]
    by_id = {item.job.id: item for item in done}
    left, right = by_id.get(one), by_id.get(other)
    rows: tuple[Difference, ...] = ()
    sides, error = [], ""
    if left is not None and right is not None:
        verdicts = [desk.verdict(item.job) for item in (left, right)]
        sides = [(item, verdict) for item, verdict in zip((left, right), verdicts, strict=True) if verdict is not None]
        if len(sides) == 2:
            rows = differences(sides[0][1], sides[1][1])
        else:
            error = "One of the two results can't be read any more."
    elif one or other:
        error = "Choose two finished results."
    return desk.page("compare.html.j2", tab="compare", done=done, one=one, other=other, sides=sides, rows=rows,
                     error=error, engine_name=desk.engine_name)  # fmt: skip
