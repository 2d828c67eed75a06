"""Errors of maps beyond those believed of every engine: readings ask for them, and what is learned of them holds."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.challenge import map_errors
from dieseltwin.discovery.reference.evidence import Evidence, combined
from dieseltwin.discovery.reference.further import further_errors, log_evidence
from dieseltwin.engine import constants, we2011
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.map_corrections import (
    ARGUMENTS,
    CORRECTED_POINTS,
    CORRELATION_LENGTH,
    RANGES,
    basis,
    basis_along,
    look_up,
)
from dieseltwin.learning.belief import HELD, MAPS_AT, NOTHING_FURTHER, Belief, Further, prior_belief

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


def _no_effect() -> tuple[float, float]:
    return 0.0, 0.0


def _read(length: float, larger: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Information and vector of readings of the map's error, with noise; `larger`: times the usual error."""
    x, y = _places(1500, 1)
    of_map = np.flatnonzero(basis().maps == MAP)
    rows = np.zeros((MAPS_AT.stop + 12, x.size))
    rows[MAPS_AT.start + of_map] = look_up(basis().tables[of_map], MAP, x, y)
    readings = larger * _error(length, x, y) + NOISE * np.random.default_rng(2).standard_normal(x.size)
    return rows @ rows.T / NOISE**2, rows @ readings / NOISE**2


def _left(belief: Belief, length: float) -> float:
    """Root mean square of what was learned less the map's error, where no reading was [-]."""
    x, y = _places(400, 3)
    of_map = basis().maps == MAP
    learned = belief.coefficients[of_map] @ look_up(basis().tables[of_map], MAP, x, y)
    return float(np.sqrt(np.mean((learned - _error(length, x, y)) ** 2)))


@pytest.mark.parametrize("length, rough", [(1.0 / 3.0, False), (1.0 / 6.0, True)])
def test_readings_tell_how_rough_a_map_is(length: float, rough: bool):
    found = further_errors(prior_belief(we2011.PARAMETERS, RMS), RMS, *_read(length), _no_effect)
    assert (found.rough >= 0.3) if rough else (found == NOTHING_FURTHER)
    assert found.of_ratio == 0.0


@pytest.mark.parametrize("size", [0.0, 0.2, 1.0])
def test_maps_that_hardly_err_are_not_off_by_more_than_usual(size: float):
    """Exact ones were believed to be off by 1.5 times the usual over 1.5 times the length."""
    found = further_errors(prior_belief(we2011.PARAMETERS, RMS), RMS, *_read(1.0 / 3.0, size), _no_effect)
    assert found == NOTHING_FURTHER


@pytest.mark.parametrize("second, of_ratio", [("Pi_t", False), ("BSR", True)])
def test_readings_tell_whether_the_turbine_goes_with_its_blade_speed_ratio(second: str, of_ratio: bool):
    """Driving in which the exhaust is hotter and colder at equal speed and pressures."""
    rng = np.random.default_rng(5)
    at = {"omega_t": rng.uniform(2500.0, 9000.0, 1500), "Pi_t": rng.uniform(0.4, 0.9, 1500)}
    at["BSR"] = numpy_model().blade_speed_ratio(
        at["omega_t"], rng.uniform(500.0, 900.0, 1500), at["Pi_t"], constants(we2011.PARAMETERS)
    )
    of_map = np.flatnonzero(basis().maps == CORRECTED_POINTS.index("eta_tm"))
    which = np.isin(np.arange(len(basis().maps)), of_map)
    functions = np.zeros((MAPS_AT.stop + 12, 1500))
    along = {name: np.zeros(1500) for name in RANGES} | at
    functions[MAPS_AT.start + of_map] = basis_along(along, which)
    low, high = np.transpose([RANGES["omega_t"], RANGES[second]])
    places = (np.stack([at["omega_t"], at[second]], axis=1) - low) / (high - low)
    waves = rng.standard_normal((48, 2)) / CORRELATION_LENGTH
    error = RMS * np.sqrt(2.0 / 48.0) * np.cos(places @ waves.T + rng.uniform(0.0, 6.28, 48)) @ rng.standard_normal(48)
    readings = error + NOISE * rng.standard_normal(1500)
    read = functions @ functions.T / NOISE**2, functions @ readings / NOISE**2
    found = further_errors(prior_belief(we2011.PARAMETERS, RMS), RMS, *read, _no_effect)
    assert (found.of_ratio > 0.0) == of_ratio and found.rough == 0.0


