"""Levenberg-Marquardt against problems with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dieseltwin.least_squares import (
    Box,
    Linearisation,
    Problems,
    covariance,
    keep_better,
    levenberg_marquardt,
)


def rosenbrock(index: NDArray, x: NDArray, renew: NDArray) -> Linearisation:
    """Residuals 10 (x_1 - x_0^2), 1 - x_0; minimum 0 at (1, 1)."""
    residual = np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=1)
    jacobian = np.zeros((len(x), 2, 2))
    jacobian[:, 0, 0], jacobian[:, 0, 1] = -20.0 * x[:, 0], -1.0
    jacobian[:, 1, 0] = 10.0
    gradient = np.einsum("lkn,ln->lk", jacobian, residual)
    return Linearisation(0.5 * (residual**2).sum(axis=1), gradient, jacobian @ jacobian.transpose(0, 2, 1))


WIDE = Box(np.full(2, -10.0), np.full(2, 10.0), np.full(2, 2.0))


def test_every_problem_of_a_batch_reaches_its_minimum() -> None:
    start = np.random.default_rng(3).uniform(-2.0, 2.0, (40, 2))
    fit = levenberg_marquardt(Problems(rosenbrock), start, WIDE, tolerance=1e-6, iterations_max=200)
    assert fit.converged.all()
    np.testing.assert_allclose(fit.unknowns, 1.0, atol=1e-5)


def test_an_unfinished_problem_says_so() -> None:
    fit = levenberg_marquardt(Problems(rosenbrock), np.array([[-1.2, 1.0]]), WIDE, tolerance=1e-6, iterations_max=2)
    assert not fit.converged[0]
    assert fit.iterations[0] == 3


def test_the_box_holds_and_a_pinned_unknown_stays() -> None:
    box = replace(WIDE, lower=np.array([-10.0, 0.25]), upper=np.array([10.0, 0.25]))
    fit = levenberg_marquardt(Problems(rosenbrock), np.array([[0.1, 0.25]]), box, tolerance=1e-8, iterations_max=100)
    assert fit.unknowns[0, 1] == 0.25
    # best x_0 on the line x_1 = 1/4: 200 x^3 - 49 x - 1 = 0
    assert 200.0 * fit.unknowns[0, 0] ** 3 - 49.0 * fit.unknowns[0, 0] - 1.0 == pytest.approx(0.0, abs=1e-4)


def test_a_failing_model_is_never_accepted() -> None:
    def fails_right(index: NDArray, x: NDArray, renew: NDArray) -> Linearisation:
        good = rosenbrock(index, x, renew)
        return Linearisation(np.where(x[:, 0] > 0.5, np.inf, good.cost), good.gradient, good.hessian)

    fit = levenberg_marquardt(Problems(fails_right), np.array([[0.0, 0.0]]), WIDE, tolerance=1e-6, iterations_max=60)
    assert fit.unknowns[0, 0] <= 0.5
    assert np.isfinite(fit.linear.cost[0])


def test_missing_information_gives_a_huge_variance_and_leaves_the_others_alone() -> None:
    hessian = np.diag([1e4, 0.0, 1e8])
    std = np.sqrt(np.diag(covariance(hessian)))
    np.testing.assert_allclose(std[[0, 2]], [1e-2, 1e-4], rtol=1e-6)
    assert std[1] > 100.0


def test_the_better_of_two_fits_is_kept() -> None:
    start = np.array([[-1.2, 1.0], [0.9, 0.9]])
    short = levenberg_marquardt(Problems(rosenbrock), start, WIDE, tolerance=1e-6, iterations_max=1)
    long = levenberg_marquardt(Problems(rosenbrock), start[:1], WIDE, tolerance=1e-6, iterations_max=100)
    both = keep_better(short, long, np.array([0]))
    np.testing.assert_array_equal(both.unknowns[0], long.unknowns[0])
    np.testing.assert_array_equal(both.unknowns[1], short.unknowns[1])
    assert both.iterations[0] == short.iterations[0] + long.iterations[0]
