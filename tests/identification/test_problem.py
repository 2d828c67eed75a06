"""Problems: noise levels, first states, masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.engine import MEASURED, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.problem import (
    NOISE_FLOOR,
    PAPER_NOISE,
    NoiseLevels,
    SegmentProblem,
    problem_from_segment,
)


def test_noise_is_a_share_of_the_mean_of_the_whole_recording() -> None:
    signals = np.tile([2e5, 2.5e5, 6000.0, 0.03, 600.0, 0.2], (50, 1))
    signals[:25] *= 2.0
    signals[3, 1] = np.nan
    levels = NoiseLevels.from_signals(signals)
    expected = np.nanmean(signals, axis=0) * np.array(PAPER_NOISE)
    np.testing.assert_allclose(levels.sigma, expected)


def test_a_vanishing_flow_keeps_the_noise_floor() -> None:
    signals = np.tile([2e5, 2.5e5, 6000.0, 1e-6, 600.0, np.nan], (10, 1))
    sigma = NoiseLevels.from_signals(signals).sigma
    assert sigma[3] == NOISE_FLOOR[3]
    assert sigma[5] == NOISE_FLOOR[5]


def test_first_states_average_the_first_readings_that_exist(problem: SegmentProblem) -> None:
    measured = problem.measured.copy()
    measured[:2, 0] = np.nan
    first = replace(problem, measured=measured).first_states()
    assert first[0] == pytest.approx(measured[2:5, 0].mean())
    assert first[1] == pytest.approx(measured[:3, 1].mean())


def test_a_state_without_any_reading_is_refused_by_name(problem: SegmentProblem) -> None:
    measured = problem.measured.copy()
    measured[:, 2] = np.nan
    blind = replace(problem, measured=measured)
    with pytest.raises(InputError, match="omega_t_rad_s"):
        blind.first_states()
    first = blind.first_states(absent=np.array([1e5, 1e5, 4321.0]))
    assert first[2] == 4321.0
    assert first[0] == pytest.approx(measured[:3, 0].mean())


def test_shapes_are_checked(problem: SegmentProblem) -> None:
    with pytest.raises(InputError, match="measured channels"):
        replace(problem, measured=problem.measured[:-1])
    with pytest.raises(InputError, match="noise levels"):
        replace(problem, sigma=np.zeros(6))


def test_noise_draws_are_independent_and_keep_the_mask(problem: SegmentProblem) -> None:
    noisy = problem.with_noise_draws(40, np.random.default_rng(1))
    readings = noisy.readings(80)
    np.testing.assert_array_equal(readings[3], readings[43])
    np.testing.assert_array_equal(np.isnan(readings[7]), np.isnan(problem.measured))
    spread = np.std((readings[:40] - problem.measured)[..., :5], axis=(0, 1))
    np.testing.assert_allclose(spread, problem.sigma[:5], rtol=0.05)


def test_channels_are_chosen_by_name(problem: SegmentProblem) -> None:
    class Cut:
        t0_s, t1_s, inputs, measured = 0.0, 30.0, problem.inputs, problem.measured

    noise = NoiseLevels(problem.sigma)
    chosen = problem_from_segment(Cut, we2011.PARAMETERS, noise, channels=MEASURED[:3])
    assert np.isnan(chosen.measured[:, 3:]).all()
    assert np.isfinite(chosen.measured[:, :3]).all()
    with pytest.raises(InputError, match="w_x"):
        problem_from_segment(Cut, we2011.PARAMETERS, noise, channels=["w_x"])