def test_readings_tell_that_maps_are_off_by_more_than_is_believed():
    """Smooth and three times as large: no rough ones; as large by a fault that explains it better: none at all."""
    prior, read = prior_belief(we2011.PARAMETERS, RMS), _read(1.0 / 3.0, larger=3.0)
    found = further_errors(prior, RMS, *read, _no_effect)
    assert found.size == pytest.approx(3.0, abs=0.8) and found.rough == 0.0
    assert further_errors(prior, RMS, *read, lambda: (1e6, 0.0)).size == 1.0
    assert further_errors(prior, RMS, *read, lambda: (1e6, 1e6)) == NOTHING_FURTHER


@pytest.mark.parametrize("length", [1.0 / 3.0, 1.0 / 2.2])
def test_larger_errors_are_as_smooth_as_they_are(length: float):
    """Held to the usual length, longer ones would be small: 1.0 to 1.5 times, not three."""
    prior, read = prior_belief(we2011.PARAMETERS, RMS), _read(length, larger=3.0)
    found = further_errors(prior, RMS, *read, _no_effect)
    assert found.size > 2.0 and (found.smooth > 1.2) == (length > 0.4)
    believed = prior_belief(we2011.PARAMETERS, RMS, found).covariance[MAPS_AT, MAPS_AT]
    assert np.linalg.eigvalsh(believed).min() > 0.0
    tables = basis().tables[basis().usual & (basis().maps == MAP)]
    at = np.flatnonzero(basis().usual & (basis().maps == MAP))
    middle = tables[:, 20, 20]
    assert np.sqrt(middle @ believed[np.ix_(at, at)] @ middle) == pytest.approx(RMS * found.size, rel=0.02)


def test_larger_errors_are_believed_of_usual_functions_and_beside_rough_ones():
    usual, larger = (prior_belief(we2011.PARAMETERS, RMS, Further(1.0, 0.0, size)) for size in (1.0, 3.0))
    times = np.sqrt(np.diag(larger.covariance) / np.diag(usual.covariance))[MAPS_AT]
    assert np.allclose(times[usual.free], 3.0, rtol=1e-6) and np.array_equal(usual.free, larger.free)


def test_a_rough_map_is_learned_where_it_is_believed_rough():
    length = 1.0 / 6.0
    information, vector = _read(length)
    left = {}
    for roughness in (0.0, 1.0):
        prior = prior_belief(we2011.PARAMETERS, RMS, Further(roughness))
        evidence = Evidence(information, vector + information @ prior.mean, 1.0, 1500.0, np.inf)
        left[roughness] = _left(combined(prior, [evidence]), length)
    assert left[1.0] < 0.5 * left[0.0]
    assert left[1.0] < NOISE


def test_functions_of_smooth_maps_are_the_smooth_ones():
    beliefs = (NOTHING_FURTHER, Further(rough=0.1), Further(of_ratio=0.3))
    smooth, rough, of_ratio = (prior_belief(we2011.PARAMETERS, RMS, further) for further in beliefs)
    assert np.array_equal(smooth.free, basis().usual)
    assert np.array_equal(rough.free, ~basis().of_ratio) and np.array_equal(of_ratio.free, ~basis().finer)
    assert np.sqrt(np.diag(smooth.covariance)[MAPS_AT][~basis().usual]) == pytest.approx(HELD)
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
