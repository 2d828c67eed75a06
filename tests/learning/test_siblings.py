"""Engines of one type: what some were learned from sharpens what is believed of the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.engine import constants, we2011
from dieseltwin.engine.binding import numpy_model
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, NODES, RANGES, basis
from dieseltwin.learning.belief import HEALTH_AT, MAPS_AT, Belief, prior_belief
from dieseltwin.learning.siblings import Sibling, belief_from_siblings
from dieseltwin.learning.weather import UNDECIDED, Exponent
from dieseltwin.settings.defaults import default_search

MAP_RMS, TYPE_SHARE, COUNT = 0.02, 0.8, MAPS_AT.stop - MAPS_AT.start
ENGINE = we2011.PARAMETERS.replace(k_cflow=UNDECIDED, k_cspeed=UNDECIDED)
BELIEFS = default_search().circumstances
FLOW = Exponent(1.02, 0.05)


def _fleet(number: int, seed: int) -> tuple[list[np.ndarray], list[Sibling]]:
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
        learned.append(Sibling(prior, Belief(covariance @ vector, covariance), ENGINE, MAP_RMS))
    return true, learned


def test_twenty_engines_tell_the_maps_of_the_next():
    true, learned = _fleet(21, 3)
    found, told = belief_from_siblings(learned[:20], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    assert told.exponents == {}  # all in one weather
    error = found.coefficients - true[20]
    covariance = found.covariance[MAPS_AT, MAPS_AT]
    own = np.sqrt(1.0 - TYPE_SHARE) * MAP_RMS
    smooth = ~basis().finer
    assert np.sqrt(np.mean(error[smooth] ** 2)) < 1.3 * own < 0.7 * np.sqrt(np.mean(true[20][smooth] ** 2))
    assert 0.7 < error @ np.linalg.solve(covariance, error) / COUNT < 1.3  # as large as is stated


def test_health_and_sensors_are_each_engines_own():
    found, _ = belief_from_siblings(_fleet(4, 1)[1], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    usual = prior_belief(ENGINE, MAP_RMS)
    assert np.array_equal(found.health, usual.health) and np.array_equal(found.gains, usual.gains)
    assert np.array_equal(found.covariance[HEALTH_AT], usual.covariance[HEALTH_AT])


def test_an_engine_that_nothing_was_learned_of_says_nothing():
    prior = prior_belief(ENGINE, MAP_RMS)
    found, _ = belief_from_siblings([Sibling(prior, prior, ENGINE, MAP_RMS)], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    assert found.covariance == pytest.approx(prior.covariance, abs=1e-12)
    assert found.mean == pytest.approx(prior.mean)


def test_without_anything_in_common_siblings_say_nothing():
    found, _ = belief_from_siblings(_fleet(5, 2)[1], ENGINE, MAP_RMS, 0.0, BELIEFS)
    assert np.abs(found.coefficients).max() < 1e-6


def _of_weather(one: Sibling, **weather: float) -> Sibling:
    return replace(one, engine=ENGINE.replace(**weather))


def test_what_siblings_know_of_the_compressor_in_other_weather_is_known_of_the_next():
    one, other = (replace(item, exponents={"k_cflow": FLOW}) for item in _fleet(2, 1)[1])
    _, alone = belief_from_siblings([one], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    assert (alone.exponents["k_cflow"].value, alone.exponents["k_cflow"].std) == pytest.approx((FLOW.value, FLOW.std))
    _, both = belief_from_siblings([other, one], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    common = (0.5 * (1.0 + TYPE_SHARE)) ** 0.5  # of what their maps leave open, most is the type's
    assert both.exponents["k_cflow"].std == pytest.approx(common * FLOW.std, rel=0.01)  # what was believed counts once
    heard = replace(other, of_type={"k_cflow": FLOW})  # from the other one alone
    _, again = belief_from_siblings([one, heard], ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    assert again.exponents["k_cflow"].std == pytest.approx(FLOW.std)
    assert (both.p_cmap, both.T_cmap) == (ENGINE.p_cmap, ENGINE.T_cmap)


def test_what_the_base_says_of_the_compressor_stays():
    one = replace(_fleet(1, 1)[1][0], exponents={"k_cflow": FLOW})
    _, told = belief_from_siblings([one], ENGINE.replace(k_cflow=1.0), MAP_RMS, TYPE_SHARE, BELIEFS)
    assert told.exponents == {}


@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_maps_of_siblings_that_were_learned_in_other_weather_are_put_into_that_of_the_next(exponent: float):
    """1500 m higher a maker's map is another function of mass flow by more than engines differ by."""
    thin = {"p_cmap": 0.83 * ENGINE.p_cmap}
    seen = _efficiency_learned(exponent, 0.83)
    known = [_of_weather(seen, **thin)] * 4
    here = [replace(item, exponents={"k_cflow": Exponent(exponent, 0.05)}) for item in known]
    found, told = belief_from_siblings(here, ENGINE, MAP_RMS, TYPE_SHARE, BELIEFS)
    assert told.exponents["k_cflow"].value == pytest.approx(exponent, abs=0.1)
    at = np.flatnonzero((basis().maps == CORRECTED_POINTS.index("eta_c")) & basis().usual)
    tables = basis().tables[at][:, 12:24, 12:20].reshape(at.size, -1)  # 0.18 to 0.35 kg/s, ratios of 1.8 to 2.2
    left, there = (np.sqrt(np.mean((coefficients[at] @ tables) ** 2))
                   for coefficients in (found.coefficients, seen.after.coefficients))  # fmt: skip
    assert (left, there) < (1e-3, 1e-3) if exponent == 0.0 else left < 0.25 * there


def _efficiency_learned(exponent: float, thinner: float) -> Sibling:
    """An engine whose compressor is as published at sea level, learned where the air is thinner."""
    prior, functions = prior_belief(ENGINE, MAP_RMS), basis()
    plain, model = constants(we2011.PARAMETERS), numpy_model()
    flow, Pi_c = np.meshgrid(*(np.linspace(*RANGES[name], NODES) for name in ("W_c", "Pi_c")), indexing="ij")
    corrected = model.eta_c(flow / thinner**exponent, Pi_c, plain) / model.eta_c(flow, Pi_c, plain) - 1.0
    at = np.flatnonzero((functions.maps == CORRECTED_POINTS.index("eta_c")) & functions.usual)
    drove = (slice(8, 28), slice(8, 24))
    rows = functions.tables[at][:, *drove].reshape(at.size, -1)
    information = np.linalg.inv(prior.covariance[MAPS_AT, MAPS_AT])
    vector = np.zeros(len(information))
    information[np.ix_(at, at)] += rows @ rows.T / 0.01**2
    vector[at] = rows @ corrected[drove].ravel() / 0.01**2
    covariance, mean = prior.covariance.copy(), prior.mean.copy()
    covariance[MAPS_AT, MAPS_AT] = np.linalg.inv(information)
    mean[MAPS_AT] = covariance[MAPS_AT, MAPS_AT] @ vector
    return Sibling(prior, Belief(mean, covariance), ENGINE, MAP_RMS)
