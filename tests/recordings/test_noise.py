"""Noise that a message cuts off at its lowest number is told, and its mean is what readings have."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.recordings.noise import cut_off, estimate_noise

N = 3000
SIGMA = 5e-4
FLOW = np.maximum(0.02 * np.sin(0.2 * 0.2 * np.arange(N)), 0.0)  # kg/s at 5 Hz, the valve is shut half the time


@pytest.fixture(scope="module")
def noisy() -> np.ndarray:
    """The flow with noise, before a bus without negative numbers."""
    return FLOW + SIGMA * np.random.default_rng(3).standard_normal(N)


@pytest.mark.parametrize("step", [0.0, 1.4e-5, 2.5e-4])
def test_a_flow_without_negative_numbers_is_cut_off(noisy: np.ndarray, step: float) -> None:
    sent = np.maximum(np.rint(noisy / step) * step if step else noisy, 0.0)
    cut = cut_off(sent)
    assert cut is not None and cut.lowest == 0.0
    assert cut.sigma == pytest.approx(SIGMA, rel=0.15)
    assert cut.near[FLOW == 0.0].mean() > 0.97 and not cut.near[FLOW > 8.0 * SIGMA].any()
    assert estimate_noise(sent[:, None]).sigma[0] == pytest.approx(SIGMA, rel=0.15)
    shut = FLOW == 0.0
    assert sent[shut].mean() == pytest.approx(0.4 * SIGMA, rel=0.1)
    assert (sent - cut.expected(FLOW))[shut].mean() == pytest.approx(0.0, abs=0.07 * SIGMA)


def test_the_mean_of_cut_off_noise_is_that_of_draws(noisy: np.ndarray) -> None:
    cut = cut_off(np.maximum(noisy, 0.0))
    assert cut is not None
    levels = cut.sigma * np.array([-2.0, 0.0, 0.5, 2.0, 6.0])
    draws = levels + cut.sigma * np.random.default_rng(1).standard_normal((200_000, levels.size))
    np.testing.assert_allclose(cut.expected(levels), np.maximum(draws, 0.0).mean(axis=0), atol=0.01 * cut.sigma)


def test_noise_on_both_sides_or_none_at_all_is_not_cut_off(noisy: np.ndarray) -> None:
    assert cut_off(noisy) is None
    assert cut_off(np.rint(noisy / SIGMA) * SIGMA) is None
    assert cut_off(FLOW) is None
    assert cut_off(np.full(N, np.nan)) is None
