"""Engines of one type: what some were learned from sharpens what is believed of the next."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.engine import we2011
from dieseltwin.engine.map_corrections import basis
from dieseltwin.learning.belief import HEALTH_AT, MAPS_AT, Belief, prior_belief
from dieseltwin.learning.siblings import belief_from_siblings

MAP_RMS, TYPE_SHARE, COUNT = 0.02, 0.8, MAPS_AT.stop - MAPS_AT.start
ENGINE = we2011.PARAMETERS


def _fleet(number: int, seed: int) -> tuple[list[np.ndarray], list[tuple[Belief, Belief]]]:
    """True corrections (K,) of some engines of a type, and what was learned of each along half of the directions."""
    rng = np.random.default_rng(seed)
    prior = prior_belief(ENGINE, MAP_RMS)
    spread = np.sqrt(np.diag(prior.covariance)[MAPS_AT])
    of_type = np.sqrt(TYPE_SHARE) * spread * rng.standard_normal(COUNT)
    true, learned = [], []
    for _ in range(number):
        own = of_type + np.sqrt(1.0 - TYPE_SHARE) * spread * rng.standard_normal(COUNT)
        seen = np.linalg.qr(rng.standard_normal((COUNT, COUNT)))[0][: COUNT // 2]  # each drove elsewhere
        noise = 0.1 * MAP_RMS
        readings = seen @ own + noise * rng.standard_normal(len(seen))
        information = np.linalg.inv(prior.covariance)
        information[MAPS_AT, MAPS_AT] += seen.T @ seen / noise**2
        vector = np.linalg.solve(prior.covariance, prior.mean)
        vector[MAPS_AT] += seen.T @ readings / noise**2
        covariance = np.linalg.inv(information)
        true.append(own)
        learned.append((prior, Belief(covariance @ vector, covariance)))
    return true, learned


def test_twenty_engines_tell_the_maps_of_the_next():
    true, learned = _fleet(21, 3)
    found = belief_from_siblings(learned[:20], ENGINE, MAP_RMS, TYPE_SHARE)
    error = found.coefficients - true[20]
    covariance = found.covariance[MAPS_AT, MAPS_AT]
    own = np.sqrt(1.0 - TYPE_SHARE) * MAP_RMS
    smooth = ~basis().finer
    assert np.sqrt(np.mean(error[smooth] ** 2)) < 1.3 * own < 0.7 * np.sqrt(np.mean(true[20][smooth] ** 2))
    assert 0.7 < error @ np.linalg.solve(covariance, error) / COUNT < 1.3  # as large as is stated


def test_health_and_sensors_are_each_engines_own():
    found, usual = belief_from_siblings(_fleet(4, 1)[1], ENGINE, MAP_RMS, TYPE_SHARE), prior_belief(ENGINE, MAP_RMS)
    assert np.array_equal(found.health, usual.health) and np.array_equal(found.gains, usual.gains)
    assert np.array_equal(found.covariance[HEALTH_AT], usual.covariance[HEALTH_AT])


def test_an_engine_that_nothing_was_learned_of_says_nothing():
    prior = prior_belief(ENGINE, MAP_RMS)
    found = belief_from_siblings([(prior, prior)], ENGINE, MAP_RMS, TYPE_SHARE)
    assert found.covariance == pytest.approx(prior.covariance, abs=1e-12)
    assert found.mean == pytest.approx(prior.mean)


def test_without_anything_in_common_siblings_say_nothing():
    found = belief_from_siblings(_fleet(5, 2)[1], ENGINE, MAP_RMS, type_share=0.0)
    assert np.abs(found.coefficients).max() < 1e-6
