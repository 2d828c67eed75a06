"""A Prefect server for the duration of one run, that dies with it.

Prefect can start one itself, but then a ``kill -9`` leaves it running for ever, and the tracebacks that it prints while
it shuts down land on the user's terminal. Here its output goes to ``.prefect/server.log``, and it ends when its stdin
does, however its parent ended.
"""

from __future__ import annotations

import os
import socket
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPException
from pathlib import Path

from tasks.databases import API, shown
from tasks.failures import StepFailed, end_with_parent
from tasks.workspace import PROJECT, Workspace

_START_TIMEOUT_S = 180.0
_ANSWER_S = 10.0
# After Ctrl-C: a server that is just starting takes seconds to end by itself, and its database bears being killed.
_STOP_INTERRUPTED_S = 0.5
_STOP_TIMEOUT_S = 5.0

# Nothing is scheduled on a server that lives for one run.
_SERVICES = ("SCHEDULER", "LATE_RUNS", "PAUSE_EXPIRATIONS", "REPOSSESSOR", "FOREMAN", "CANCELLATION_CLEANUP")
_FOR_ONE_RUN = {
    "PREFECT_UI_ENABLED": "0",
    "PREFECT__SERVER_EPHEMERAL": "1",
    **{f"PREFECT_SERVER_SERVICES_{name}_ENABLED": "false" for name in _SERVICES},
}


def check_given() -> None:
    """Raise ``StepFailed`` (exit status 2) where ``PREFECT_API_URL`` names a server that doesn't answer."""
    given = os.environ.get(API)
    if not given:
        return
    try:
        with urllib.request.urlopen(f"{given.rstrip('/')}/health", timeout=_ANSWER_S):
            return
    except (OSError, ValueError, HTTPException) as error:
        why = getattr(error, "reason", error)
        if isinstance(why, ssl.SSLError) or getattr(error, "code", 404) != 404:
            return  # it answers; certificates and passwords are Prefect's own settings
        told = f"{API}: got no answer of {shown(given)}: {why}; allowed: nothing, or the API of a server that runs"
        raise StepFailed(f"{told} (http://HOST:4200/api); start it or unset the variable", exit_code=2) from error


class ServerFailed(RuntimeError):
    """The Prefect server didn't come up."""


@contextmanager
def prefect_server(workspace: Workspace, *, scheduled: bool = False) -> Iterator[str]:
    """Start a server (unless ``PREFECT_API_URL`` names one), point Prefect to it, stop it afterwards.

    ``scheduled``: with the services that a schedule needs. Yields the API's address.
    """
    given = os.environ.get(API)
    if given:
        yield given
        return
    workspace.prefect_home.mkdir(parents=True, exist_ok=True)
    log = workspace.prefect_home / "server.log"
    port = _free_port()
    with log.open("w", encoding="utf-8") as stream:
        server = subprocess.Popen(
            [sys.executable, "-m", "tasks.server", str(port)],
            stdin=subprocess.PIPE,
            stdout=stream,
            stderr=subprocess.STDOUT,
            cwd=PROJECT,
            env={**os.environ, **({} if scheduled else _FOR_ONE_RUN)},
            start_new_session=True,
        )
    address = f"http://127.0.0.1:{port}/api"
    patience_s = _STOP_TIMEOUT_S
    try:
        os.environ[API] = address
        _wait_until_up(server, address, log)
        _reread_settings()
        yield address
    except (KeyboardInterrupt, ServerFailed):
        patience_s = _STOP_INTERRUPTED_S
        raise
    finally:
        os.environ.pop(API, None)
        _reread_settings()
        server.terminate()
        try:
            server.wait(timeout=patience_s)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()


def _reread_settings() -> None:
    from prefect.context import refresh_global_settings_context

    refresh_global_settings_context()


def _wait_until_up(server: subprocess.Popen[bytes], address: str, log: Path) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if server.poll() is not None:
            last = _last_line(log)
            advice = "where its database is broken, move prefect.db beside the log away: no result is in it"
            if "disk is full" in last or "No space left" in last:
                advice = "free some space"
            said = f"the Prefect server ended with status {server.returncode}: {last} (log in {log})"
            raise ServerFailed(f"{said}; {advice}")
        try:
            with urllib.request.urlopen(f"{address}/health", timeout=2.0):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.1)
    raise ServerFailed(f"the Prefect server didn't answer within {_START_TIMEOUT_S:.0f} s; see {log}")


def _last_line(log: Path) -> str:
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    told = [line for line in lines if "Error" in line] or lines
    return told[-1][:150] if told else "it printed nothing"


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _serve(port: int) -> None:
    """What the child process does."""
    end_with_parent(0)
    import uvicorn
    from prefect.server.api.server import create_app

    uvicorn.run(create_app, factory=True, host="127.0.0.1", port=port, log_level="error", lifespan="on")


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
