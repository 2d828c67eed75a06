"""Terms without a name, on equal terms with names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.laws.features import Structure, generic_features, score_features, score_what_is_left
from dieseltwin.discovery.laws.grammar import Factor, Form
from dieseltwin.discovery.laws.unnamed import leading, leading_refits, refit_terms
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.twins.interface import Point
from tests.discovery.toy import SETTINGS, Toy


class _Withheld:
    """A leak in the vessel, large enough to bend what a linear score promises."""

    def __init__(self) -> None:
        self.toy = Toy(2000, 10).record(leak=0.15)
        self.found = prepare(self.toy, SETTINGS)
        null = self.found.null
        self.structure = score_features(null, generic_features(self.toy, null.fit))

    def gain(self, name: str) -> float:
        null = self.found.null
        start = Fit(Candidate((name,)), null.fit.parameters, np.array([0.01]), null.fit.local, np.inf, False)
        return self.found.gain(fit_fully(self.toy, self.found.whitening, start, frozen=null).fit)


@pytest.fixture(scope="module")
def withheld() -> _Withheld:
    return _Withheld()


def test_a_refitted_term_gains_as_much_as_the_name_it_stands_for(withheld: _Withheld) -> None:
    null = withheld.found.null
    best = refit_terms(withheld.toy, null, leading(withheld.structure))[0]
    assert (best.ranked.placed[0].form.point, [f.variables for f in best.ranked.placed[0].form.factors]) == (
        "balance", [("x",)])
    assert best.gain == pytest.approx(withheld.gain("leak"), rel=0.02)


def test_a_term_outdoes_the_wrong_name(withheld: _Withheld) -> None:
    found = withheld.found
    wrong = withheld.gain("drag")
    refits = leading_refits(withheld.toy, found.whitening, found.null, withheld.structure, wrong + 15.0)
    assert max(refit.gain for refit in refits) > wrong + 15.0


def test_terms_far_from_what_is_needed_are_not_simulated(withheld: _Withheld, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = leading(withheld.structure)
    best, few = inside[0].gain, leading(withheld.structure, 2.5 * inside[0].gain)
    assert few == inside[: len(few)] and 0 < len(few) < len(inside)
    assert leading(withheld.structure, 3.0 * best + 60.0) == []
    found = withheld.found
    monkeypatch.setattr(withheld.toy, "simulate", None)
    assert not list(leading_refits(withheld.toy, found.whitening, found.null, withheld.structure, 3.0 * best + 60.0))


def test_a_weak_term_is_simulated_where_little_is_needed(withheld: _Withheld) -> None:
    """A linear score of 12 was 51 by simulation: near what is needed no share of it refuses a term."""
    weak = [replace(item, gain=12.0) for item in withheld.structure]
    assert leading(weak, 51.0)


def test_what_is_left_is_scored_as_without_the_scores_before(withheld: _Withheld) -> None:
    """Beside a health parameter that is off: scores at the fit tell which terms are worth a simulation, and no more."""
    found = withheld.found
    start = replace(found.null.fit, parameters=found.null.fit.parameters * 1.05)
    at = Linearisation(withheld.toy, found.whitening, start)
    features = generic_features(withheld.toy, start)
    alone = score_features(at, features)
    beside = score_what_is_left(at, features, withheld.structure)
    strong = [item for item in alone if item.gain > 9.0]
    assert len(strong) > 3
    assert [item.feature.text for item in beside[: len(strong)]] == [item.feature.text for item in strong]
    assert [item.gain for item in beside[: len(strong)]] == pytest.approx([item.gain for item in strong])
    bent = [replace(item, response=np.zeros_like(item.response)) for item in withheld.structure]
    assert score_what_is_left(at, features, bent)[0].gain <= alone[0].gain  # responses that gain nothing are left out
    short = [replace(item, response=item.response[1:]) for item in withheld.structure]  # of another recording
    assert len(score_what_is_left(at, features, short)) == len(alone)


def test_a_term_that_the_fit_has_by_name_is_not_scored_beside_it(withheld: _Withheld) -> None:
    found, null = withheld.found, withheld.found.null
    start = Fit(Candidate(("leak",)), null.fit.parameters, np.array([0.01]), null.fit.local, np.inf, False)
    named = fit_fully(withheld.toy, found.whitening, start, frozen=null)

    def places(items: list[Structure]) -> set[tuple[str, str]]:
        return {(i.feature.form.point, i.feature.text) for i in items if i.feature.form is not None}

    beside = places(score_features(named, generic_features(withheld.toy, named.fit)))
    assert places(withheld.structure) - beside == {("balance", "x")}


def test_leading_terms_are_of_several_points(withheld: _Withheld) -> None:
    many = [replace(item, gain=1.0) for item in withheld.structure for _ in range(9)]
    points = [item.feature.point for item in leading(many)]
    assert None not in points  # faults of sensors have no form
    assert max(points.count(point) for point in points) == 3


def test_actuators_may_be_late_and_other_points_not() -> None:
    toy = Toy(1000, 5).record()
    toy.points = (toy.points[0], Point("u", "heater", False, "%", ("u",)))
    features = generic_features(toy, prepare(Toy(1000, 5).record(), SETTINGS).null.fit)
    late = {f.text: f for f in features if f.form is not None and f.form.operator}
    assert {f.site for f in late.values()} == {"heater"}
    assert {"dead time 0.05", "dead time 0.2", "lag 0.4", "play 1"} <= set(late)
    shifted = np.append(toy.u[:1], toy.u[:-1]) - toy.u  # a sample is 0.2 s
    assert late["dead time 0.2"].signal == pytest.approx(shifted / np.sqrt(np.mean(shifted**2)))


def test_what_would_run_ahead_of_its_command_explains_nothing() -> None:
    """A command whose clock was put right has its corners cut, as if it ran ahead: that is the opposite of a play."""
    toy = Toy(2000, 10).record(leak=0.03)
    leak = _strongest(toy)
    sign = np.sign(leak.coefficient)
    delay = Form("leak", (Factor("dead_time", ("x",), (1.0,), 0.2, ("%",)),), 1.0)
    late = replace(leak.feature, signal=sign * leak.feature.signal, form=delay)
    ahead = replace(late, signal=-late.signal)
    null = prepare(toy, SETTINGS).null
    (scored,) = score_features(null, [late, ahead])
    assert scored.feature is late and scored.coefficient > 0.0 and scored.gain > 50.0
    assert {feature.behind for feature in generic_features(toy, null.fit)} == {False}
    toy.points = (toy.points[0], Point("u", "heater", False, "%", ("u",)))
    assert {f.site for f in generic_features(toy, null.fit) if f.behind} == {"heater"}


def test_losses_of_a_shaft_and_holes_of_hot_gas() -> None:
    toy = Toy(1000, 5).record()
    fit = prepare(toy, SETTINGS).null.fit
    n = toy.time_s.size
    walk = 1.0 + 0.2 * np.sin(toy.time_s)
    values = {"omega": 5e3 * walk, "p_em": 2e5 * walk, "T_em": 700.0 * walk**2, "p_amb": np.full(n, 1e5)}
    toy.variables = lambda lanes: values  # type: ignore[assignment]
    toy.points = (
        Point("shaft", "shaft_power", False, "W", ("omega",)),
        Point("hot", "exhaust_mass_balance", False, "kg/s", ("p_em", "T_em")),
    )
    signals = {(f.site, f.text): f.signal for f in generic_features(toy, fit)}
    cube = signals["shaft_power", "omega^3"]
    assert cube / cube[0] == pytest.approx((walk / walk[0]) ** 3)
    hole = signals["exhaust_mass_balance", "hole of p_em"]  # always choked but for the lowest pressures
    choked = values["p_em"] > 1.9e5
    assert np.ptp(hole[choked] / (values["p_em"] / np.sqrt(values["T_em"]))[choked]) < 1e-4 * hole.mean()


def test_a_term_that_hangs_on_one_window_is_not_held() -> None:
    toy = Toy(2000, 10).record(leak=0.03)
    everywhere = _strongest(toy)
    toy = Toy(2000, 10).record()
    bent = Toy(2000, 10).record(leak=(0.2, (np.arange(2000) // 200 == 4).astype(float)))
    rows = slice(800, 1000)
    toy.measured[rows] = bent.measured[rows]
    once = _strongest(toy)
    assert once.gain > 50.0 and once.held < 0.2 * once.gain
    assert everywhere.gain > 50.0 and everywhere.held > 0.6 * everywhere.gain


def _strongest(toy: Toy) -> Structure:
    null = prepare(toy, SETTINGS).null
    terms = score_features(null, generic_features(toy, null.fit))
    return next(item for item in terms if item.feature.site == "vessel" and item.feature.text == "x")
