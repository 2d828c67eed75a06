"""Where MLflow and Prefect keep their rows: a file, or the server that a setting names; wrong settings are one line."""

from __future__ import annotations

import errno
import os
import socket
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import tiny_settings

from tasks import databases
from tasks.failures import StepFailed
from tasks.tracking import Record, Tracker
from tasks.workspace import PROJECT, Workspace, quiet_settings


def test_without_a_setting_both_are_files_of_the_workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(databases.MLFLOW, raising=False)
    monkeypatch.delenv(databases.PREFECT, raising=False)
    databases.check_settings()
    found = quiet_settings(Workspace(tmp_path))
    assert found["MLFLOW_TRACKING_URI"] == f"sqlite:///{tmp_path}/mlruns/mlflow.db"
    assert "PREFECT_SERVER_DATABASE_CONNECTION_URL" not in found


def test_a_setting_names_a_server_with_the_driver_of_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in (databases.MLFLOW, databases.PREFECT):
        monkeypatch.setenv(variable, "postgresql://me:secret@db:5432/rows")
    found = quiet_settings(Workspace(tmp_path))
    assert found["MLFLOW_TRACKING_URI"] == "postgresql+psycopg://me:secret@db:5432/rows"
    assert found["PREFECT_SERVER_DATABASE_CONNECTION_URL"] == "postgresql+asyncpg://me:secret@db:5432/rows"
    assert databases.shown("postgresql://me:secret@db:5432/rows") == "postgresql://me:...@db:5432/rows"
    for password in ("a/b", "a@b", "a:b", "/@:"):
        assert databases.shown(f"postgresql://me:{password}@db:5432/rows") == "postgresql://me:...@db:5432/rows"
    assert databases.shown("postgresql://me@db:5432/rows") == "postgresql://me@db:5432/rows"


@pytest.mark.parametrize("given", ["mysql://me@db/rows", "postgresql://", "rows", "http://db:5000"])
def test_an_address_of_another_kind_is_refused(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(databases.MLFLOW, given)
    with pytest.raises(StepFailed, match=r"DIESELTWIN_MLFLOW: got .*; allowed: nothing, or postgresql://") as caught:
        databases.check_settings()
    assert caught.value.exit_code == 2


def test_a_server_that_does_not_answer_is_one_line_without_the_password(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv(databases.PREFECT, f"postgresql://me:secret@127.0.0.1:{free.getsockname()[1]}/rows")
        with pytest.raises(StepFailed, match="DIESELTWIN_PREFECT: got no answer of postgresql://me:") as caught:
            databases.check_settings()
    assert "secret" not in str(caught.value) and "\n" not in str(caught.value)


def test_errors_of_their_databases_are_one_line_and_others_keep_their_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(databases.API, raising=False)
    line = databases.failure(sqlite3.OperationalError("disk is full"), "sqlite:////work/mlflow.db")
    assert line is not None and line.startswith("MLflow's database sqlite:////work/mlflow.db: disk is full;")
    assert databases.failure(ValueError("ours"), "sqlite://") is None
    line = databases.failure(RuntimeError("Failed to reach API at http://127.0.0.1:1/api/"), "sqlite://")
    assert line is not None and "server.log" in line
    monkeypatch.setenv(databases.API, "http://me:secret@127.0.0.1:1/api")
    line = databases.failure(RuntimeError("Failed to reach API at http://127.0.0.1:1/api/"), "sqlite://")
    assert line is not None and line.startswith("PREFECT_API_URL: got no answer of http://me:...@127.0.0.1:1/api;")
    assert "out of memory" in str(databases.failure(MemoryError(), "sqlite://"))


def test_a_disk_that_is_full_or_may_not_be_written_is_one_line_with_its_own_advice() -> None:
    full = databases.failure(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/here/.cache/a"), "sqlite://")
    assert full == "/here/.cache/a: No space left on device; what was computed is kept: free some space, and run again"
    fixed = databases.failure(OSError(errno.EROFS, os.strerror(errno.EROFS)), "sqlite://")
    assert fixed is not None and fixed.startswith("the disk: Read-only file system;") and "make it writable" in fixed
    assert databases.failure(FileNotFoundError(errno.ENOENT, "No such file", "ours.csv"), "sqlite://") is None
    advised = {"database or disk is full": "free some space", "attempt to write a readonly database": "make it"}
    for said, advice in advised.items():
        line = databases.failure(sqlite3.OperationalError(said), "sqlite://")
        assert line is not None and f"is kept: {advice}" in line and "move it away" not in line


def test_who_may_not_write_beside_a_database_reads_it_without_a_lock() -> None:
    with databases.one_at_a_time(databases.MLFLOW, Path("/sys/.lock")):  # where nobody may write, root neither
        pass


def test_a_tracking_address_that_is_not_used_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = Workspace(tmp_path).mlflow_uri
    for same in ("", own):
        monkeypatch.setenv("MLFLOW_TRACKING_URI", same)
        assert databases.unused_setting(own) is None
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "https://me:secret@mlflow.example/")
    said = databases.unused_setting(own)
    assert said is not None and said.startswith("MLFLOW_TRACKING_URI=https://me:...@mlflow.example/ isn't used: ")
    assert str(tmp_path) in said and "DIESELTWIN_MLFLOW" in said and "secret" not in said


@pytest.mark.parametrize("place", ["http://127.0.0.1:{port}/api", "127.0.0.1"])
def test_a_prefect_server_that_does_not_answer_is_named_before_anything_starts(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from flows.simulate import simulate
    from tasks.launch import run_alone

    tiny_settings.write_params(tmp_path)
    tiny_settings.new_context(tmp_path)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = place.format(port=free.getsockname()[1])
        monkeypatch.setenv(databases.API, address)
        assert run_alone(simulate, ["--profile", "tiny"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: PREFECT_API_URL: got no answer of {address}: ") and error.count("\n") == 1


@pytest.mark.parametrize("command", ["serve_champion", "ui"])
def test_a_broken_database_is_one_line_of_what_becomes_a_server(command: str, tmp_path: Path) -> None:
    (tmp_path / "mlruns").mkdir()
    (tmp_path / "mlruns" / "mlflow.db").write_text("no database at all" * 100)
    environment = {**os.environ, "DIESELTWIN_WORKSPACE": str(tmp_path)}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    asked = [sys.executable, "-m", f"tasks.{command}", "--port", port]
    ended = subprocess.run(asked, cwd=PROJECT, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1 and ended.stderr.count("\n") == 1
    assert ended.stderr.startswith("error: MLflow's database sqlite://") and "not a database" in ended.stderr


@pytest.mark.flow
def test_writers_at_once_land_whole(tmp_path: Path) -> None:
    tracker = Tracker(Workspace(tmp_path))
    experiment = tracker.experiment("writers", "at once")

    def write(name: str) -> None:
        child = Record(f"{name} child", f"{name} child")
        Tracker(Workspace(tmp_path)).log(experiment, Record(name, name, metrics={"x": 1.0}, children=[child]))

    threads = [threading.Thread(target=write, args=(f"writer {i}",)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    runs = tracker.client.search_runs([experiment])
    assert len(runs) == 12 and all(run.info.status == "FINISHED" for run in runs)
