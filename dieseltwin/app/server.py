"""The server: its pages put together, guarded, and run."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from dieseltwin.app import engine_pages, job_pages, recording_pages
from dieseltwin.app.desk import Desk, desk_of
from dieseltwin.app.security import Guard, TooLarge
from dieseltwin.app.workplace import MEGABYTE, Workplace
from dieseltwin.errors import InputError
from dieseltwin.version import __version__

STATIC = Path(__file__).parent / "static"
CLOSING_S = 5


def create_app(workplace: Workplace) -> FastAPI:
    """The application over a folder that it has for itself while it runs.

    Raises:
        InputError: a folder that can't be written to, or where another server works.
    """
    workplace.prepare()

    @asynccontextmanager
    async def life(app: FastAPI) -> AsyncIterator[None]:
        with workplace.lock():
            desk.clean()
            desk.lanes.start()
            try:
                yield
            finally:
                desk.lanes.close()

    # No page that describes the interface: FastAPI's own load their scripts from elsewhere.
    app = FastAPI(title="dieseltwin", version=__version__, docs_url=None, redoc_url=None, openapi_url=None,
                  lifespan=life)  # fmt: skip
    desk = Desk(workplace)
    app.state.desk = desk
    for room in (recording_pages, job_pages, engine_pages):
        app.include_router(room.router)
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.add_middleware(Guard, hosts=workplace.hosts, largest=workplace.limits.upload_mb * MEGABYTE)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(InputError, _input_error)
    app.add_exception_handler(TooLarge, _too_large)
    app.add_exception_handler(ClientDisconnect, _gone)
    return app


def _http_error(request: Request, error: Exception) -> Response:
    status, words = 500, str(error)
    if isinstance(error, HTTPException):
        status, words = error.status_code, str(error.detail)
    words = {404: words if words != "Not Found" else "There is no such page.",
             405: "This address doesn't do that."}.get(status, words)  # fmt: skip
    return desk_of(request).refused(status, words)


def _input_error(request: Request, error: Exception) -> Response:
    words = error.line() if isinstance(error, InputError) else str(error)
    return desk_of(request).refused(422, words)


def _too_large(request: Request, error: Exception) -> Response:
    megabytes = desk_of(request).workplace.limits.upload_mb
    return desk_of(request).refused(413, f"Too large: at most {megabytes} MB are taken.")


def _gone(request: Request, error: Exception) -> Response:
    """A browser that went away in the middle of an upload: nobody hears the answer, and nothing is wrong here."""
    return Response(status_code=400)


def serve(workplace: Workplace, host: str, port: int) -> None:
    """Run the server until it is interrupted.

    Raises:
        InputError: a folder or a port that can't be had.
    """
    app = create_app(workplace)
    with workplace.lock():
        pass  # two servers in one folder: better said before the port is taken
    incoming = workplace.folder / "incoming"
    incoming.mkdir(mode=0o700, exist_ok=True)
    tempfile.tempdir = str(incoming)  # uploads wait on the disk that keeps them: the usual place may be memory
    uvicorn.run(app, host=host, port=port, log_level="warning", access_log=False, server_header=False,
                timeout_graceful_shutdown=CLOSING_S)  # fmt: skip
