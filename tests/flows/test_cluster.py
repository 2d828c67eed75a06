"""One setting sends a flow's steps to a Dask cluster: the same numbers, and a dead worker costs a retry."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import cluster_steps
import pytest

from tasks import run_context
from tasks.cluster import VARIABLE, check_setting, task_runner
from tasks.failures import StepFailed, WorkerKilled
from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.store import MANIFEST
from tasks.workspace import Workspace


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], RunContext]:
    """A new workspace by name, in use here and in processes that are started from here."""

    def make(name: str) -> RunContext:
        root = tmp_path / name
        root.mkdir(exist_ok=True)
        monkeypatch.setenv("DIESELTWIN_WORKSPACE", str(root))
        display = Display(root / ".cache" / "expected_seconds.json")
        display.console.quiet = True
        context = RunContext(Workspace(root), display)
        run_context.use(context)
        return context

    yield make
    run_context.use(None)


def ensemble(runner, hold: str | None = None) -> str:
    """Three members and their mean with a task runner. Returns the hash of the mean."""
    from prefect import flow

    from tasks.prefect_task import submit

    @flow(name="cluster-ensemble", task_runner=runner)
    def chain() -> str:
        pending = [
            submit(cluster_steps.member, kind=f"{seed}", seed=seed, hold=hold if seed == 1 else None)
            for seed in range(3)
        ]
        first, second, third = (waiting.result() for waiting in pending)
        return submit(cluster_steps.mean, first=first, second=second, third=third).result().sha256

    return chain()


def test_the_setting_is_one_word_and_a_wrong_one_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from prefect.task_runners import ThreadPoolTaskRunner

    monkeypatch.delenv(VARIABLE, raising=False)
    assert isinstance(task_runner(), ThreadPoolTaskRunner)
    monkeypatch.setenv(VARIABLE, "local:3")
    assert task_runner().cluster_kwargs["n_workers"] == 3
    assert type(task_runner("tcp://scheduler:8786")).__name__ == "DaskTaskRunner"
    for wrong in ("dask", "local:0", "scheduler:8786"):
        with pytest.raises(StepFailed, match="allowed: nothing, local, local:4, tcp://HOST:PORT") as failed:
            check_setting(wrong)
        assert failed.value.exit_code == 2
        assert isinstance(task_runner(wrong), ThreadPoolTaskRunner)


@pytest.mark.thorough
@pytest.mark.flow
def test_a_local_cluster_gives_the_same_numbers(prefect: None, workspace: Callable[[str], RunContext]) -> None:
    workspace("threads")
    expected = ensemble(task_runner(""))
    context = workspace("dask")
    assert ensemble(task_runner("local")) == expected
    # The names and times of what ran elsewhere are known here, and a second time nothing runs.
    assert set(context.timings) == {"cluster-member-0", "cluster-member-1", "cluster-member-2", "cluster-mean"}
    again = workspace("dask")
    assert ensemble(task_runner("local:1")) == expected
    assert not again.timings


@pytest.mark.thorough
@pytest.mark.flow
def test_a_worker_killed_in_the_middle_costs_a_retry(
    prefect: None, workspace: Callable[[str], RunContext], tmp_path: Path
) -> None:
    workspace("undisturbed")
    hold = tmp_path / "hold"
    expected = ensemble(task_runner(""), str(hold))
    context = workspace("killed")
    hold.touch()
    killed: list[int] = []

    def kill() -> None:
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline:
            for held in context.workspace.cache.glob("cluster-member/.partial-*/held.txt"):
                # .partial-KEY-PID-...: the Dask worker that waits for the step's process
                killed.append(int(held.parent.name.split("-")[-2]))
                os.kill(killed[0], signal.SIGKILL)
                return
            time.sleep(0.02)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    started = time.monotonic()
    assert ensemble(task_runner("local"), str(hold)) == expected
    killer.join(timeout=5.0)
    assert killed and killed[0] != os.getpid()
    assert time.monotonic() - started < 100.0  # the held step slept 120 s: it was ended with its worker
    results = [path for path in context.workspace.cache.glob("cluster-member/*") if (path / MANIFEST).exists()]
    assert len(results) == 3


@pytest.mark.flow
def test_a_killed_step_process_is_tried_again_and_a_failing_one_is_not(
    prefect: None, workspace: Callable[[str], RunContext], tmp_path: Path
) -> None:
    context = workspace("process")
    hold = tmp_path / "hold"
    hold.touch()

    def kill() -> None:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            for held in context.workspace.cache.glob("cluster-member/.partial-*/held.txt"):
                text = held.read_text()
                if text:
                    os.kill(int(text), signal.SIGKILL)
                    return
            time.sleep(0.02)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    ensemble(task_runner(""), str(hold))
    killer.join(timeout=5.0)
    manifests = list(context.workspace.cache.glob(f"cluster-member/*/{MANIFEST}"))
    assert len(manifests) == 3
    assert all(json.loads(path.read_text())["step"] == "cluster-member" for path in manifests)


def test_a_killed_process_is_told_from_a_failed_one(workspace: Callable[[str], RunContext], tmp_path: Path) -> None:
    context = workspace("plain")
    hold = tmp_path / "hold"
    hold.touch()
    failures: list[BaseException] = []

    def run() -> None:
        try:
            cluster_steps.member(kind="1", seed=1, hold=str(hold))
        except StepFailed as error:
            failures.append(error)

    runner = threading.Thread(target=run)
    runner.start()
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not failures:
        for held in context.workspace.cache.glob("cluster-member/.partial-*/held.txt"):
            if held.read_text():
                os.kill(int(held.read_text()), signal.SIGKILL)
                runner.join(timeout=30.0)
                break
        time.sleep(0.02)
    assert isinstance(failures[0], WorkerKilled) and "status -9" in str(failures[0])
