"""A flow or a schedule that is told to end, by Ctrl-C or by a service manager, ends within seconds and leaves nothing
running; what fails on a schedule is said."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
import tiny_settings
import toy_library

from tasks import workers
from tasks.failures import INTERRUPTED, INTERRUPTED_CODE
from tasks.fork_server import ForkServer
from tasks.workspace import PROJECT, Workspace, quiet_settings

HERE = Path(__file__).parent
PATIENCE_S = 20.0  # a busy machine; it is one or two seconds on an idle one


def start(root: Path, program: str) -> subprocess.Popen[str]:
    """A program of this folder in a workspace with the toy library; its step `toy-sum` waits for the file `hold`."""
    toy_library.write_toylib(root)
    tiny_settings.write_params(root)
    (root / "hold").touch()
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
    environment |= {**quiet_settings(Workspace(root)), "DIESELTWIN_WORKSPACE": str(root)}
    environment["TOY_HOLD"] = str(root / "hold")
    environment["PYTHONPATH"] = os.pathsep.join([str(PROJECT), str(HERE), str(root)])
    command = [sys.executable, str(HERE / program), str(root)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ends(process: subprocess.Popen[str], root: Path, told: signal.Signals) -> tuple[str, str]:
    """Send a signal while `toy-sum` runs; all must end. Returns what was printed and what was said of errors."""
    deadline = time.monotonic() + 240.0
    while not list(root.glob(".cache/toy-sum/.partial-*/half.txt")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    below = psutil.Process(process.pid).children(recursive=True)
    assert below
    process.send_signal(told)
    try:
        said = process.communicate(timeout=PATIENCE_S)
    finally:
        (root / "hold").unlink()  # the step would wait for ever
        process.kill()
    assert process.returncode == INTERRUPTED_CODE
    _, alive = psutil.wait_procs(below, timeout=PATIENCE_S)
    assert not [left for left in alive if left.status() != psutil.STATUS_ZOMBIE]
    return said


@pytest.mark.thorough
@pytest.mark.flow
def test_a_signal_during_a_step_ends_the_flow_and_its_workers(tmp_path: Path) -> None:
    """SIGTERM, which Prefect takes for itself; Ctrl-C goes the same way."""
    _, error = ends(start(tmp_path, "toy_flow.py"), tmp_path, signal.SIGTERM)
    assert error.splitlines() == [INTERRUPTED]
    assert not list(tmp_path.glob(".cache/*/.partial-*"))


def test_a_process_forked_while_its_server_is_killed_is_not_waited_for(tmp_path: Path) -> None:
    path = os.pathsep.join([str(PROJECT), str(HERE)])
    with (tmp_path / "log").open("w") as log:
        forked = ForkServer("dying_server", {**os.environ, "PYTHONPATH": path}).start([], log)
    assert forked.pid is None and workers._talk(forked, {"step": "toy-sum"}, lambda fraction: None) == {}
    assert forked.wait() == -signal.SIGKILL
    # The process itself ends as soon as it finds that nothing will be asked of it: its end of the pipe closes.
    assert forked.stdout.read() == "" and not (tmp_path / "log").read_text()
    with forked:
        pass


@pytest.mark.thorough
@pytest.mark.flow
def test_a_signal_ends_a_schedule(tmp_path: Path) -> None:
    process = start(tmp_path, "toy_served.py")
    assert process.stdout is not None
    assert "scheduled '* * * * *'" in process.stdout.readline()
    below = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGTERM)
    try:
        printed, error = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == INTERRUPTED_CODE and not printed
    assert error.splitlines() == [INTERRUPTED]
    _, alive = psutil.wait_procs(below, timeout=PATIENCE_S)
    assert below and not [left for left in alive if left.status() != psutil.STATUS_ZOMBIE]


@pytest.mark.parametrize(
    ("cron", "settings", "said"),
    [
        ("* * * * *", "seed: 1\n", "params.yaml"),
        ("every day", None, "--cron: got 'every day'; allowed: five fields"),
    ],
)
def test_a_schedule_does_not_start_with_what_the_user_can_mend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cron: str, settings: str | None, said: str
) -> None:
    from flows.retrain import retrain
    from tasks.served import serve

    tiny_settings.write_params(tmp_path)
    if settings is not None:
        (tmp_path / "params.yaml").write_text(settings)
    tiny_settings.new_context(tmp_path)
    assert serve(retrain, lambda: cron, profile="tiny") == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and said in error and error.count("\n") == 1


def test_a_run_of_a_schedule_that_fails_is_a_line_and_one_by_hand_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    from flows.retrain import retrain
    from flows.watch import watch
    from tasks.served import tell_failure

    message = "Flow run encountered an exception: StepFailed: maps: ValueError: no convergence\nmore"
    state = SimpleNamespace(name="Failed", message=message)
    tell_failure(SimpleNamespace(name="retrain"), SimpleNamespace(deployment_id=None), state)
    assert not capsys.readouterr().err
    tell_failure(SimpleNamespace(name="retrain"), SimpleNamespace(deployment_id="1"), state)
    error = capsys.readouterr().err
    assert re.fullmatch(r"[-0-9]{10} [:0-9]{8} retrain failed: StepFailed: maps: ValueError: no convergence\n", error)
    for served in (retrain, watch):
        assert tell_failure in served.on_failure_hooks and tell_failure in served.on_crashed_hooks
