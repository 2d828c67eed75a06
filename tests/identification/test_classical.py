"""Classical estimator: it finds what was planted, and says when it can't."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import cramer_rao
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem

Make = Callable[..., SegmentProblem]
Drive = Callable[..., Inputs]

factors = st.tuples(st.floats(0.75, 1.25), st.floats(0.75, 1.25), st.floats(0.92, 1.08), st.floats(0.75, 1.25))


@settings(max_examples=2, deadline=None, derandomize=True)
@given(factors)
def test_planted_parameters_are_recovered_from_clean_readings(
    simulated: Make, drive: Drive, factor: tuple[float, ...]
) -> None:
    values = we2011.PARAMETERS.health() * np.array(factor)
    truth = we2011.PARAMETERS.replace(**dict(zip(HEALTH, values.tolist(), strict=True)))
    planted = simulated(drive(300, 101), truth, noise_seed=None)
    found = identify_segments([planted], "classical", 2, 0, config=PAPER)
    relative = cramer_rao([planted], values, planted.true_initial[:3])[0].relative
    assert found.segments[0].converged.all()
    # The tolerance of the iteration is a fiftieth of a standard deviation.
    assert (np.abs(found.segments[0].parameters / values - 1.0) < 0.1 * relative).all()


def test_noisy_estimates_scatter_as_the_bound_says(simulated: Make, drive: Drive) -> None:
    clean = simulated(drive(600, 101), we2011.FIELD, noise_seed=None)
    noisy = clean.with_noise_draws(60, np.random.default_rng(4))
    found = identify_segments([noisy], "classical", 60, 1, config=PAPER).segments[0]
    truth = we2011.FIELD.health()
    relative = cramer_rao([clean], truth, clean.true_initial[:3])[0].relative
    error = np.log(found.parameters / truth)
    # 60 draws know a standard deviation to 9 %; three of those.
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)) / relative, 1.0, atol=0.3)
    covered = (found.interval_90[..., 0] < truth) & (truth < found.interval_90[..., 1])
    assert (covered.mean(axis=0) > 0.75).all()
    assert np.mean(found.chi2_per_sample) == pytest.approx(1.0, abs=0.05)


def test_the_same_seed_gives_the_same_document(problem: SegmentProblem) -> None:
    first, second = (identify_segments([problem], "classical", 2, 5, config=PAPER) for _ in range(2))
    assert json.dumps(first.to_json()) == json.dumps(second.to_json())
    other = identify_segments([problem], "classical", 2, 6, config=PAPER)
    assert not np.array_equal(other.segments[0].parameters, first.segments[0].parameters)
    np.testing.assert_allclose(other.segments[0].parameters, first.segments[0].parameters, rtol=1e-3)


def test_a_time_shift_changes_nothing(simulated: Make, drive: Drive) -> None:
    here = simulated(drive(300, 101), we2011.FIELD)
    there = replace(here, inputs=drive(300, 101, shift_s=4096.0))
    one, two = (identify_segments([p], "classical", 1, 0, config=PAPER).segments[0] for p in (here, there))
    np.testing.assert_allclose(two.parameters, one.parameters, rtol=1e-6)


def test_short_gaps_are_masked_not_refused(problem: SegmentProblem) -> None:
    measured = problem.measured.copy()
    measured[40:50, 0] = np.nan
    measured[90:, 4] = np.nan
    found = identify_segments([replace(problem, measured=measured)], "classical", 1, 0, config=PAPER).segments[0]
    np.testing.assert_allclose(found.parameters[0], we2011.FIELD.health(), rtol=0.1)
    full = identify_segments([problem], "classical", 1, 0, config=PAPER).segments[0]
    assert (found.std[0] > full.std[0]).all()


def test_a_missing_sensor_costs_certainty_only(simulated: Make, drive: Drive) -> None:
    whole = simulated(drive(600, 151), we2011.FIELD)
    measured = whole.measured.copy()
    measured[:, 2] = np.nan  # no turbo speed
    blind, full = (
        identify_segments([p], "classical", 2, 0, config=PAPER).segments[0]
        for p in (replace(whole, measured=measured), whole)
    )
    assert blind.converged.all()
    error = np.abs(np.log(blind.centre / we2011.FIELD.health()))
    assert (error < 4.0 * blind.std[0] / blind.parameters[0]).all()
    assert (blind.std[0] > full.std[0]).all()


def test_idle_with_a_shut_valve_is_flagged(idle_problem: SegmentProblem) -> None:
    found = identify_segments([idle_problem], "classical", 2, 0, config=PAPER)
    area = HEALTH.index("A_egrmax")
    assert not found.segments[0].identifiable[area]
    assert found.pooled()["A_egrmax"].mean is None
    assert found.segments[0].identifiable[HEALTH.index("A_vgtmax")]


def test_an_estimate_far_off_does_not_vouch_for_itself(simulated: Make, drive: Drive) -> None:
    """Where the bound at the nominal values is above the mark, and that at the estimate isn't."""
    problem = simulated(drive(600, 11), we2011.FIELD.replace(h_tot=3.0 * we2011.FIELD.h_tot), noise_seed=None)
    (found,) = identify_segments([problem], "classical", 1, 0, config=PAPER).segments
    own = cramer_rao([problem], found.centre, found.states[0, :3])[0]
    assert (own.relative < PAPER.identifiable_bound_rel).all()
    assert found.identifiable.tolist() == [True, True, True, False]


def test_the_mark_of_the_settings_decides(problem: SegmentProblem) -> None:
    strict = PAPER.model_copy(update={"identifiable_bound_rel": 0.01})
    (found,) = identify_segments([problem], "classical", 1, 0, config=strict).segments
    relative = found.bound / found.centre
    assert found.identifiable.any() and not found.identifiable.all()
    np.testing.assert_array_equal(found.identifiable, relative <= 0.01)


def test_an_unconverged_run_is_reported_not_dropped(problem: SegmentProblem) -> None:
    short = PAPER.changed("classical", iterations_max=1)
    found = identify_segments([problem], "classical", 3, 0, config=short).segments[0]
    assert not found.converged.any()
    assert found.parameters.shape == (3, 4)


def test_segments_of_different_sampling_are_estimated_together(
    simulated: Make, drive: Drive, problem: SegmentProblem
) -> None:
    shorter = simulated(drive(900, 101), we2011.FIELD)
    both = identify_segments([problem, shorter], "classical", 1, 0, config=PAPER)
    assert [len(s.time_s) for s in both.segments] == [151, 101]
    for segment in both.segments:
        np.testing.assert_allclose(segment.parameters[0], we2011.FIELD.health(), rtol=0.15)


@pytest.mark.parametrize(("method", "runs"), [("clasical", 1), ("classical", 0)])
def test_bad_requests_are_refused(problem: SegmentProblem, method: str, runs: int) -> None:
    with pytest.raises(InputError):
        identify_segments([problem], method, runs, 0, config=PAPER)
    with pytest.raises(InputError):
        identify_segments([], "classical", 1, 0, config=PAPER)
