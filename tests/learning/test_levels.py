"""A health parameter and the level of its map are one product: what may be said of either."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.reference.evidence import Evidence, combined
from dieseltwin.engine import we2011
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, look_up
from dieseltwin.learning.belief import MAPS_AT, prior_belief
from dieseltwin.learning.levels import without_shape

RMS = 0.02


def test_the_shape_of_a_map_says_nothing_of_the_health_that_it_is_one_product_with():
    """Readings of A_vgtmax times the turbine's flow map, to 0.1 % everywhere along a driving, and of nothing else."""
    rng = np.random.default_rng(2)
    prior = prior_belief(we2011.PARAMETERS, RMS)
    functions, m = basis(), CORRECTED_POINTS.index("W_t")
    at = np.flatnonzero(functions.maps == m)
    along = look_up(functions.tables[at], m, rng.uniform(30.0, 90.0, 400), rng.uniform(0.4, 0.95, 400))
    response = np.zeros((400, prior.mean.size))
    response[:, MAPS_AT.start + at] = along.T
    area = prior.health[1]
    response[:, 1] = 1.0 / area
    information = response.T @ response / 1e-3**2
    belief = combined(prior, [Evidence(information, information @ prior.mean, 1.0, 400.0, np.inf)])
    believed = RMS * np.linalg.norm(along.mean(axis=1))  # of the mean of the map's error, before any reading
    by_shape = np.sqrt(belief.covariance[1, 1]) / area
    said = np.sqrt(np.diag(without_shape(belief, prior, {"W_t": along}))) / prior.health
    assert by_shape < 0.8 * believed
    assert said[1] == pytest.approx(believed, rel=0.05)
    assert said[[0, 2, 3]] == pytest.approx(np.sqrt(np.diag(prior.covariance))[[0, 2, 3]] / prior.health[[0, 2, 3]])


def test_what_readings_tell_of_health_alone_stays():
    prior = prior_belief(we2011.PARAMETERS, RMS)
    information = np.zeros_like(prior.covariance)
    information[3, 3] = (0.01 * prior.health[3]) ** -2
    belief = combined(prior, [Evidence(information, information @ prior.mean, 1.0, 1.0, np.inf)])
    along = np.ones((np.count_nonzero(basis().maps == CORRECTED_POINTS.index("f_egr")), 3))
    said = without_shape(belief, prior, {"f_egr": along})
    assert said[3, 3] == pytest.approx(belief.covariance[3, 3])
