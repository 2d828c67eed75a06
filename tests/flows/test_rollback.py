"""Back to an earlier version: it stays back, whoever moved the alias, and every decision is a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tiny_settings
from test_registry import networks

from dieseltwin.errors import InputError
from tasks import promote, records, tracking
from tasks.registry import CHAMPION, NAME, OUT, OUT_DATE, OUT_REASON, PREVIOUS, USE, Candidate, Registry
from tasks.rollback import BY_HAND, take_note, target
from tasks.settings import load_settings
from tasks.tracking import Record, Tracker

pytestmark = pytest.mark.flow


class Engineroom:
    """A workspace in which sets of networks are promoted."""

    def __init__(self, root: Path) -> None:
        tiny_settings.write_params(root)
        self.context = tiny_settings.new_context(root)
        self.root, self.settings = root, load_settings("tiny")
        self.registry = Registry(Tracker(self.context.workspace))
        self.said: list[str] = []
        self.context.display.say = self.said.append  # type: ignore[method-assign]

    def candidate(self, name: str, tests: Any = ()) -> Candidate:
        made = networks(self.root, name) if not (self.root / name).exists() else None
        from tasks.model_folder import NETWORKS
        from tasks.store import Artifact

        made = made or (Artifact.of(self.root / name / NETWORKS), Artifact.of(self.root / name))
        return Candidate(*made, {"e": 1.0}, tests)

    def promote(self, name: str, *, again: bool = False) -> bool:
        return promote.promote(self.candidate(name), {"e": 1.0}, self.settings, again=again).promoted

    def back(self, to: int | None = None, reason: str = "it surges") -> None:
        promote.roll_back(to, reason, self.settings)

    def tags(self, number: int) -> dict[str, str]:
        return dict(self.registry.client.get_model_version(NAME, str(number)).tags)

    def numbers(self) -> tuple[int | None, int | None]:
        return self.registry.number(CHAMPION), self.registry.number(PREVIOUS)

    def decisions(self) -> list[str]:
        experiment = self.registry.client.get_experiment_by_name("promote").experiment_id
        runs = self.registry.client.search_runs([experiment], order_by=["attributes.start_time ASC"])
        return [run.data.params["decision"] for run in runs if "decision" in run.data.params]


@pytest.fixture
def room(tmp_path: Path) -> Engineroom:
    return Engineroom(tmp_path)


def test_a_roll_back_sticks_until_it_is_told_otherwise(room: Engineroom) -> None:
    for name in "ab":
        assert room.promote(name)
    assert room.numbers() == (2, 1) and room.tags(1)[USE] == "superseded by version 2"
    room.back(reason="it surges\nin the hills")
    assert room.numbers() == (1, None)
    assert (room.tags(2)[USE], room.tags(2)[OUT_REASON]) == (OUT, "it surges in the hills") and room.tags(2)[OUT_DATE]
    assert "version 1 is champion in place of version 2, which is taken out of use: it surges" in room.said[-1]

    assert not room.promote("b") and room.numbers() == (1, None)
    assert "it was taken out of use on 20" in room.said[-1] and "--again" in room.said[-1]
    assert "\n" not in room.said[-1]
    with pytest.raises(InputError, match="--back: got no version that was in use before"):
        room.back()
    assert room.promote("c") and room.numbers() == (3, 1)
    assert room.promote("b", again=True) and room.numbers() == (2, 3)
    assert OUT_REASON not in room.tags(2)
    assert room.promote("b")  # in use
    assert sorted(room.decisions()) == sorted(["promoted"] * 5 + ["rolled back", "refused"])
    room.back(to=1)
    assert room.numbers() == (1, None) and room.tags(2)[USE] == OUT


def test_going_back_twice_reaches_what_was_before_both(room: Engineroom) -> None:
    for name in "abc":
        assert room.promote(name)
    room.back()
    assert room.numbers() == (2, 1)
    room.back()
    assert room.numbers() == (1, None) and room.tags(3)[USE] == room.tags(2)[USE] == OUT
    room.back(to=3)  # named, so wanted
    assert room.numbers() == (3, None) and room.tags(1)[USE] == OUT


@pytest.mark.parametrize("told", [True, False])
def test_an_alias_that_was_moved_by_hand_stays_where_it_was_put(room: Engineroom, told: bool) -> None:
    for name in "ab":
        assert room.promote(name)
    if not told:  # versions of before there was the tag
        for number in "12":
            room.registry.tag(number, {USE: None})
    room.registry.client.set_registered_model_alias(NAME, CHAMPION, "1")
    assert not room.promote("b")
    assert room.said[-2] == f"registry: version 2 is taken out of use: {BY_HAND}"
    assert room.numbers() == (1, None) and room.tags(2)[OUT_REASON] == BY_HAND
    room.registry.client.set_registered_model_alias(NAME, CHAMPION, "2")
    assert take_note(room.registry) == [1] and room.tags(2)[USE] != OUT and OUT_DATE not in room.tags(2)


def test_a_version_says_how_its_networks_were_trained(room: Engineroom, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the run that made them, whatever is checked out today; and what is known of them stands at its source run."""
    networks_of_a = room.candidate("a").networks
    record = Record("models", "a", params={"seed": 7}, tags=records.outputs(models=networks_of_a))
    monkeypatch.setattr(tracking, "commit", lambda: {"mlflow.source.git.commit": "1" * 40, "git.dirty": "true"})
    (trained,) = records.log("pretrain", room.settings, record)
    monkeypatch.setattr(tracking, "commit", lambda: {"mlflow.source.git.commit": "2" * 40, "git.dirty": "false"})
    assert room.promote("a") and room.promote("b")
    first, second = room.tags(1), room.tags(2)
    assert (first["trained_in"], first["mlflow.source.git.commit"], first["git.dirty"]) == (trained, "1" * 40, "true")
    assert "trained_in" not in second and len(first["params_sha256"]) == len(second["params_sha256"]) == 64
    source = room.registry.client.get_run(room.registry.client.get_model_version(NAME, "1").run_id)
    assert source.data.params["seed"] == "7" and source.data.metrics["new_error_pct/e"] == 1.0
    assert [given.dataset.digest for given in source.inputs.dataset_inputs] == [networks_of_a.sha256[:12]]


