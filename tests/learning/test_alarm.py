"""The alarm over a history: its rate of false alarms, what it finds, and what it doesn't depend on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from dieseltwin.learning.alarm import Course, Score, Shown, course
from dieseltwin.settings.params import load_params

SETTINGS = load_params().watch.model_copy(update={"inflation": 1.0})
FIRST = datetime(2026, 1, 1, tzinfo=UTC)
TOLERANCE, NOISE, SHARED = 4e-6, 3e-6, 3e-6
NAMES = {"boost_leak": "intake_mass_balance", "exhaust_leak": "exhaust_mass_balance", "w_c_gain": "sensor:w_c_kg_s"}


def histories(count: int, recordings: int, seed: int) -> list[list[list[Score]]]:
    """Estimates of a healthy engine: one error that is the same in all recordings, and noise."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        open_of_maps = rng.standard_normal(len(NAMES))
        out.append([
            [
                Score(
                    name, site, "m2", TOLERANCE, k < 2, SHARED * open_of_maps[k] + NOISE * rng.standard_normal(), NOISE,
                    SHARED * np.eye(len(NAMES))[k],
                )
                for k, (name, site) in enumerate(NAMES.items())
            ]
            for _ in range(recordings)
        ])  # fmt: skip
    return out


def dates(count: int, years: float) -> list[datetime]:
    return [FIRST + timedelta(days=365.25 * years * k / (count - 1)) for k in range(count)]


def with_fault(scores: Sequence[Sequence[Score]], name: str, sizes: Sequence[float]) -> list[list[Score]]:
    return [
        [replace(score, estimate=score.estimate + size * (score.name == name)) for score in some]
        for some, size in zip(scores, sizes, strict=True)
    ]


def test_false_alarms_stay_below_the_rate_that_is_stated():
    rate, years = 0.2, 3.0
    settings = SETTINGS.model_copy(update={"alarms_per_year": rate, "least_size": 0.0})
    some = histories(150, 40, 3)
    found = [course(scores, dates(40, years), settings) for scores in some]
    assert np.mean([one.alarm is not None for one in found]) <= rate * years  # a bound: what is seen lies well below
    assert np.mean([one.evidence[-1] for one in found]) < years


def _found(sizes: Sequence[float], seed: int = 8) -> Course:
    scores = histories(1, len(sizes), seed)[0]
    return course(with_fault(scores, "boost_leak", sizes), dates(len(sizes), 1.0), SETTINGS)


def test_a_leak_that_begins_is_found_named_and_dated():
    found = _found([0.0] * 6 + [25e-6] * 6).alarm
    assert found is not None and found.at in (7, 8)
    assert found.name == "boost_leak" and found.share > 0.9 and not found.others
    day = FIRST + timedelta(days=365.25 * 6 / 11)
    assert found.earliest <= day <= found.latest
    assert abs(found.size - 25e-6) < 4.0 * found.std


def test_a_leak_that_grows_is_told_from_one_that_begins():
    found = _found(np.linspace(0.0, 40e-6, 12)).alarm
    assert found is not None and found.name == "boost_leak"
    assert _found([0.0] * 12).alarm is None


def test_growth_is_dated_to_the_recording_from_which_on_it_grows():
    found = _found([0.0] * 5 + list(np.linspace(0.0, 90e-6, 7))).alarm  # nothing in the sixth, 15 mm2 in the seventh
    assert found is not None and found.grows
    assert found.since == dates(12, 1.0)[5]
    assert found.earliest <= found.since <= found.latest


def test_what_recordings_show_by_themselves_names_the_alarm():
    """Two recordings with a leak of 30 mm2, each a boost leak by itself, were a loss of the compressor together."""
    other = next(name for name in NAMES if name != "boost_leak")
    scores = with_fault(histories(1, 12, 8)[0], "boost_leak", [0.0] * 6 + [25e-6] * 6)
    scores = with_fault(scores, other, [0.0] * 6 + [50e-6] * 6)  # as a strong fault bends the linear estimates

    def said(*later: tuple[str, ...]) -> tuple[str, int]:
        shown = [Shown(names) for names in ((), ("boost_leak",), *[()] * 4, *later)]
        found = course(scores, dates(12, 1.0), SETTINGS, shown).alarm
        assert found is not None and found.at == without.at
        return found.name, found.shown

    without = course(scores, dates(12, 1.0), SETTINGS).alarm
    assert without is not None and without.name == other and without.shown == 0
    assert said(*[("boost_leak",)] * 6) == ("boost_leak", without.at - 5)
    assert said(("boost_leak",), ("none_of_these",), *[("boost_leak",)] * 4)[0] == other
    assert said(*[()] * 6) == (other, 0)


