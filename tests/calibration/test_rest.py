"""Corrections by where the machine comes to rest: what balances leave there counts by what it does to the states."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.calibration.lasting_errors import corrections_left
from dieseltwin.calibration.rest import Rest, nearest_rest, rest_of
from dieseltwin.calibration.steady_model import ROWS, SteadyModel
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import CorrectionTerm
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.steady_points import STATES, SteadyPoints
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import TRUTH, made_points, settle

VALUES = {"h_tot": TRUTH.h_tot}
USUAL = basis().usual


def off(model: SteadyModel, points: SteadyPoints) -> np.ndarray:
    """Logarithm of where the balances are solved over the readings, (n, 6)."""
    return np.log(settle(model, points, VALUES, points.states()) / points.states())


def corrected(coefficients: np.ndarray) -> SteadyModel:
    return SteadyModel(TRUTH.replace(terms=(CorrectionTerm(coefficients=tuple(coefficients)),)))


@pytest.fixture(scope="module")
def points() -> SteadyPoints:
    """Of an engine whose maps are 1 % off."""
    drawn = 0.01 * np.random.default_rng(4).standard_normal(USUAL.size) * USUAL
    return made_points(TRUTH.replace(terms=(CorrectionTerm(coefficients=tuple(drawn)),)), 60, 0.001)


def test_the_rest_is_where_the_balances_are_solved(points: SteadyPoints) -> None:
    rest, solved = rest_of(points, SteadyModel(TRUTH), VALUES, USUAL), off(SteadyModel(TRUTH), points)
    assert rest.off.shape == (60, len(STATES)) and rest.along.shape == (60, len(STATES), int(USUAL.sum()))
    near = np.max(np.abs(solved), axis=1) < 0.1
    assert near.sum() > 40 and rest.read.all()
    change = 0.003 * np.random.default_rng(5).standard_normal(int(USUAL.sum()))
    moved = np.zeros(USUAL.size)
    moved[USUAL] = change
    by_change = off(corrected(moved), points) - solved
    for told, true in ((rest.off, solved), (rest.along @ change, by_change)):
        apart = np.median(np.abs(told - true)[near], axis=0)
        assert np.all(apart < 0.2 * np.median(np.abs(true[near]), axis=0)), apart


def test_corrections_bring_the_rest_to_points_that_were_not_asked(points: SteadyPoints) -> None:
    asked, others = points.take(np.arange(60) < 40), points.take(np.arange(60) >= 40)
    found = corrections_left(asked, SteadyModel(TRUTH), VALUES, default_search().points, dict.fromkeys(ROWS, 0.02))
    before, after = (np.sqrt(np.mean(off(m, others) ** 2, axis=0)) for m in (SteadyModel(TRUTH), corrected(found)))
    assert np.all(after[:4] < 0.5 * before[:4]), (before, after)


def test_a_reading_that_is_missing_and_points_that_lie_far_off_set_nothing(points: SteadyPoints) -> None:
    column = points["w_egr_kg_s"].copy()
    column[:5] = np.nan
    rest = rest_of(points.with_columns(w_egr_kg_s=column), SteadyModel(TRUTH), VALUES, USUAL)
    assert not rest.read[:5, STATES.index("w_egr_kg_s")].any() and rest.read[5:].all()
    assert np.isfinite(rest.off).all() and np.isfinite(rest.along).all()

    rng = np.random.default_rng(1)
    along, true = rng.standard_normal((80, 6, 2)), np.array([0.01, -0.02])
    shifted = -along @ true
    shifted[:4] += 1.0
    usual = np.tile([SETTLED_NOISE[name] for name in STATES], (80, 1))
    made = Rest(shifted, along, np.ones((80, 6), dtype=bool), usual)
    np.testing.assert_allclose(nearest_rest(made, np.full(2, 0.03)), true, atol=1.5e-3)
