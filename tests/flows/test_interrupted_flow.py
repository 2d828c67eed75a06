"""A flow that is told to end, by Ctrl-C or by a service manager, ends within seconds and leaves nothing running."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import toy_library

from tasks.failures import INTERRUPTED, INTERRUPTED_CODE
from tasks.workspace import PROJECT, Workspace, quiet_settings

HERE = Path(__file__).parent
PATIENCE_S = 20.0  # a busy machine; it is one or two seconds on an idle one


@pytest.mark.flow
@pytest.mark.parametrize("told", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_during_a_step_ends_the_flow_and_its_workers(tmp_path: Path, told: signal.Signals) -> None:
    toy_library.write_toylib(tmp_path)
    hold = tmp_path / "hold"
    hold.touch()
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
    environment |= {**quiet_settings(Workspace(tmp_path)), "DIESELTWIN_WORKSPACE": str(tmp_path), "TOY_HOLD": str(hold)}
    environment["PYTHONPATH"] = os.pathsep.join([str(PROJECT), str(HERE), str(tmp_path)])
    command = [sys.executable, str(HERE / "toy_flow.py"), str(tmp_path)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120.0
    while not list(tmp_path.glob(".cache/toy-sum/.partial-*/half.txt")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    below = psutil.Process(process.pid).children(recursive=True)
    assert below
    process.send_signal(told)
    try:
        _, error = process.communicate(timeout=PATIENCE_S)
    finally:
        hold.unlink()  # the step would wait for ever
        process.kill()
    assert process.returncode == INTERRUPTED_CODE
    assert error.splitlines() == [INTERRUPTED]
    _, alive = psutil.wait_procs(below, timeout=PATIENCE_S)
    assert not [left for left in alive if left.status() != psutil.STATUS_ZOMBIE]
    assert not list(tmp_path.glob(".cache/*/.partial-*"))
