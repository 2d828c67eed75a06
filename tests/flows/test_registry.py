"""Versions of the networks: known by their files, promoted unless they are worse, never by accident."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tasks.failures import StepFailed
from tasks.model_folder import MODEL_FILE, NETWORKS
from tasks.registry import CHALLENGER, CHAMPION, NAME, PREVIOUS, Registry, decide
from tasks.store import Artifact
from tasks.tracking import Tracker
from tasks.workspace import PROJECT, Workspace

LIMITS = {"mean_ratio_max": 1.02, "worst_ratio_max": 1.25}


@pytest.mark.parametrize(
    ("new", "champion", "promoted", "words"),
    [
        ({"a": 1.0, "b": 2.0}, None, True, "no champion"),
        ({"a": 0.5, "b": 2.1}, {"a": 1.0, "b": 2.0}, True, "of the champion's in the mean"),
        ({"a": 1.0, "b": 2.0}, {"a": 1.0, "b": 2.0}, True, "1.000"),
        ({"a": 1.1, "b": 2.1}, {"a": 1.0, "b": 2.0}, False, "in the mean at most 1.02"),
        ({"a": 0.1, "b": 2.6}, {"a": 1.0, "b": 2.0}, False, "b 1.300; each at most 1.25"),
        ({"a": 0.1}, {"a": 1.0, "b": 2.0}, False, "lacks: b"),
        ({"a": 0.1, "c": 9.0}, {"a": 1.0}, True, "a 0.100"),
        ({"a": float("nan"), "b": 1.0}, None, False, "no valid figure for a"),
        ({}, None, False, "no figures"),
        ({"a": 0.0}, {"a": 0.0}, True, "1.000"),
    ],
)
def test_not_worse_means_in_the_mean_and_in_each_figure(new, champion, promoted: bool, words: str) -> None:
    decision = decide(new, champion, **LIMITS)
    assert decision.promoted is promoted and words in decision.reason


@pytest.mark.parametrize("champion", [None, {"a": 1.0}])
def test_a_failed_physical_test_decides_whatever_the_errors_say(champion) -> None:
    decision = decide({"a": 0.1}, champion, **LIMITS, failures=["f_egr goes the wrong way in 98.00 % of its moves"])
    assert not decision.promoted
    assert decision.reason == "it fails a physical test: f_egr goes the wrong way in 98.00 % of its moves"


def networks(root: Path, name: str) -> tuple[Artifact, Artifact]:
    """Networks and the model that holds them."""
    model = root / name
    folder = model / NETWORKS
    (folder / "errors").mkdir(parents=True)
    (folder / "bodies.pt").write_text(name)
    (folder / "errors" / "bodies.json").write_text("{}")
    (model / MODEL_FILE).write_text("flavors: {}")
    return Artifact.of(folder), Artifact.of(model)


def test_a_registry_without_a_champion_is_not_served(tmp_path: Path) -> None:
    environment = {**os.environ, "DIESELTWIN_WORKSPACE": str(tmp_path)}
    command = [sys.executable, "-m", "tasks.serve_champion"]
    ended = subprocess.run(command, cwd=PROJECT, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert "got none; allowed: a model whose networks agree with their checksum" in ended.stderr
    assert not list(tmp_path.glob("mlruns/mlflow.db"))


@pytest.mark.flow
def test_who_serves_is_told_why_nothing_is_in_use(tmp_path: Path) -> None:
    registry = Registry(Tracker(Workspace(tmp_path)))
    only = registry.register(*networks(tmp_path, "a"), registry.tracker.experiment("promote", "comparisons"), {})
    registry.record(only, decide({"e": 1.0}, None, **LIMITS, failures=["no stable rest"]))
    environment = {**os.environ, "DIESELTWIN_WORKSPACE": str(tmp_path)}
    command = [sys.executable, "-m", "tasks.serve_champion"]
    ended = subprocess.run(command, cwd=PROJECT, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1
    assert "got none (version 1 was refused: it fails a physical test: no stable rest)" in ended.stderr


@pytest.mark.flow
def test_of_files_that_are_not_what_was_trained_no_version_is_made(tmp_path: Path) -> None:
    tracker = Tracker(Workspace(tmp_path / "first"))
    registry = Registry(tracker)
    trained, model = networks(tmp_path, "a")
    (model.path / NETWORKS / "bodies.pt").write_text("spoilt")
    with pytest.raises(StepFailed, match="doesn't agree with what was trained"):
        registry.register(trained, model, tracker.experiment("promote", "comparisons"), {})
    assert not list(registry.client.search_model_versions(f"name='{NAME}'"))


def test_versions_aliases_and_files(tmp_path: Path) -> None:
    tracker = Tracker(Workspace(tmp_path / "first"))
    registry = Registry(tracker)
    experiment = tracker.experiment("promote", "comparisons")
    assert registry.version(CHAMPION) is None

    made = networks(tmp_path, "a")
    first = registry.register(*made, experiment, {"profile": "tiny"})
    tests = [{"name": "rest", "figure": 0.01, "limit": 0.03, "sentence": "it rests", "passed": True}]
    registry.record(first, decide({"e": 1.0}, None, **LIMITS), tests)
    assert registry.version(CHAMPION) == first and first.number == 1
    assert (first.path / "errors" / "bodies.json").exists()
    assert first.served and json.loads((first.folder / "acceptance.json").read_text()) == tests
    tags = registry.client.get_model_version(NAME, "1").tags
    assert (tags["acceptance"], tags["acceptance.rest"]) == ("passed", "passed: 0.01, limit 0.03")
    assert registry.register(*made, experiment, {}) == first  # the same files, the same version

    (first.path / "bodies.pt").unlink()
    assert registry.version(CHAMPION) is None
    assert registry.register(*made, experiment, {}) == first == registry.version(CHAMPION)  # whole again

    worse = registry.register(*networks(tmp_path, "b"), experiment, {})
    registry.record(worse, decide({"e": 2.0}, {"e": 1.0}, **LIMITS))
    assert registry.version(CHAMPION) == first and registry.version(CHALLENGER) == worse
    assert registry.client.get_model_version(NAME, "2").tags["decision"] == "refused"

    last = registry.refusal()
    assert last is not None and last[0] == 2 and last[1].startswith("errors are 2.000 of the champion's in the mean")

    better = registry.register(*networks(tmp_path, "c"), experiment, {})
    registry.record(better, decide({"e": 0.5}, {"e": 1.0}, **LIMITS))
    assert registry.version(CHAMPION) == better and registry.version(PREVIOUS) == first

    broken = registry.register(*networks(tmp_path, "d"), experiment, {})
    failed = [{"name": "rest", "figure": None, "limit": 0.03, "sentence": "no stable rest", "passed": False}]
    registry.record(broken, decide({"e": 0.1}, {"e": 0.5}, **LIMITS, failures=["no stable rest"]), failed)
    assert registry.version(CHAMPION) == better and registry.version(CHALLENGER) == broken
    tags = registry.client.get_model_version(NAME, str(broken.number)).tags
    assert (tags["acceptance"], tags["acceptance.rest"]) == ("failed", "failed: no number, limit 0.03")
    assert "no stable rest" in tags["reason"]
    registry.record(broken, decide({"e": 0.1}, {"e": 0.5}, **LIMITS))  # by tests with other limits
    assert registry.version(CHAMPION) == broken and registry.version(CHALLENGER) is None and not registry.refusal()
    left = registry.client.get_model_version(NAME, str(broken.number)).tags  # of the tests that it failed nothing
    assert left["decision"] == "promoted" and not [name for name in left if name.startswith("acceptance")]
    assert not (broken.folder / "acceptance.json").exists()

    # A moved checkout keeps its versions; a spoilt file is no champion.
    (tmp_path / "first").rename(tmp_path / "moved")
    moved = Registry(Tracker(Workspace(tmp_path / "moved")))
    found = moved.version(CHAMPION)
    assert found is not None and found.path.is_relative_to(tmp_path / "moved")
    (found.path / "bodies.pt").write_text("spoilt")
    assert moved.version(CHAMPION) is None
