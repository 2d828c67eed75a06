"""Rougher maps than are believed: the readings of a reference say so, and what is learned of them holds elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.challenge import map_errors
from dieseltwin.discovery.reference.learn import Evidence, combined
from dieseltwin.discovery.reference.roughness import log_evidence, roughness_of
from dieseltwin.engine import we2011
from dieseltwin.engine.map_corrections import ARGUMENTS, CORRECTED_POINTS, RANGES, basis, look_up
from dieseltwin.learning.belief import HELD, MAPS_AT, Belief, prior_belief

RMS, NOISE = 0.02, 0.002
MAP = CORRECTED_POINTS.index("eta_c")


def _places(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the compressor is driven: flow and pressure ratio, in the middle three quarters of what it can reach."""
    rng = np.random.default_rng(seed)
    ends = [RANGES[name] for name in ARGUMENTS["eta_c"]]
    return tuple(low + (high - low) * rng.uniform(0.1, 0.85, count) for low, high in ends)  # type: ignore[return-value]


def _error(length: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A drawn error of the map whose correlation is a share of the range that is usually driven, (n,) [-]."""
    rng, low, high = np.random.default_rng(8), *np.transpose(map_errors.RANGES[MAP])
    waves, phases = rng.standard_normal((48, 2)) / length, rng.uniform(0.0, 2.0 * np.pi, 48)
    at = (np.stack([x, y], axis=1) - low) / (high - low)
    return RMS * np.sqrt(2.0 / 48.0) * np.cos(at @ waves.T + phases) @ rng.standard_normal(48)


def _read(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Information and vector of readings of the map's error, with noise."""
    x, y = _places(1500, 1)
    of_map = np.flatnonzero(basis().maps == MAP)
    rows = np.zeros((MAPS_AT.stop + 12, x.size))
    rows[MAPS_AT.start + of_map] = look_up(basis().tables[of_map], MAP, x, y)
    readings = _error(length, x, y) + NOISE * np.random.default_rng(2).standard_normal(x.size)
    return rows @ rows.T / NOISE**2, rows @ readings / NOISE**2


def _left(belief: Belief, length: float) -> float:
    """Root mean square of what was learned less the map's error, where no reading was [-]."""
    x, y = _places(400, 3)
    of_map = basis().maps == MAP
    learned = belief.coefficients[of_map] @ look_up(basis().tables[of_map], MAP, x, y)
    return float(np.sqrt(np.mean((learned - _error(length, x, y)) ** 2)))


@pytest.mark.parametrize("length, rough", [(1.0 / 3.0, False), (1.0 / 6.0, True)])
def test_readings_tell_how_rough_a_map_is(length: float, rough: bool):
    roughness = roughness_of(prior_belief(we2011.PARAMETERS, RMS), RMS, *_read(length))
    assert (roughness >= 0.3) if rough else (roughness == 0.0)


def test_a_rough_map_is_learned_where_it_is_believed_rough():
    length = 1.0 / 6.0
    information, vector = _read(length)
    left = {}
    for roughness in (0.0, 1.0):
        prior = prior_belief(we2011.PARAMETERS, RMS, roughness)
        evidence = Evidence(information, vector + information @ prior.mean, 1.0, 1500, 0.0)
        left[roughness] = _left(combined(prior, [evidence]), length)
    assert left[1.0] < 0.5 * left[0.0]
    assert left[1.0] < NOISE


def test_functions_of_smooth_maps_are_the_smooth_ones():
    smooth, rough = (prior_belief(we2011.PARAMETERS, RMS, roughness) for roughness in (0.0, 0.1))
    assert np.array_equal(smooth.free, ~basis().finer) and rough.free.all()
    assert np.sqrt(np.diag(smooth.covariance)[MAPS_AT][basis().finer]) == pytest.approx(HELD)
    assert smooth.factor.shape == (smooth.mean.size, np.count_nonzero(smooth.open))
    covariance = smooth.factor @ smooth.factor.T
    assert covariance[np.ix_(smooth.open, smooth.open)] == pytest.approx(
        smooth.covariance[np.ix_(smooth.open, smooth.open)]
    )


def test_evidence_is_that_of_gaussian_readings():
    rng = np.random.default_rng(4)
    rows, readings = rng.standard_normal((3, 5)), rng.standard_normal(5)
    wide, narrow = np.diag([4.0, 1.0, 9.0]), 0.1 * np.eye(3)

    def density(covariance: np.ndarray) -> float:
        of_readings = np.eye(5) + rows.T @ covariance @ rows
        return float(-0.5 * (readings @ np.linalg.solve(of_readings, readings) + np.linalg.slogdet(of_readings)[1]))

    found = [log_evidence(covariance, rows @ rows.T, rows @ readings) for covariance in (wide, narrow)]
    assert found[0] - found[1] == pytest.approx(density(wide) - density(narrow))
