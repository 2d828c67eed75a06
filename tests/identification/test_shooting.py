"""Lanes of the shooting: grouping, sensitivities, kept Jacobians, integration step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.engine import Inputs, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.shooting import STEP_S, Shooting, ShootingRuns, by_grid

ALL = np.array([True])


def truth_of(problem: SegmentProblem) -> np.ndarray:
    """(1, 7) logarithms of the true unknowns."""
    assert problem.true_initial is not None
    return np.log(np.concatenate([we2011.FIELD.health(), problem.true_initial[:3]]))[None]


def runs_of(problem: SegmentProblem, step_s: float = STEP_S) -> ShootingRuns:
    """One run of one segment."""
    return ShootingRuns(Shooting((problem,), step_s=step_s), np.zeros(1, dtype=int), problem.measured[None])


def test_gradient_is_the_slope_of_the_cost(problem: SegmentProblem) -> None:
    runs, x = runs_of(problem), truth_of(problem)
    x[0, :4] += [0.01, -0.005, 0.003, 0.02]
    linear = runs(np.zeros(1, dtype=int), x, ALL)
    for i in range(4):
        step = np.zeros(7)
        step[i] = 1e-5
        ends = [runs(np.zeros(1, dtype=int), x + sign * step, ~ALL).cost[0] for sign in (1.0, -1.0)]
        assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(linear.gradient[0, i], rel=1e-3, abs=0.5)


def test_a_kept_jacobian_keeps_the_hessian(problem: SegmentProblem) -> None:
    runs, x = runs_of(problem), truth_of(problem)
    first = runs(np.zeros(1, dtype=int), x, ALL)
    kept = runs(np.zeros(1, dtype=int), x + 1e-3, ~ALL)
    renewed = runs(np.zeros(1, dtype=int), x + 1e-3, ALL)
    np.testing.assert_array_equal(kept.hessian, first.hessian)
    assert kept.cost[0] == pytest.approx(renewed.cost[0], rel=1e-12)
    assert not np.array_equal(renewed.hessian, first.hessian)


def test_the_step_shifts_a_parameter_by_little_of_its_bound(simulated: Callable[..., SegmentProblem]) -> None:
    time = 0.2 * np.arange(101)
    inputs = Inputs(
        time,
        1300.0 + 150.0 * np.sin(0.5 * time),
        90.0 + 30.0 * np.sin(0.8 * time),
        30.0 + 10.0 * np.sin(time),
        45.0 + 10.0 * np.sin(0.6 * time),
    )
    clean = simulated(inputs, we2011.FIELD, noise_seed=None)
    x = truth_of(clean)
    exact = Shooting((clean,), step_s=0.002).simulate(np.zeros(1, dtype=int), x).measured[0]
    finer = replace(clean, measured=np.where(np.isfinite(clean.measured), exact, np.nan))
    linear = runs_of(finer)(np.zeros(1, dtype=int), x, ALL)
    shift = np.linalg.solve(linear.hessian[0], linear.gradient[0])
    std = np.sqrt(np.diag(np.linalg.inv(linear.hessian[0])))
    assert (np.abs(shift / std)[:4] < 0.01).all()


def test_segments_are_grouped_by_their_sample_times(problem: SegmentProblem) -> None:
    later = replace(problem, inputs=replace(problem.inputs, time_s=problem.inputs.time_s + 60.0))
    slower = replace(problem, inputs=replace(problem.inputs, time_s=problem.inputs.time_s * 1.5))
    assert by_grid([problem, slower, later]) == [[0, 2], [1]]
    with pytest.raises(InputError, match="one grid"):
        Shooting((problem, slower))


def test_a_covariance_without_information_has_a_root():
    """Rounding leaves tiny negative eigenvalues where nothing is told of a parameter: no traceback then."""
    from dieseltwin.identification.shooting import _root

    direction = np.linspace(1.0, 7.0, 7)
    nearly_singular = np.outer(direction, direction) - 1e-12 * np.eye(7)
    np.testing.assert_allclose(_root(nearly_singular) @ _root(nearly_singular).T, nearly_singular, atol=1e-9)
    whole = nearly_singular + np.eye(7)
    np.testing.assert_array_equal(_root(whole), np.linalg.cholesky(whole))  # as before where there is a root
