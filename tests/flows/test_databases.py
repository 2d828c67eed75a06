"""Where MLflow and Prefect keep their rows: a file, or the server that a setting names; wrong settings are one line."""

from __future__ import annotations

import socket
import sqlite3
import threading
from pathlib import Path

import pytest

from tasks import databases
from tasks.failures import StepFailed
from tasks.tracking import Record, Tracker
from tasks.workspace import Workspace, quiet_settings


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


def test_errors_of_their_databases_are_one_line_and_others_keep_their_traceback() -> None:
    line = databases.failure(sqlite3.OperationalError("disk is full"), "sqlite:////work/mlflow.db")
    assert line is not None and line.startswith("MLflow's database sqlite:////work/mlflow.db: disk is full;")
    assert databases.failure(ValueError("ours"), "sqlite://") is None
    line = databases.failure(RuntimeError("Failed to reach API at http://127.0.0.1:1/api/"), "sqlite://")
    assert line is not None and "server.log" in line
    assert "out of memory" in str(databases.failure(MemoryError(), "sqlite://"))


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
