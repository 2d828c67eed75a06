"""Runs in pieces side by side are the runs step by step: with effects, schedules, signals, laws, gaps and windows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.twins import pieces
from dieseltwin.discovery.twins.interface import Hypothesis, Lanes, Parameter, Point
from dieseltwin.discovery.twins.simple import Model, SimpleTwin

TIME = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.15, 400))
LEVEL = 1.0 + np.sin(0.4 * TIME) + 0.5 * np.sign(np.sin(0.9 * TIME))


def rates(x: Any, u: Any, p: Any, s: Any, e: Any) -> tuple[Any, ...]:
    """A pendulum that is pushed, in a leaking tank."""
    pull = s("pull", -p.stiffness * np.sin(x.angle))
    flow = s("flow", u.level - np.sqrt(np.maximum(x.height, 0.0)) - e.leak * x.height)
    return x.speed, pull - 0.3 * x.speed + 0.1 * x.height, flow


def twin(window_s: float | None = None, stiffness: float = 2.0) -> SimpleTwin:
    model = Model(
        states={"angle": 1.0, "speed": 1.0, "height": 1.0}, inputs=("level",), channels=("angle", "height"),
        parameters=(Parameter("stiffness", stiffness, 0.5, "-", 0.1),), rates=rates,
        readings=lambda x, u, p, s, e: (x.angle, x.height),
        points=(Point("flow", "tank", False, "-", ("level",), 1.0), Point("pull", "arm", True, "-", ("angle",), 1.0)),
        hypotheses=(Hypothesis("leak", "tank", "k h", "-", 0.05, (0.0, 1.0), True, (0.05,)),),
    )  # fmt: skip
    return SimpleTwin(model, TIME, {"level": LEVEL}, np.zeros((TIME.size, 2)), window_s)


def lanes_of(made: SimpleTwin, stiffness: float = 2.0) -> Lanes:
    """Three lanes that differ in everything."""
    local = np.random.default_rng(1).uniform(0.5, 1.0, (3, len(made.starts), 3))
    signals = 0.1 * np.sin(np.outer([1.0, 2.0, 3.0], TIME))
    return Lanes(
        stiffness * np.array([[1.0], [1.1], [0.9]]), local, {"leak": np.array([0.0, 0.2, 0.4])},
        {"leak": (TIME > 10.0).astype(float)}, {"pull": 0.05 * np.cos(TIME)}, np.array([-1, 0, 1]), signals,
    )  # fmt: skip


def step_by_step(made: SimpleTwin, lanes: Lanes, laws: Any, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    with monkeypatch.context() as patch:
        patch.setattr(pieces, "worth_it", lambda *_: False)
        return made.simulate_with_laws(lanes, laws)


@pytest.mark.parametrize("window_s", [None, 17.0])
def test_they_are_the_runs_step_by_step(window_s: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    made = twin(window_s)
    lanes, ran = lanes_of(made), []
    laws = {"flow": [lambda at: -np.array([[0.1], [0.2], [0.0]]) * at["height"]]}  # a coefficient for each lane
    whole = pieces.trajectory_of
    monkeypatch.setattr(pieces, "trajectory_of", lambda *given: ran.append(whole(*given)) or ran[-1])
    made.simulate(lanes)  # the first run is made step by step
    assert not ran
    for extra in ({}, laws):
        expected = step_by_step(made, lanes, extra, monkeypatch)
        found = made.simulate_with_laws(lanes, extra)
        assert ran.pop() is not None  # the gaps closed
        assert np.abs(found - expected).max() < 1e-9


def test_runs_that_leave_every_guess_are_made_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    made = twin(stiffness=-40.0)  # the pendulum stands on its head, and turns over and over
    lanes = lanes_of(made, stiffness=-40.0)
    made.simulate(lanes_of(made))
    expected = step_by_step(made, lanes, {}, monkeypatch)
    assert np.abs(made.simulate(lanes) - expected).max() < 1e-6
    monkeypatch.setattr(pieces, "_ROUNDS", 1)  # no gap closes in one
    assert np.array_equal(made.simulate(lanes_of(made)), step_by_step(made, lanes_of(made), {}, monkeypatch))


def test_short_runs_and_many_windows_are_left_as_they_are() -> None:
    assert not pieces.worth_it(pieces.STEPS, 1, 4, 2) and not pieces.worth_it(100, 2000, 40, 3)
    assert pieces.worth_it(900, 1, 4, 2)
    rows = pieces.rows_of(np.arange(30)[:, None])
    assert rows.shape == (pieces.STEPS + 1, 3) and rows[-1].tolist() == [12, 24, 29]