def test_what_was_mended_is_gone():
    found = _found([0.0] * 4 + [25e-6] * 4 + [0.0] * 3).alarm
    assert found is not None and found.gone == 8
    np.testing.assert_allclose(found.sizes, [0.0] * 4 + [25e-6] * 4 + [0.0] * 3, atol=4.0 * found.stds.max())
    assert np.all((found.stds > NOISE) & (found.stds < 1.5 * NOISE))
    stays = _found([0.0] * 4 + [25e-6] * 7).alarm
    assert stays is not None and stays.gone is None
    again = _found([0.0] * 4 + [25e-6] * 3 + [0.0] * 2 + [25e-6] * 2).alarm
    assert again is not None and again.gone is None


def test_one_odd_recording_is_no_alarm():
    sizes = [0.0] * 12
    sizes[6] = 500e-6
    assert _found(sizes).alarm is None


def test_what_is_too_small_to_matter_is_no_evidence_and_hides_nothing():
    """An actuator 2 ms late where 50 ms are of interest came to an evidence of 5400 in ten recordings of a healthy
    engine; the next odd recording was an alarm by itself then."""
    other = next(score for score in histories(1, 1, 8)[0][0] if score.name != "boost_leak")
    small = [
        [replace(score, estimate=0.05 * TOLERANCE, noise_std=0.01 * TOLERANCE, shared=0.0 * score.shared)
         if score.name == other.name else score for score in some] for some in histories(1, 12, 8)[0]
    ]  # fmt: skip
    healthy = course(small, dates(12, 1.0), SETTINGS)
    assert healthy.alarm is None and healthy.evidence.max() < 1.0
    assert course(small, dates(12, 1.0), SETTINGS.model_copy(update={"least_size": 0.0})).evidence.max() > 1e3
    odd = with_fault(small, "boost_leak", [0.0] * 11 + [500e-6])
    assert course(odd, dates(12, 1.0), SETTINGS).alarm is None
    leaking = course(with_fault(small, "boost_leak", [0.0] * 6 + [25e-6] * 6), dates(12, 1.0), SETTINGS).alarm
    assert leaking is not None and leaking.at in (7, 8) and leaking.name == "boost_leak" and leaking.share > 0.99


def test_sizes_are_those_of_the_recordings_own_refit_where_they_name_the_effect():
    """Linear estimates of a leak of 15 mm2 were 8.7 +- 0.5 to 18.8 +- 1.7 mm2, its refits 14.2 to 16.0."""
    scores = with_fault(histories(1, 10, 8)[0], "boost_leak", [0.0] * 5 + [25e-6] * 4 + [5e-6])
    shown = [*[Shown()] * 5, *[Shown(("boost_leak",), {"boost_leak": (15e-6, 1e-6)})] * 5]
    found = course(scores, dates(10, 1.0), SETTINGS, shown).alarm
    assert found is not None and (found.size, found.std) == (15e-6, 1e-6)
    assert np.all(found.sizes[5:] == 15e-6) and np.all(found.stds[5:] == 1e-6) and found.gone is None
    bent = course(scores, dates(10, 1.0), SETTINGS).alarm
    assert bent is not None and bent.gone == 9


def test_what_is_open_of_the_maps_is_no_change():
    """An estimate that is off in all recordings alike, by what the reference left open, is what a map does."""
    scores = [[replace(score, estimate=2.0 * SHARED, noise_std=0.1 * NOISE) for score in some]
              for some in histories(1, 30, 4)[0]]  # fmt: skip
    assert course(scores, dates(30, 2.0), SETTINGS).alarm is None


def test_evidence_is_the_integral_that_it_claims():
    scores = [some[:1] for some in histories(1, 3, 11)[0]]
    days = dates(3, 0.5)
    values = np.array([some[0].estimate for some in scores])
    covariance = SHARED**2 * np.ones((3, 3)) + NOISE**2 * np.eye(3)
    years = np.array([0.0, 0.25, 0.5])
    weights = [0.5, 0.125, 0.125]
    begins = [multivariate_normal(cov=covariance).pdf(values)]

    def ratio(profile: np.ndarray, spread: float) -> float:
        def density(size: float) -> float:
            shifted = multivariate_normal(mean=size * profile, cov=covariance).pdf(values)
            return float(2.0 * norm.pdf(size, scale=spread) * shifted / begins[0])

        return float(quad(density, 0.0, 12.0 * spread, points=[NOISE, 5.0 * NOISE], limit=200)[0])

    expected = 0.0
    for k, weight in enumerate(weights):
        before = years[max(k - 1, 0)]
        step = ratio((years >= years[k]).astype(float), SETTINGS.step_size * TOLERANCE)
        growth = ratio(np.maximum(years - before, 0.0), SETTINGS.growth_size * TOLERANCE)
        expected += weight * 0.5 * (step + growth)
    settings = SETTINGS.model_copy(update={"least_size": 0.0})
    assert course(scores, days, settings).evidence[-1] == pytest.approx(expected, rel=1e-4)
