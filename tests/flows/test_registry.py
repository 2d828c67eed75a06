"""Versions of the networks: known by their files, promoted unless they are worse, never by accident."""

from __future__ import annotations

from pathlib import Path

import pytest

from tasks.registry import CHALLENGER, CHAMPION, NAME, PREVIOUS, Registry, decide
from tasks.store import Artifact
from tasks.tracking import Tracker
from tasks.workspace import Workspace

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


def networks(root: Path, name: str) -> Artifact:
    folder = root / name
    (folder / "errors").mkdir(parents=True)
    (folder / "bodies.pt").write_text(name)
    (folder / "errors" / "bodies.json").write_text("{}")
    return Artifact.of(folder)


@pytest.mark.flow
def test_versions_aliases_and_files(tmp_path: Path) -> None:
    tracker = Tracker(Workspace(tmp_path / "first"))
    registry = Registry(tracker)
    experiment = tracker.experiment("promote", "comparisons")
    assert registry.version(CHAMPION) is None

    first = registry.register(networks(tmp_path, "a"), experiment, {"profile": "tiny"})
    registry.record(first, decide({"e": 1.0}, None, **LIMITS))
    assert registry.version(CHAMPION) == first and first.number == 1
    assert (first.path / "errors" / "bodies.json").exists()
    assert registry.register(Artifact.of(tmp_path / "a"), experiment, {}) == first  # the same files, the same version

    worse = registry.register(networks(tmp_path, "b"), experiment, {})
    registry.record(worse, decide({"e": 2.0}, {"e": 1.0}, **LIMITS))
    assert registry.version(CHAMPION) == first and registry.version(CHALLENGER) == worse
    assert registry.client.get_model_version(NAME, "2").tags["decision"] == "refused"

    better = registry.register(networks(tmp_path, "c"), experiment, {})
    registry.record(better, decide({"e": 0.5}, {"e": 1.0}, **LIMITS))
    assert registry.version(CHAMPION) == better and registry.version(PREVIOUS) == first

    # A moved checkout keeps its versions; a spoilt file is no champion.
    (tmp_path / "first").rename(tmp_path / "moved")
    moved = Registry(Tracker(Workspace(tmp_path / "moved")))
    found = moved.version(CHAMPION)
    assert found is not None and found.path.is_relative_to(tmp_path / "moved")
    (found.path / "bodies.pt").write_text("spoilt")
    assert moved.version(CHAMPION) is None
