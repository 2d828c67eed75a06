"""MLflow: what is logged can be read back, once, and from another place."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tasks import tracking
from tasks.tracking import Curve, Record, Tracker, flat
from tasks.workspace import Workspace

pytestmark = pytest.mark.flow


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    root = tmp_path_factory.mktemp("tracked")
    tracker = Tracker(Workspace(root))
    experiment = tracker.experiment("identify", "three methods", {"column": "A_egrmax"})
    run = tracker.log(experiment, record(root))
    return root, experiment, run


def record(root: Path) -> Record:
    figure = root / "violin.svg"
    figure.write_text("<svg/>")
    members = [Record(f"run {i}", f"r-{i}", metrics={"A_egrmax": 4e-4 + i * 1e-6}) for i in range(3)]
    return Record(
        "classical",
        "abc",
        params=flat({"identify": {"runs": 30, "classical": {"tolerance": 1e-6}}}),
        metrics={"A_egrmax": 4e-4, "h_tot": None, "eta_sc": float("nan")},
        curves=[Curve("loss", range(5000), [1.0 / (i + 1) for i in range(5000)])],
        artifacts={"figures/violin.svg": figure},
        seconds=3.0,
        children=members,
    )


def test_values_curves_members_and_figures_come_back(tracked: tuple[Path, str, str]) -> None:
    root, experiment, run_id = tracked
    client = Tracker(Workspace(root)).client
    run = client.get_run(run_id)
    assert run.info.status == "FINISHED"
    assert run.data.metrics["A_egrmax"] == 4e-4 and "h_tot" not in run.data.metrics
    assert run.data.params["identify.classical.tolerance"] == "1e-06"
    history = client.get_metric_history(run_id, "loss")
    assert 300 < len(history) < 500 and max(point.step for point in history) == 4999
    members = client.search_runs([experiment], f"tags.`mlflow.parentRunId` = '{run_id}'")
    assert {member.info.run_name for member in members} == {"run 0", "run 1", "run 2"}
    assert client.get_experiment(experiment).tags["mlflow.note.content"] == "three methods"


def test_the_same_result_is_logged_once_and_a_cut_off_run_again(tracked: tuple[Path, str, str]) -> None:
    root, experiment, run_id = tracked
    tracker = Tracker(Workspace(root))
    assert tracker.log(experiment, record(root)) == run_id
    tracker.client.update_run(run_id, status="RUNNING")
    again = tracker.log(experiment, record(root))
    assert again != run_id
    assert len(tracker.client.search_runs([experiment])) == 4
    tracker.client.delete_run(again)
    tracker.client.restore_run(run_id)
    tracker.client.update_run(run_id, status="FINISHED")


def test_a_run_says_whether_the_checkout_is_as_it_was_committed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def said() -> dict[str, str]:
        tracking.commit.cache_clear()
        return dict(tracking.commit())

    def git(*arguments: str) -> None:
        identity = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(("git", "-C", str(tmp_path), *identity, *arguments), check=True, capture_output=True)

    monkeypatch.setattr(tracking, "PROJECT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert said() == {}
    git("init")
    for name in ("params.yaml", "dvc.lock"):
        (tmp_path / name).write_text("one")
    assert said() == {}
    git("add", "."), git("commit", "-m", "one")
    assert said()["git.dirty"] == "false" and len(said()["mlflow.source.git.commit"]) == 40
    (tmp_path / "dvc.lock").write_text("of a run that is on")
    (tmp_path / "drive.csv").write_text("somebody's own")
    assert said()["git.dirty"] == "false"
    (tmp_path / "params.yaml").write_text("two")
    assert said()["git.dirty"] == "true"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert said() == {}
    tracking.commit.cache_clear()


def test_a_moved_checkout_keeps_its_artifacts(tracked: tuple[Path, str, str], tmp_path: Path) -> None:
    root, _, run_id = tracked
    moved = tmp_path / "moved"
    shutil.copytree(root, moved)
    uri = Tracker(Workspace(moved)).client.get_run(run_id).info.artifact_uri
    assert uri.startswith("mlflow-artifacts:/") and str(root) not in uri
    assert (moved / "mlruns" / "artifacts" / uri.removeprefix("mlflow-artifacts:/") / "figures/violin.svg").exists()


def test_a_database_that_was_being_made_at_a_kill_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tables_made_once: Callable[[Path], None]
) -> None:
    monkeypatch.setattr(tracking, "_make_database", tables_made_once)
    half = tmp_path / "mlruns" / "mlflow.db.1.partial"
    half.parent.mkdir()
    half.write_bytes(b"half a database")
    assert Tracker(Workspace(tmp_path)).experiment("identify", "again")
    assert not half.exists()
