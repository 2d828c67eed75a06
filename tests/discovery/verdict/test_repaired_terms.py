"""The terms of a repaired engine: what is found again adds to what was known."""

from __future__ import annotations

import pytest

from dieseltwin.discovery.verdict.assemble import with_found
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import SensorTerm, Term

LEAK = Term(effect="boost_leak", magnitude=2e-5, std=1e-6)


def test_the_same_effect_for_the_same_driving_is_one_term() -> None:
    (term,) = with_found((LEAK,), (LEAK.model_copy(update={"magnitude": 3e-5, "valid_for": "n_e 600-1900 rpm"}),))
    assert isinstance(term, Term) and term.magnitude == pytest.approx(5e-5)


def test_no_sum_leaves_the_limits() -> None:
    high = EFFECTS["boost_leak"].limits[1]
    (term,) = with_found((LEAK,), (LEAK.model_copy(update={"magnitude": high}),))
    assert isinstance(term, Term) and term.magnitude == high


def test_other_driving_and_other_faults_stay_apart() -> None:
    later = LEAK.model_copy(update={"onset_s": 20.0})
    sensor = SensorTerm(sensor="p_im_pa", fault="gain", magnitude=0.02)
    assert with_found((LEAK,), (later, sensor)) == (LEAK, later, sensor)
