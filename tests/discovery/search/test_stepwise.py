"""Discovery on small rigs: names one by one, a law for the rest, and what is said where neither holds."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import first_fit
from dieseltwin.discovery.search import stepwise
from dieseltwin.discovery.search.stepwise import Story, discover_stepwise, free_run, metric_of
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.errors import InputError
from tests.discovery.toy import Toy


@pytest.fixture(scope="module")
def story() -> Story:
    """A leak in the vessel, with every name withheld."""
    toy = Toy(1000, 10).record(leak=0.15)
    return discover_stepwise(toy, withhold=tuple(toy.hypotheses))


def test_a_name_is_found_with_its_size() -> None:
    named = discover_stepwise(Toy(1000, 10).record(leak=0.15), law=False)
    assert [step.name for step in named.steps] == ["leak"]
    size, std = named.magnitudes["leak"]
    assert abs(size - 0.15) < 4 * std
    assert named.sentences()[0].startswith("leak at vessel: k x")


def test_without_names_a_law_is_found_where_the_leak_is(story: Story) -> None:
    assert story.steps == () and story.law is not None
    assert story.law.site == "vessel" and story.unresolved == ()
    assert story.sentences() == [f"none of the catalogue, at vessel: {story.law.text}"]


def test_a_law_that_fails_on_later_windows_is_said_to_be_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """Never "nothing is left out" where something is, and only its form or place is open."""
    monkeypatch.setattr(stepwise, "_holds", lambda *_: False)
    toy = Toy(1000, 10).record(leak=0.15)
    found = discover_stepwise(toy, withhold=tuple(toy.hypotheses))
    assert found.law is None and found.unresolved == ("vessel",)
    assert found.sentences() == ["something more, at vessel: laws were found, but none that this recording bears out"]


def test_laws_are_judged_in_runs_of_the_length_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    class Windowed(Toy):
        def windowed(self, window_s: float | None, rows: slice) -> Toy:
            asked.append(window_s)
            part = Toy(len(self.time_s[rows]), 1)
            part.u, part.measured = self.u[rows], self.measured[rows]
            return part

    toy = Windowed(1000, 10).record(leak=0.15)
    discover_stepwise(toy, withhold=tuple(toy.hypotheses), judged_window_s=12.5)
    assert asked == [12.5]


def test_a_story_without_anything_says_what_was_asked(story: Story) -> None:
    empty = replace(story, law=None, steps=(), unresolved=())
    assert empty.sentences() == ["nothing that a name or a law explains on this recording"]
    assert np.isfinite(story.before.objective)


def test_every_name_that_was_weighed_has_its_reason() -> None:
    toy = Toy(1000, 10).record(leak=0.15)
    others = tuple(name for name in toy.hypotheses if name != "leak")
    named = discover_stepwise(toy, law=False, withhold=others[:1])
    assert named.explain("leak")[-1].endswith("taken") and "not" not in named.explain("leak")[-1]
    assert named.explain(others[0]) == [f"{others[0]}: withheld from the catalogue"]
    assert named.explain(others[1])[-1] == f"{others[1]}: not taken"
    with pytest.raises(InputError, match="leak"):
        named.explain("laek")
    assert json.loads(json.dumps(named.to_json()))["effects"][0]["name"] == "leak"


def test_a_run_that_diverges_is_no_fit() -> None:
    """A diverged reading used to count as met exactly, and its slopes ended in a LinAlgError."""

    class Runaway(Toy):
        def simulate(self, lanes: Lanes) -> np.ndarray:
            out = super().simulate(lanes)
            out[:, len(self.time_s) // 2 :][lanes.local[:, 0, 0] > 2.0] = np.nan
            return out

    toy = Runaway(200, 1).record(leak=0.15)
    fit = replace(first_fit(toy), local=np.full_like(toy.first_local(), 5.0))
    assert free_run(toy, fit, metric_of(toy)).shape == toy.measured.shape
