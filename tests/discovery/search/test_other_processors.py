"""An eigenvector's sign is any, and another processor gives another one: no verdict may follow it."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.likelihood import learned
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import tolerance_modes
from dieseltwin.discovery.likelihood.score import chance
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.learning.belief import Belief, prior_belief
from dieseltwin.recordings.noise import Noise


@pytest.fixture
def other_signs(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Call it, and `eigh` gives every second eigenvector with the other sign."""
    eigh = np.linalg.eigh

    def turned(matrix: np.ndarray) -> Any:
        values, vectors = eigh(matrix)
        return values, vectors * np.where(np.arange(values.size) % 2, -1.0, 1.0)

    return lambda: monkeypatch.setattr(np.linalg, "eigh", turned)


def test_modes_of_the_maps_tolerances_are_the_same(other_signs: Callable[[], None]) -> None:
    rng = np.random.default_rng(3)
    arguments = [np.cumsum(rng.normal(size=500)), rng.uniform(size=500)]
    modes = tolerance_modes(arguments)
    other_signs()
    np.testing.assert_allclose(tolerance_modes(arguments), modes, rtol=0.0, atol=1e-12)
    assert len(modes) > 5 and np.ptp(modes) > 1.0


def test_what_chance_reaches_is_the_same(other_signs: Callable[[], None]) -> None:
    vectors = np.random.default_rng(4).normal(size=(6, 40))
    scored = [SimpleNamespace(name=f"effect_{k}", projected=vector) for k, vector in enumerate(vectors)]
    limits = SimpleNamespace(limits=(-1.0, 1.0), sign=0.0)
    at = SimpleNamespace(twin=SimpleNamespace(hypotheses={item.name: limits for item in scored}))
    largest = chance(at, scored, 0).draws  # type: ignore[arg-type]
    other_signs()
    np.testing.assert_allclose(chance(at, scored, 0).draws, largest, rtol=1e-9)  # type: ignore[arg-type]
    assert np.median(largest) > 1.0


def test_what_is_still_open_of_a_learned_engine_is_the_same(
    other_signs: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(7)
    prior = prior_belief(we2011.PARAMETERS, 0.03)
    told = rng.normal(size=(40, prior.mean.size)) / np.sqrt(np.diag(prior.covariance))
    covariance = np.linalg.inv(np.linalg.inv(prior.covariance) + told.T @ told)
    channels = len(MEASURED)
    simulated = rng.uniform(0.5, 1.5, size=(60, channels))
    columns = rng.normal(size=(np.count_nonzero(prior.free), *simulated.shape))
    monkeypatch.setattr(learned, "map_columns", lambda *_: columns)
    twin: Any = SimpleNamespace(channels=MEASURED, starts=np.array([0]), time_s=np.arange(60.0))
    whitening = Whitening.of(simulated, Noise(np.full(channels, 0.01), np.zeros(channels)), twin.starts)

    def directions() -> np.ndarray:
        lanes: Any = None
        found = learned.learned_nuisances(twin, Belief(prior.mean, covariance), lanes, simulated, whitening)
        return np.stack([nuisance.response for nuisance in found])  # type: ignore[misc]

    before = directions()
    other_signs()
    np.testing.assert_allclose(directions(), before, rtol=0.0, atol=1e-8 * np.abs(before).max())
    assert len(before) > 10
