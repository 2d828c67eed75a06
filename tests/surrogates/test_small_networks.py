"""Cells, Levenberg-Marquardt on small networks, and the search for a jump in the labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.errors import DieselTwinError
from dieseltwin.surrogates.small_networks import (
    Labels,
    Structure,
    evaluate,
    evaluate_with_jacobian,
    fit_networks,
    make_cells,
    masked_parameters,
    n_parameters,
    start,
    tanh,
    unpack,
)
from dieseltwin.surrogates.speed_jump import find_jump

WIDTHS = (2, 6, 1)


def identity(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return z, np.ones_like(z)


def test_cells_are_small_complete_and_narrow():
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (5000, 2))
    cells = make_cells(x, 40)
    assert cells.count.sum() == 5000
    assert cells.count.max() <= 40
    centre = cells.mean(x[:, 0])
    assert np.abs(x[:, 0] - centre[cells.of_row]).max() < 0.3
    assert (cells.count @ centre) / 5000 == pytest.approx(x[:, 0].mean())


@pytest.mark.parametrize("widths", [(2, 6, 1), (3, 5, 4, 1)])
def test_jacobian_matches_differences(widths):
    rng = np.random.default_rng(2)
    x = rng.normal(size=(widths[0], 11))
    p = rng.normal(size=(3, n_parameters(widths)))
    z, jacobian = evaluate_with_jacobian(p, widths, x)
    assert np.array_equal(z, evaluate(p, widths, x))
    for column in range(p.shape[1]):
        step = np.zeros_like(p)
        step[:, column] = 1e-6
        difference = (evaluate(p + step, widths, x) - evaluate(p - step, widths, x)) / 2e-6
        assert jacobian[:, column] == pytest.approx(difference, rel=1e-5, abs=1e-8)


def test_masked_rows_are_networks_without_the_neuron():
    widths, rng = (2, 4, 3, 1), np.random.default_rng(6)
    x, p = rng.normal(size=(2, 10)), rng.normal(size=(2, n_parameters((2, 4, 3, 1))))
    masks = [np.array([1.0, 0.0, 1.0, 1.0]), np.array([1.0, 1.0, 0.0])]
    masked = [(slice(0, 6), np.ones(p.shape[1])), (slice(6, 10), masked_parameters(widths, masks))]
    found, jacobian = evaluate_with_jacobian(p, widths, x, tanh, masked)

    (w1, b1), (w2, b2), (w3, b3) = unpack(p, widths)
    one = np.tanh(w1 @ x[None] + b1)
    whole = w3 @ np.tanh(w2 @ one + b2) + b3
    less = w3 @ (np.tanh(w2 @ (one * masks[0][:, None]) + b2) * masks[1][:, None]) + b3
    assert found[:, :6] == pytest.approx(whole[:, 0, :6], rel=1e-12)
    assert found[:, 6:] == pytest.approx(less[:, 0, 6:], rel=1e-12)
    assert not np.allclose(less[:, 0, 6:], whole[:, 0, 6:])
    for column in range(p.shape[1]):
        step = np.zeros_like(p)
        step[:, column] = 1e-6
        difference = (evaluate(p + step, widths, x, tanh, masked) - evaluate(p - step, widths, x, tanh, masked)) / 2e-6
        assert jacobian[:, column] == pytest.approx(difference, rel=1e-5, abs=1e-8)


def test_levenberg_marquardt_finds_a_network_of_its_own_kind():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1.0, 1.0, (2, 400))
    truth = rng.normal(size=(1, n_parameters((2, 2, 1))))
    label = evaluate(truth, (2, 2, 1), x)
    begin = start(WIDTHS, x, 4, 1.0, 0.0, rng)
    fit = fit_networks(begin, Structure(WIDTHS), Labels(x, label, np.full(400, 1e8), identity), steps=200, ridge=1e-12)
    error = evaluate(fit.unknowns, WIDTHS, x) - label
    assert np.sqrt(np.mean(error**2, axis=1)).min() < 1e-4 * np.std(label)


def test_members_of_a_batch_do_not_touch_each_other():
    rng = np.random.default_rng(4)
    x, label = rng.uniform(-1.0, 1.0, (2, 100)), rng.normal(size=(3, 100))
    begin = start(WIDTHS, x, 3, 1.0, 0.0, rng)
    labels = Labels(x, label, np.ones(100), identity)
    options = {"steps": 8, "ridge": 1e-6}
    together = fit_networks(begin, Structure(WIDTHS), labels, **options)
    alone = fit_networks(begin[1:2], Structure(WIDTHS), replace(labels, y=label[1:2]), **options)
    assert together.unknowns[1] == pytest.approx(alone.unknowns[0], rel=1e-6, abs=1e-8)


def test_a_start_without_cost_is_refused():
    begin = np.full((1, n_parameters(WIDTHS)), np.nan)
    labels = Labels(np.zeros((2, 5)), np.zeros((1, 5)), np.ones(5), identity)
    with pytest.raises(DieselTwinError, match="scale the inputs"):
        fit_networks(begin, Structure(WIDTHS), labels, steps=2, ridge=0.0)


def planted(n: int, low: float, high: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    speed = np.exp(rng.uniform(np.log(1500.0), np.log(9000.0), n))
    ratio = rng.uniform(0.3, 1.0, n)
    jump = np.clip((speed - low) / (high - low), 0.0, 1.0)
    return speed, ratio, 0.8 - 1.4 * jump * (ratio - 0.95) ** 2 + 0.02 * rng.standard_normal(n)


def test_a_planted_jump_is_found():
    found = find_jump(*planted(200_000, 3100.0, 3150.0, 1))
    assert found is not None
    assert found[0] == pytest.approx(3100.0, abs=6.0)
    assert found[1] == pytest.approx(3150.0, abs=6.0)


def test_no_jump_is_claimed_in_smooth_labels():
    assert find_jump(*planted(50_000, 1500.0, 9000.0, 1)) is None