def test_only_a_whole_version_that_was_in_use_is_gone_back_to(room: Engineroom) -> None:
    for name in "ab":
        assert room.promote(name)
    failed = [{"name": "rest", "figure": None, "limit": 0.03, "sentence": "no stable rest", "passed": False}]
    assert not promote.promote(room.candidate("c", failed), {"e": 1.0}, room.settings).promoted
    for number, words in ((2, "which is in use"), (3, "which never was in use"), (9, "not there")):
        with pytest.raises(InputError, match=words):
            target(room.registry, number)
    found = room.registry.numbered(1)
    assert found is not None
    (found.path / "bodies.pt").write_text("spoilt")
    with pytest.raises(InputError, match="gone or changed"):
        room.back()
    assert room.numbers() == (2, 1) and room.tags(2)[USE] != OUT
    assert room.promote("c")  # without tests
    tags = room.tags(3)
    assert tags["decision"] == "promoted" and not [name for name in tags if name.startswith("acceptance")]
    version = room.registry.numbered(3)
    assert version is not None and not (version.folder / "acceptance.json").exists()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"back": True}, "--back: got no reason"),
        ({"to": 1, "reason": " "}, "--to: got no reason"),
        ({"back": True, "to": 1, "reason": "x"}, "several ways"),
        ({"back": True, "again": True, "reason": "x"}, "several ways"),
        ({"reason": "x"}, "--reason: got 'x'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        promote.check({"back": False, "to": None, "again": False, "reason": None, **given})
