"""Effects that come and go more than once: their parts of the time."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.courses import coming_and_going, schedule_of
from dieseltwin.discovery.search.pauses import likeliest_parts
from dieseltwin.discovery.twins.interface import Twin
from tests.discovery.toy import SETTINGS, Toy


def test_an_effect_that_comes_and_goes_is_found_in_its_parts() -> None:
    toy = Toy()
    toy.courses = True
    schedule = schedule_of(cast(Twin, toy), 60.0, None, False, ((110.0, 160.0), (220.0, 260.0)))
    found = search.run(toy.record(leak=(0.08, schedule)), SETTINGS, laws=False)
    assert found.kind == "variant" and found.variant is not None and found.best is not None
    assert found.best.fit.candidate.names == ("leak",)
    assert found.best.fit.magnitudes[0] == pytest.approx(0.08, abs=0.01)
    assert found.variant.onset_s == pytest.approx(60.0, abs=4.0) and found.variant.until_s is None
    np.testing.assert_allclose(found.variant.gone, [(110.0, 160.0), (220.0, 260.0)], atol=4.0)


def test_parts_are_found_of_an_effect_that_leads_nowhere_else() -> None:
    """By itself in one span another one that health takes up less may be ahead of it."""
    toy = Toy()
    toy.courses = True
    schedule = schedule_of(cast(Twin, toy), 60.0, 260.0, False, ((110.0, 160.0),))
    found = search.prepare(toy.record(leak=(0.08, schedule)), SETTINGS)
    leak = next(v for v in coming_and_going(found.null, found.scored, 0.08) if v.gone and v.name == "leak")
    assert (leak.onset_s, leak.until_s) == pytest.approx((60.0, 260.0), abs=10.0)
    np.testing.assert_allclose(leak.gone, [(110.0, 160.0)], atol=25.0)  # refits move them


def test_parts_pay_for_their_edges() -> None:  # the beginning and the end of a recording are none
    gains = np.array([-5.0, 9.0, 9.0, -5.0, 9.0, 9.0, -30.0, 20.0])
    assert likeliest_parts(gains, 8.0).tolist() == [True, True, True, True, True, True, False, True]
    assert likeliest_parts(gains, 2.0).tolist() == [False, True, True, False, True, True, False, True]
    assert likeliest_parts(gains, 40.0).all() and not likeliest_parts(gains - 5.0, 40.0).any()
