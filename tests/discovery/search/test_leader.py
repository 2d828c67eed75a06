"""The leading name alone, where all are compared anew about it; what tolerances taken once serve for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.search import leader, preparation
from dieseltwin.discovery.search import singles as search
from dieseltwin.discovery.search.explanations import polish
from dieseltwin.discovery.search.preparation import prepare, recentred, score_the_rest
from dieseltwin.discovery.search.renewal import BENDS
from dieseltwin.discovery.search.state import Search
from tests.discovery.toy import SETTINGS, Toy


def _fit(name: str, gain: float) -> Fit:
    return Fit(Candidate((name,)), np.zeros(1), np.zeros(1), np.zeros((1, 1)), -gain, True)


def _search(*fits: Fit, own_metrics: bool = False) -> Search:
    return cast(Search, SimpleNamespace(
        twin=Toy(), singles=list(fits), gain=lambda fit: -fit.objective,
        settings=SimpleNamespace(in_own_metrics=lambda gain: own_metrics),
    ))  # fmt: skip


def test_only_what_may_lead_is_followed() -> None:
    found = _search(_fit("leak", 300.0), _fit("drag", 160.0), _fit("x_offset", 140.0))
    assert leader.contenders(found) == {"leak", "drag"}


def test_the_leading_name_is_enough_where_all_are_compared_anew_about_it(monkeypatch: pytest.MonkeyPatch) -> None:
    strong, weak = _search(_fit("leak", 2.5 * BENDS)), _search(_fit("leak", 1.5 * BENDS))
    assert not leader.is_enough(strong, strong.singles)  # nothing was learned: they stay as they are
    monkeypatch.setattr(leader, "belief_of", lambda twin: object())
    assert leader.is_enough(strong, strong.singles)
    assert not leader.is_enough(weak, weak.singles)
    own = _search(_fit("leak", 2.5 * BENDS), own_metrics=True)
    assert not leader.is_enough(own, own.singles)


def test_scored_in_two_parts_is_scored_at_once() -> None:
    twin = Toy().record(leak=0.1)
    whole = prepare(twin, SETTINGS)
    part = prepare(twin, SETTINGS, among={"leak"})
    assert [item.name for item in part.scored] == ["leak"]
    score_the_rest(part)
    assert [item.name for item in part.scored] == [item.name for item in whole.scored]
    np.testing.assert_allclose([item.gain for item in part.scored], [item.gain for item in whole.scored], rtol=1e-8)
    np.testing.assert_allclose(part.chance.draws, whole.chance.draws, rtol=1e-6)


def test_the_best_fit_is_the_same_whether_others_are_followed_or_not() -> None:
    found = search.looked_at(prepare(Toy().record(leak=0.1), SETTINGS))
    fits = [replace(fit, magnitudes=0.9 * fit.magnitudes) for fit in found.singles]
    fits = [found.refitted(fit, 0) for fit in fits]  # objectives where they are now
    fits.sort(key=lambda fit: fit.objective)
    all_of_them, best = polish(found, fits), polish(found, fits, near=True)
    assert best[0].candidate.names == all_of_them[0].candidate.names == ("leak",)
    assert best[0].objective == pytest.approx(all_of_them[0].objective, abs=1e-9)
    np.testing.assert_allclose(best[0].magnitudes, all_of_them[0].magnitudes)


def test_a_search_in_short_gets_all_names_where_nothing_is_compared_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Toy().record(leak=0.1)
    expected = search.about_leading_name(search.looked_at(prepare(twin, SETTINGS)))
    monkeypatch.setattr(search, "BENDS", np.inf)
    found = search.with_singles(prepare(twin, SETTINGS, among={"leak"}), only={"leak"})
    found.in_short = True
    found = search.about_leading_name(found)
    assert not found.in_short
    assert {fit.candidate.names for fit in found.singles} == {fit.candidate.names for fit in expected.singles}
    assert found.singles[0].magnitudes == pytest.approx(expected.singles[0].magnitudes, rel=1e-6)


def test_tolerances_about_a_fit_serve_for_another_one_near_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    found = search.looked_at(prepare(Toy().record(leak=0.1), SETTINGS))
    fit = found.singles[0]
    near = recentred(found, fit)
    found.about = replace(fit, magnitudes=fit.magnitudes + 0.01 * fit.std[-1:])
    asked = []
    own = preparation.tolerances
    monkeypatch.setattr(preparation, "tolerances", lambda *some: asked.append(some) or own(*some))
    again = recentred(found, fit)
    assert not asked
    assert abs(again.fit.magnitudes[0] - near.fit.magnitudes[0]) < 0.01 * near.fit.std[-1]
    found.about = replace(fit, magnitudes=fit.magnitudes + 2.0 * fit.std[-1:])
    recentred(found, fit)
    found.about = replace(fit, candidate=Candidate(("drag",)))
    recentred(found, fit)
    assert len(asked) == 2


def test_tolerances_about_other_times_are_others() -> None:
    acts = np.ones(10)
    one = Fit(Candidate(("leak",), {"leak": acts}), np.zeros(1), np.ones(1), np.zeros((1, 1)), 0.0, True, np.eye(2))
    assert preparation._is_near(one, replace(one, candidate=Candidate(("leak",), {"leak": acts.copy()})))
    assert not preparation._is_near(one, replace(one, candidate=Candidate(("leak",), {"leak": 0.5 * acts})))
    assert not preparation._is_near(one, replace(one, candidate=Candidate(("leak",))))
