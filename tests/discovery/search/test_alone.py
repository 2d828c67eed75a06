"""What each of several recordings leaves when it is judged alone, and who is told to be of another engine."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dieseltwin.discovery.search import alone
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.discovery.verdict import another_engine
from dieseltwin.recordings.dates import ORDER, Dated
from tests.discovery.toy import SETTINGS, Toy


class _Two(Toy):
    """A toy that stands for two recordings, each a toy of its own."""

    def __init__(self, parts: list[Toy]) -> None:
        super().__init__()
        self.factors: dict[str, np.ndarray] = {}
        self.profiles: dict[str, np.ndarray] = {}
        self.parts = parts
        self.rows = [slice(0, parts[0].time_s.size), slice(parts[0].time_s.size, self.time_s.size)]


def _recorded(seed: int, gain: float = 1.0, leak: float = 0.0, bent: float = 0.0) -> Toy:
    """A recording of the toy; `bent`: by how much its first reading isn't what any effect makes of it."""
    twin = Toy(600, 6, seed)
    lanes = Lanes(np.array([[gain]]), twin.first_local()[None] + 1.0, {"leak": np.array([leak])})
    clean = twin.simulate(lanes)[0]
    clean[:, 0] += bent * np.sin(3.0 * clean[:, 0])
    twin.measured = clean + 0.01 * np.random.default_rng(seed).standard_normal(clean.shape)
    return twin


@pytest.mark.parametrize("second, strange", [
    ({}, False), ({"gain": 1.2}, False), ({"leak": 0.05}, False), ({"bent": 0.05}, True),
])  # fmt: skip
def test_a_recording_that_nothing_explains_is_named(second: dict[str, float], strange: bool, monkeypatch):
    """Neither health that has moved nor a fault makes a recording one of another engine."""
    found = SimpleNamespace(twin=_Two([_recorded(1), _recorded(2, **second)]), settings=SETTINGS)
    left = alone.left_alone(found, 1.2)
    assert left[0] < 1.2 and (left[1] > 1.2) == strange
    days = [Dated(SimpleNamespace(path=None), None, ORDER)] * 2
    monkeypatch.setattr(Dated, "day", property(lambda _: "recording x"))
    notes = another_engine.of_another_engine(found, days)
    assert bool(notes) == strange
    if strange:
        assert "recording x" in notes[0] and notes[0].code == "wrong_engine"


def test_one_recording_is_like_itself():
    found = SimpleNamespace(twin=_recorded(1), settings=SETTINGS)
    assert not alone.left_alone(found, 1.2).size
