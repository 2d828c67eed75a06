"""How a flow is started from a command line: settings, server, bars, Ctrl-C, one-line errors.

``prepare_environment`` must have run before Prefect is imported (``flows/__init__.py`` does that).
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

from dieseltwin.atomic import check_folder, check_writable
from dieseltwin.errors import InputError
from tasks import databases, records, run_context, workers
from tasks.cluster import check_setting
from tasks.failures import INTERRUPTED, INTERRUPTED_CODE
from tasks.server import ServerFailed, check_given, prefect_server
from tasks.settings import DEFAULT_PROFILE, load_settings
from tasks.workspace import Workspace, prepare_environment

# How long a flow takes where it never ran here [s]: quick profile unless another is named, two idle cores.
_EXPECTED_S = {
    "flow simulate": 50.0,
    "flow pretrain": 180.0,
    "flow identify": 200.0,
    "flow run": 430.0,
    "flow discover": 80.0,
    "flow prove": 800.0,
    "flow promote": 40.0,
    "flow watch": 60.0,
    "flow evaluate": 1000.0,
    "flow evaluate paper": 6000.0,
}
_STEP_S = 430.0

# Results of steps that nothing asked for within this time are removed.
_UNUSED_S = 30 * 24 * 3600.0

_END_S = 10.0  # after a signal; one to three are usual

_ROOM_BYTES = 500_000_000  # data, models, cache and reports of the quick profile take about half of it


def launch(flow: Callable[..., Any], **parameters: Any) -> int:
    """Run a flow with a server of its own. Returns the exit status: 0 well, 2 wrong input, 130 Ctrl-C, else 1."""
    workspace = prepare_environment()
    warnings.filterwarnings("ignore")
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    workers.stop_on(signal.SIGTERM, signal.SIGINT, then=_end_anyway)
    context = run_context.current()
    # A profile has its own run times.
    context.display.history = workspace.cache / f"expected_seconds-{parameters.get('profile', 'default')}.json"
    name = f"flow {getattr(flow, 'name', 'flow')}"
    title = f"all of {getattr(flow, 'name', 'it')}"
    try:
        with context.display.showing(), prefect_server(workspace):
            expected_s = _EXPECTED_S.get(f"{name} {parameters.get('profile')}", _EXPECTED_S.get(name, _STEP_S))
            context.display.start(name, expected_s, title)
            threading.Thread(target=records.warm_up, daemon=True).start()
            flow(**parameters)
            context.display.finish(name, title)
        context.store.prune(_UNUSED_S)
    except KeyboardInterrupt:
        return _interrupted()
    except Exception as error:
        # The signal's exception is lost where it meets a finaliser, and the steps then fail as their processes end.
        return _interrupted() if workers.stopping() else _failed(error, workspace)
    return 0


def _end_anyway() -> None:
    """End the process where what the signal raised doesn't; what is finished is in its place by then.

    Raised while the first thread imports, it leaves Python's import lock taken for ever, and every thread that imports
    anything waits for it: Prefect's own, which the flow's end waits for.
    """
    time.sleep(_END_S)
    print(INTERRUPTED, file=sys.stderr, flush=True)
    os._exit(INTERRUPTED_CODE)


def _interrupted() -> int:
    print(INTERRUPTED, file=sys.stderr)
    return INTERRUPTED_CODE


def _failed(error: Exception, workspace: Workspace) -> int:
    """Say in one line what failed; raise it again where nobody can say more than its traceback."""
    code = getattr(error, "exit_code", None)
    known = code is not None or isinstance(error, ServerFailed)
    told = str(error) if known else databases.failure(error, workspace.mlflow_uri)
    if told is None:
        raise error
    print(f"error: {told}", file=sys.stderr)
    return 1 if code is None else int(code)


def run_alone(
    flow: Callable[..., Any],
    arguments: Sequence[str] | None = None,
    *,
    options: Callable[[argparse.ArgumentParser], None] | None = None,
    check: Callable[[dict[str, Any]], None] | None = None,
) -> int:
    """``python -m flows.NAME --profile NAME``: one flow as a command. Returns the exit status.

    ``options`` adds what else the flow takes, under the names of its parameters; ``check`` raises where they are wrong.
    """
    return start(flow, vars(command_line(flow, options).parse_args(arguments)), check)


def command_line(
    flow: Callable[..., Any], options: Callable[[argparse.ArgumentParser], None] | None = None
) -> argparse.ArgumentParser:
    """What every flow's command takes, and ``options``; its help begins with the flow's description."""
    parser = argparse.ArgumentParser(description=str(getattr(flow, "description", "")).replace("``", ""))
    told = "a profile of params.yaml: quick, paper, or tiny (quick with the smallest benchmark)"
    parser.add_argument("--profile", default=DEFAULT_PROFILE, help=f"{told}; default: {DEFAULT_PROFILE}")
    if options is not None:
        options(parser)
    return parser


def start(
    flow: Callable[..., Any], parameters: dict[str, Any], check: Callable[[dict[str, Any]], None] | None = None
) -> int:
    """Check what the user can mend, then run the flow. Returns the exit status."""
    try:
        check_start(parameters, check)
    except (run_context.StepFailed, InputError) as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    note_unused()
    return launch(flow, **parameters)


def check_start(parameters: dict[str, Any], check: Callable[[dict[str, Any]], None] | None = None) -> None:
    """Raise for what the user can mend, ``StepFailed`` or ``InputError``: that needs no server, and no traceback."""
    load_settings(parameters["profile"])
    check_setting()
    databases.check_settings()
    check_given()
    if check is not None:
        check(parameters)
    check_place()


def note_unused() -> None:
    """Say which setting of the user's isn't used, now that the flow or its schedule begins."""
    unused = databases.unused_setting(run_context.current().workspace.mlflow_uri)
    if unused is not None:
        print(f"note: {unused}", file=sys.stderr)


def check_place() -> None:
    """Raise ``InputError`` where a run cannot write its results or has no room for them.

    Flows of a schedule ask for it themselves: weeks may lie between its start and a run.
    """
    workspace = run_context.current().workspace
    root = workspace.root
    check_writable(root / "probe")
    check_folder(workspace.mlruns)
    free = shutil.disk_usage(root).free
    if free < _ROOM_BYTES:
        raise InputError(
            f"disk of {root}", f"{free / 1e6:.0f} MB free", f"{_ROOM_BYTES / 1e6:.0f} MB", "free some space"
        )


def _interrupt(signum: int, frame: FrameType | None) -> None:
    """Both signals end a flow alike; its workers end by themselves (:func:`tasks.workers.stop_on`)."""
    raise KeyboardInterrupt
