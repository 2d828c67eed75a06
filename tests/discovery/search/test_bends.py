"""Where errors of maps don't act linearly: what that adds to the readings' covariance, and what is left out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance
from dieseltwin.discovery.search.bends import bent_windows
from dieseltwin.recordings.noise import Noise

ROWS, WINDOWS, SIGMA = 10, 4, 0.1
STARTS = np.arange(0, ROWS * WINDOWS, ROWS)


class Squared:
    """Readings of one channel: linear in a map's error but for the square of it, `curved` (W,) in each window."""

    def __init__(self, curved: list[float]) -> None:
        self.curved = np.repeat(curved, ROWS)
        self.starts, self.state_scales = STARTS, np.ones(1)
        self.points = (SimpleNamespace(name="map"),)
        self.measured = np.zeros((ROWS * WINDOWS, 1))
        self.time_s = np.arange(ROWS * WINDOWS, dtype=np.float64)

    def simulate(self, lanes: dict[str, np.ndarray]) -> np.ndarray:
        error = lanes["map"]
        return np.asarray((error + self.curved * error**2)[None, :, None])


def judged(curved: list[float]) -> tuple[np.ndarray, tuple[tuple[int, np.ndarray], ...]]:
    twin = Squared(curved)
    rows = len(twin.time_s)
    fit = SimpleNamespace(lanes=lambda signals: signals)
    at: Any = SimpleNamespace(
        twin=twin, fit=fit, simulated=np.zeros((rows, 1)), local_response=np.full((1, rows, 1), 1e-9)
    )
    whitening = Whitening.of(np.zeros((rows, 1)), Noise(np.array([SIGMA]), np.zeros(1)), STARTS)
    nuisance = Nuisance("error", point=0, signal=np.ones(rows))
    return bent_windows(at, whitening, [nuisance], np.ones((1, rows, 1)), 0)


def test_a_linear_machine_has_none() -> None:
    left_out, bent = judged([0.0, 0.0, 0.0, 0.0])
    assert not left_out.any() and bent == ()


def test_a_window_that_bends_scatters_by_it_and_one_that_goes_elsewhere_is_left_out() -> None:
    left_out, bent = judged([0.0, 0.03, 1e-4, 1.0])
    assert left_out.tolist() == [False, False, False, True]
    ((window, covariance),) = bent
    # E[(c z^2)^2] = 3 c^2 in all rows alike; sixteen draws know a fourth moment to a factor
    assert window == 1 and covariance == pytest.approx(np.full((ROWS, ROWS), covariance[0, 0]))
    assert 0.2 < covariance[0, 0] / (3.0 * 0.03**2) < 5.0


def test_at_most_a_third_is_left_out_and_the_others_scatter() -> None:
    left_out, bent = judged([2.0, 1.5, 1.0, 1e-5])
    assert np.count_nonzero(left_out) == 1 and [window for window, _ in bent] == [1, 2]


def test_a_simulation_that_comes_to_nothing_is_left_out() -> None:
    left_out, _ = judged([0.0, 0.0, 0.0, float("nan")])
    assert left_out.tolist() == [False, False, False, True]


def test_readings_of_a_bent_window_count_by_their_covariance() -> None:
    rng = np.random.default_rng(5)
    direction = rng.normal(size=ROWS)
    covariance = np.outer(direction, direction)
    measured = np.zeros((ROWS * WINDOWS, 1))
    noise = Noise(np.array([SIGMA]), np.zeros(1))
    bent = Whitening.of(measured, noise, STARTS, ModelScatter(bent=((2, covariance),)))
    values = rng.normal(size=(1, ROWS * WINDOWS, 1))
    whitened = bent.apply(values)[0].reshape(WINDOWS, ROWS)
    for window, found in enumerate(whitened):
        own = values[0, ROWS * window : ROWS * (window + 1), 0]
        total = SIGMA**2 * np.eye(ROWS) + (covariance if window == 2 else 0.0)
        assert found @ found == pytest.approx(own @ np.linalg.solve(total, own))
    both = ModelScatter(windows=(covariance,) * WINDOWS, bent=((1, covariance),)).by_window()
    assert both[1] == pytest.approx(2.0 * covariance) and both[0] == pytest.approx(covariance)
