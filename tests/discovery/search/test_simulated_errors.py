"""Weak explanations of all kinds are compared with the errors of maps that they ask for simulated."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dieseltwin.discovery.laws.unnamed import leading_refits
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.search import explanations, simulated_errors
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search.alarms import score_unnamed
from dieseltwin.discovery.search.explanations import single_stands
from dieseltwin.discovery.search.simulated_errors import verified, verify
from dieseltwin.discovery.search.state import Search
from tests.discovery.toy import SETTINGS, Toy


@pytest.fixture(scope="module")
def found() -> Search:
    return search.run(Toy().record(gain=0.95, leak=0.02), SETTINGS, laws=False)


def _losing(monkeypatch: pytest.MonkeyPatch, lost: dict[str, float]) -> list[tuple[str, ...]]:
    """Have simulated errors take away so much of each effect; the names that were asked for, in turn."""
    asked: list[tuple[str, ...]] = []

    def rebased(found: Search, fit: Fit, **_: object) -> Linearisation:
        asked.append(fit.candidate.names)
        at = Linearisation(found.twin, found.whitening, found.null.fit, found.null)
        at.fit = replace(fit, objective=fit.objective + sum(lost.get(name, 0.0) for name in fit.candidate.names))
        return at

    monkeypatch.setattr(simulated_errors, "rebased", rebased)
    return asked


def test_a_pair_loses_what_its_single_effect_lost(found: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """A right name had 128 linearly and 72 simulated; beside it an EGR valve's offset was ahead by 60 for nothing."""
    own = replace(found.anew(), singles=list(found.singles))
    _losing(monkeypatch, {"leak": 20.0})
    before = own.gain(own.singles[0])
    verify(own)
    assert own.simulated_errors
    (leak,) = (fit for fit in own.singles if fit.candidate.names == ("leak",))
    assert own.gain(leak) == pytest.approx(before - 20.0)
    both = replace(leak, objective=leak.objective - 20.0 - 4.0)
    assert own.gain(verified(own, [both])[0]) == pytest.approx(before - 20.0 + 4.0)


def test_of_many_that_lead_the_last_lose_as_little_as_any(found: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    own = replace(found, simulated_errors=True)
    asked = _losing(monkeypatch, {"leak": 30.0, "drag": 10.0})
    leak, drag = (next(fit for fit in found.singles if name in fit.candidate.names) for name in ("leak", "drag"))
    fits = [replace(fit, objective=100.0 + k) for k, fit in enumerate([leak, drag, leak, drag, leak])]
    after = verified(own, fits)
    assert asked == [("leak",), ("drag",), ("leak",)]
    assert [fit.objective for fit in after] == [130.0, 111.0, 132.0, 113.0, 114.0]
    assert verified(replace(found, simulated_errors=False), fits) == fits


def test_a_term_that_seems_ahead_is_simulated(found: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """The vanes' offset had 116 linearly, as a term without a name 98, and 72 simulated: the name is enough."""
    own = replace(found.anew(), singles=list(found.singles))
    assert score_unnamed(own)[0]
    own.kind, own.best, own.nuisances = "single", None, found.nuisances
    bar = own.gain(own.singles[0]) + SETTINGS.law_gain
    some = next(item for item in own.structure if item.feature.form is not None and item.feature.effect is None)
    own.structure = [replace(some, gain=bar + 5.0, held=bar + 5.0)]
    own.simulated_errors = False
    assert not single_stands(own)  # where names are compared linearly, so is the term
    own.simulated_errors = True
    (refit, *_) = leading_refits(own.twin, own.whitening, own.null, own.structure, bar)
    fitted = [replace(refit, gain=bar + 5.0)]
    monkeypatch.setattr(explanations, "leading_refits", lambda *_: iter(fitted))
    for simulated, stands in ((bar - 5.0, True), (bar + 5.0, False)):
        monkeypatch.setattr(explanations, "gain_of_term", lambda found, refit, gain=simulated: gain)
        assert single_stands(own) is stands


def test_pairs_that_were_compared_pay_once(found: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """A first pair of 72 had 27 beside three that were found later and lead linearly."""
    monkeypatch.setattr(explanations, "polish", lambda found, fits, count: list(fits))
    own = replace(found.anew(), simulated_errors=True)
    _losing(monkeypatch, {"leak": 50.0, "drag": 50.0})
    some, null = own.singles[0], own.null.fit.objective

    def pair(one: str, other: str, gain: float) -> Fit:
        return replace(some, candidate=Candidate((one, other)), objective=null - gain)

    own.pairs = [pair("a", "b", 72.0)]  # compared in the first round
    later = [pair("c", "leak", 100.0), pair("d", "leak", 95.0), pair("e", "leak", 90.0)]
    monkeypatch.setattr(explanations, "_joined", lambda base, seconds: later)
    monkeypatch.setattr(explanations, "_beyond", lambda *_: own.scored)
    own.singles = [own.singles[0], own.singles[1]]
    explanations.try_more_pairs(own)
    assert own.pairs[0].candidate.names == ("a", "b") and own.gain(own.pairs[0]) == pytest.approx(72.0)
    assert own.gain(own.pairs[1]) == pytest.approx(50.0)
