"""A flow on a schedule: a server and a runner of its own until Ctrl-C or SIGTERM, and a line for every run that failed.

Each run is a process that Prefect's runner starts. Both are killed when this is told to end, and the workers of the run
end with it: what is finished is kept.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from types import FrameType
from typing import Any

from dieseltwin.errors import InputError
from tasks.failures import INTERRUPTED, INTERRUPTED_CODE
from tasks.launch import check_start, command_line, note_unused, start
from tasks.run_context import StepFailed
from tasks.server import ServerFailed, prefect_server
from tasks.store import host
from tasks.workspace import Workspace, prepare_environment

# Set for the process that is the runner.
_RUNNER = "DIESELTWIN_RUNNER"

# What Prefect puts before the words of the exception.
_BEFORE_REASON = "Flow run encountered an exception: "


def tell_failure(flow: Any, flow_run: Any, state: Any) -> None:
    """A line about a run of the schedule that failed or crashed; who starts a flow by hand is told by its command.

    For the hooks of a flow: they run in the run's own process, or in the runner where that was killed.
    """
    if flow_run.deployment_id is None:
        return
    reason = str(state.message or state.name).removeprefix(_BEFORE_REASON).splitlines()[0]
    print(f"{datetime.now():%Y-%m-%d %H:%M:%S} {flow.name} failed: {reason}", file=sys.stderr, flush=True)


def run_or_serve(
    flow: Any,
    cron: Callable[[dict[str, Any]], str],
    *,
    options: Callable[[argparse.ArgumentParser], None] | None = None,
    check: Callable[[dict[str, Any]], None] | None = None,
) -> int:
    """``python -m flows.NAME [--serve [--cron CRON]]``: one flow as a command, once or on a schedule. Returns the exit
    status.

    ``cron`` gives the schedule where the user names none, from the parameters; ``options`` and ``check`` as of
    ``run_alone``.
    """
    parser = command_line(flow, options)
    parser.add_argument("--serve", action="store_true", help="stay and run on the schedule")
    parser.add_argument("--cron", help="schedule of --serve, five fields, such as '0 * * * *' for every hour")
    parameters = vars(parser.parse_args())
    served, given = parameters.pop("serve"), parameters.pop("cron")
    if given is not None and not served:
        parser.error("--cron: a schedule needs --serve")
    if not served:
        return start(flow, parameters, check)
    return serve(flow, lambda: cron(parameters) if given is None else given, check=check, **parameters)


def serve(
    flow: Any, cron: Callable[[], str], *, check: Callable[[dict[str, Any]], None] | None = None, **parameters: Any
) -> int:
    """Register the flow with its schedule on a server of its own and run it when it is due, until Ctrl-C or SIGTERM.

    ``cron`` gives the schedule; ``check`` raises where the parameters are wrong. Returns the exit status: 2 for what
    the user can mend, which is said before anything starts.
    """
    if os.environ.get(_RUNNER):
        return _run_when_due(flow, cron(), parameters)
    workspace = prepare_environment()
    try:
        check_start(parameters, check)
        schedule = _checked(cron())
        note_unused()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _interrupt)
        with prefect_server(workspace, scheduled=True) as address, _runner() as runner:
            print(f"{flow.name}: scheduled '{schedule}' on {address}; Ctrl-C ends it", flush=True)
            status = runner.wait()
        raise StepFailed(f"{flow.name}: what starts the runs ended with status {status}; start again")
    except KeyboardInterrupt:
        print(INTERRUPTED, file=sys.stderr)
        return INTERRUPTED_CODE
    except (StepFailed, ServerFailed, InputError) as error:
        print(f"error: {error}", file=sys.stderr)
        return getattr(error, "exit_code", 1)


def _checked(cron: str) -> str:
    from prefect.client.schemas.schedules import CronSchedule

    try:
        CronSchedule(cron=cron)
    except ValueError:
        raise InputError("--cron", repr(cron), "five fields, such as '0 * * * *' for every hour", "mend it") from None
    return cron


@contextmanager
def _runner() -> Iterator[subprocess.Popen[bytes]]:
    """The command of this process once more, as Prefect's runner and in a group of its own, which is killed at the end:
    told to end, the runner would wait for the run, and the run for its step."""
    command = [sys.executable, *sys.orig_argv[1:]]
    environment = {**os.environ, _RUNNER: "1"}
    runner = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, start_new_session=True)
    try:
        yield runner
    finally:
        with suppress(ProcessLookupError):
            os.killpg(runner.pid, signal.SIGKILL)
        runner.wait()


def _run_when_due(flow: Any, cron: str, parameters: dict[str, Any]) -> int:
    """What the runner's process does: its group, with the run in it, ends with its parent."""
    threading.Thread(target=_end_group_with_parent, daemon=True).start()
    name = deployment_name(flow.name, parameters)
    _forget_missed(f"{flow.name}/{name}")
    flow.serve(name=name, cron=cron, parameters=parameters, limit=1, print_starting_message=False)
    return 0


def deployment_name(flow: str, parameters: Mapping[str, Any]) -> str:
    """A name for each flow, its parameters and the place from which it was started, where the paths among them count.

    Two schedules of one name would be one for Prefect: the later one's parameters would hold for both.
    """
    place = [host(), str(Workspace.current().root), os.getcwd()]
    told = json.dumps([flow, parameters, place], sort_keys=True, default=str)
    return f"scheduled-{hashlib.sha256(told.encode()).hexdigest()[:10]}"


def _forget_missed(deployment: str) -> None:
    """Remove the runs of a deployment that were due while nobody ran them: one run does the work of all of them."""
    from prefect.client.orchestration import get_client
    from prefect.client.schemas import StateType, filters
    from prefect.exceptions import ObjectNotFound

    with get_client(sync_client=True) as client:
        try:
            found = client.read_deployment_by_name(deployment)
        except ObjectNotFound:
            return
        waiting = filters.FlowRunFilter(
            state=filters.FlowRunFilterState(type=filters.FlowRunFilterStateType(any_=[StateType.SCHEDULED])),
            next_scheduled_start_time=filters.FlowRunFilterNextScheduledStartTime(before_=datetime.now(UTC)),
        )
        its_own = filters.DeploymentFilter(id=filters.DeploymentFilterId(any_=[found.id]))
        while missed := client.read_flow_runs(flow_run_filter=waiting, deployment_filter=its_own):
            for run in missed:
                with suppress(ObjectNotFound):  # another process was first
                    client.delete_flow_run(run.id)


def _end_group_with_parent() -> None:
    while os.read(0, 4096):
        pass
    os.killpg(0, signal.SIGKILL)


def _interrupt(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
