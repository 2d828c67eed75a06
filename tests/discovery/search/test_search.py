"""The core of discovery on a machine small enough to know the answers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, _downhill, fit_fully
from dieseltwin.discovery.likelihood.metric import Metric, WhitenedNuisances, Whitening
from dieseltwin.discovery.likelihood.nuisance import (
    FINE,
    LEADING,
    map_nuisances,
    nuisance_responses,
    tolerance_modes,
)
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.likelihood.score import (
    best_of_each,
    chance,
    effect_responses,
    score,
    secant_sizes,
    ways_of_each,
)
from dieseltwin.discovery.search import run as search
from dieseltwin.discovery.search import singles
from dieseltwin.discovery.search.alarms import clearly_named, score_unnamed
from dieseltwin.discovery.search.courses import schedule_of
from dieseltwin.discovery.search.explanations import choose
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.variants import Variant, scan
from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.discovery.verdict.findings import too_small
from dieseltwin.errors import InputError
from dieseltwin.recordings.noise import Noise, estimate_noise
from tests.discovery.toy import SETTINGS, Toy


def _at(toy: Toy, **effects: float) -> Linearisation:
    noise = estimate_noise(toy.measured)
    whitening = Whitening.of(toy.measured, noise, toy.starts)
    start = Fit(
        Candidate(tuple(effects)), np.array([1.0]), np.array(list(effects.values())), toy.first_local(), np.inf, False
    )
    return fit_fully(toy, whitening, start)


def test_terms_without_a_name_wait_where_the_best_name_is_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are scored before they are chosen from, and the verdict is that of scoring them first."""
    toy, scored = Toy().record(gain=0.9, drag=0.3), []
    monkeypatch.setattr(search, "score_unnamed", lambda found: scored.append(found) or score_unnamed(found))
    waited, first = (search.run(toy, SETTINGS, laws=False, time_s=time_s) for time_s in (None, 600.0))
    assert len(scored) == 1 and clearly_named(waited)
    assert waited.kind == first.kind == "single" and waited.best is not None and first.best is not None
    assert waited.best.fit.objective == first.best.fit.objective
    assert [item.gain for item in waited.structure] == [item.gain for item in first.structure]


def test_toy_is_a_twin() -> None:
    assert isinstance(Toy(100, 2), Twin)


@pytest.mark.parametrize("rho", [0.0, 0.3, 0.5])
def test_noise_is_found_beside_a_moving_signal(rho: float) -> None:
    toy = Toy(3000, 10).record(noise=0.0)
    rng = np.random.default_rng(3)
    sigma = 0.03 * toy.measured.mean(axis=0)
    noise = rng.normal(size=toy.measured.shape)
    for i in range(1, len(noise)):
        noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * noise[i]
    found = estimate_noise(toy.measured + sigma * noise, explained=1.03 * toy.measured)
    assert found.sigma == pytest.approx(sigma, rel=0.1)
    assert found.rho == pytest.approx(rho, abs=0.1)


def test_noise_of_an_empty_channel_is_unknown() -> None:
    found = estimate_noise(np.full((100, 1), np.nan))
    assert np.isnan(found.sigma[0])


def test_metric_is_the_marginal_likelihood() -> None:
    """Projection in the augmented space against the dense covariance of noise, initial states and tolerances."""
    rng = np.random.default_rng(0)
    n, C, W, K = 24, 2, 3, 2
    starts = np.array([0, 8, 16])
    noise = Noise(np.array([0.5, 2.0]), np.array([0.4, 0.0]))
    measured = rng.normal(size=(n, C))
    local, nuisances = rng.normal(size=(1, n, C)), rng.normal(size=(K, n, C))
    whitening = Whitening.of(measured, noise, starts)
    known = WhitenedNuisances.of(whitening, nuisances)
    metric = Metric(whitening, starts, local, np.array([0.7]), known)
    r = rng.normal(size=(n, C))
    columns = [nuisances[k].ravel() for k in range(K)]
    scale = [1.0] * K
    covariance = np.zeros((n * C, n * C))
    for w in range(W):
        rows = slice(starts[w], starts[w] + 8)
        piece = np.zeros((n, C))
        piece[rows] = local[0][rows]
        columns.append(piece.ravel())
        scale.append(0.7**2)
        for c in range(C):
            lag = np.abs(np.subtract.outer(np.arange(8), np.arange(8)))
            at = (np.arange(8) + starts[w]) * C + c
            covariance[np.ix_(at, at)] = noise.sigma[c] ** 2 * noise.rho[c] ** lag
    basis = np.stack(columns, axis=1)
    covariance += basis @ np.diag(scale) @ basis.T
    vector = metric.project(r[None])[0]
    assert vector @ vector == pytest.approx(r.ravel() @ np.linalg.solve(covariance, r.ravel()), rel=1e-9)
    directions = metric.nuisance_basis
    assert directions is not None
    assert directions @ directions.T == pytest.approx(np.eye(K), abs=1e-12)
    assert directions @ vector == pytest.approx(np.zeros(K), abs=1e-9)


def test_missing_readings_count_for_nothing() -> None:
    measured = np.zeros((20, 1))
    measured[5] = np.nan
    metric = Metric(
        Whitening.of(measured, Noise(np.ones(1), np.full(1, 0.5)), np.array([0])), np.array([0]),
        np.zeros((0, 20, 1)), np.zeros(0),
    )  # fmt: skip
    one, two = np.ones((1, 20, 1)), np.ones((1, 20, 1))
    two[0, 5] = 1e6
    assert np.array_equal(metric.project(one), metric.project(two))


def test_tolerance_modes_have_unit_variance() -> None:
    x = np.random.default_rng(0).uniform(size=2000)
    assert (tolerance_modes([x]) ** 2).sum(axis=0).mean() == pytest.approx(1.0, abs=0.03)


def test_fine_modes_carry_a_maps_error_where_the_engine_seldom_is() -> None:
    """The weather shows best there; the leading modes took the map for exact and its intervals were too narrow."""
    rng = np.random.default_rng(0)
    seldom = rng.uniform(0.7, 1.0, (20, 2))
    x, y = np.concatenate([rng.uniform(0.0, 0.5, (1980, 2)), seldom])[rng.permutation(2000)].T
    away = (x > 0.6) & (y > 0.6)
    variance = {d: (tolerance_modes([x, y], d) ** 2).sum(axis=0) for d in (LEADING, FINE)}
    assert variance[LEADING][away].min() < 0.6 and variance[LEADING].mean() > 0.95
    assert variance[FINE][away].min() > 0.9


def test_parameter_and_magnitude_are_recovered() -> None:
    toy = Toy().record(gain=1.1, leak=0.05)
    at = _at(toy, leak=0.0)
    assert at.fit.converged
    errors = np.abs(np.array([at.fit.parameters[0] - 1.1, at.fit.magnitudes[0] - 0.05]))
    assert (errors < 3.5 * at.fit.std).all()
    assert at.fit.std[1] < 0.01


def test_chord_refit_agrees_with_the_full_one() -> None:
    toy = Toy().record(gain=1.1, drag=0.03)
    null = _at(toy)
    wanted = secant_sizes(toy, ["drag"])
    (chord,) = refit_all(null, [Candidate(("drag",))], [effect_responses(toy, null, wanted)])
    full = _at(toy, drag=0.0).fit
    assert chord.magnitudes[0] == pytest.approx(full.magnitudes[0], abs=0.2 * full.std[1])


def test_ways_of_an_effect_that_differ_are_kept() -> None:
    """Next to a kink an effect does one thing upwards and another downwards; both may begin in the middle."""
    toy = Toy().record()
    null = _at(toy)
    leak, offset = effect_responses(toy, null, [("leak", 0.01), ("x_offset", 0.02)])
    wanted = [("leak", 0.01), ("leak", -0.01), ("x_offset", 0.02), ("x_offset", -0.02)]
    scored = score(null, wanted, np.stack([leak, 1.1 * leak, offset, leak + 0.1 * offset]))
    kept = ways_of_each(scored)
    assert sorted(item.size for item in kept if item.name == "x_offset") == [-0.02, 0.02]
    assert [item.name for item in kept].count("leak") == 1
    assert {item.name for item in best_of_each(scored)} == {"leak", "x_offset"}


@pytest.mark.thorough
def test_chance_gives_its_own_level() -> None:
    """On healthy machines the largest gain exceeds the 20 % threshold in about 20 % of draws."""
    exceeded = 0
    draws = 40
    for seed in range(draws):
        toy = Toy(600, 5, seed=seed).record(gain=1.05, seed=100 + seed)
        null = _at(toy)
        wanted = secant_sizes(toy, list(toy.hypotheses))
        scored = score(null, wanted, effect_responses(toy, null, wanted))
        exceeded += best_of_each(scored)[0].gain > chance(null, scored, 0).threshold(0.2)
    assert 2 <= exceeded <= 16  # binomial(40, 0.2): 99.7 % lie within


def test_tolerances_weaken_what_looks_like_them() -> None:
    toy = Toy().record()
    bare = _at(toy)
    base = bare.fit.lanes()
    nuisances = map_nuisances(toy, toy.variables(base))
    response = nuisance_responses(toy, base, bare.simulated, nuisances)
    at = Linearisation(toy, bare.whitening, bare.fit, None, response)
    wanted = secant_sizes(toy, ["drag", "x_offset"])
    before, after = (score(one, wanted, effect_responses(toy, one, wanted)) for one in (bare, at))
    assert after[0].std > 1.2 * before[0].std
    assert all(b.std >= 0.999 * a.std for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize("name,size", [("leak", 0.06), ("drag", 0.05), ("x_offset", 0.08)])
def test_search_names_the_effect(name: str, size: float) -> None:
    found = search.run(Toy().record(gain=0.9, **{name: size}), SETTINGS, laws=False)
    assert found.kind == "single"
    assert found.best is not None and found.best.fit.candidate.names == (name,)
    assert abs(found.best.fit.magnitudes[0] - size) < 4 * found.best.fit.std[1]
    assert found.best.fit.parameters[0] == pytest.approx(0.9, abs=0.02)


def test_search_is_quiet_on_healthy_machines() -> None:
    kinds = [search.run(Toy(900, 6, seed=s).record(seed=50 + s), SETTINGS, laws=False).kind for s in range(8)]
    assert kinds == ["healthy"] * 8


def test_search_says_when_no_name_fits() -> None:
    """A constant drain, and the catalogue knows a sensor's offset alone."""
    toy = Toy().record(gain=1.0, drag=0.15)
    found = search.run(
        toy, SETTINGS.asked(("leak", "drag"), 0), laws=False
    )
    assert found.kind == "law"
    assert found.structure[0].feature.site == "vessel"


def test_an_effect_that_can_only_be_negative_is_found() -> None:
    toy = Toy().record(gain=1.0, x_offset=-0.08)
    toy.hypotheses["x_offset"] = replace(toy.hypotheses["x_offset"], limits=(-1.0, 0.0))
    found = search.run(toy, SETTINGS, laws=False)
    assert found.best is not None and found.best.fit.candidate.names == ("x_offset",)
    assert found.best.fit.magnitudes[0] == pytest.approx(-0.08, abs=0.01)


def test_a_catalogue_of_which_nothing_is_left_is_refused() -> None:
    with pytest.raises(InputError, match="withhold: got every effect"):
        search.run(Toy().record(), SETTINGS.asked(("leak", "drag", "x_offset"), 0))


def test_without_time_the_best_single_effect_is_the_answer_and_what_was_left_out_is_said() -> None:
    toy = Toy().record(drag=0.1)
    found = search.run(toy, SETTINGS, time_s=0.0)
    assert found.kind == "single" and found.best is not None
    assert found.best.fit.candidate.names == ("drag",)
    assert found.best.fit.magnitudes[0] == pytest.approx(0.1, abs=0.02)
    assert found.unfinished == search.STAGES and not found.pairs and not found.structure
    assert found.share_explained() is None  # what is left wasn't looked at
    assert search.run(Toy().record(), SETTINGS, time_s=0.0).kind == "healthy"
    assert not search.run(Toy().record(drag=0.1), SETTINGS, laws=False, time_s=600.0).unfinished


def test_onset_is_found() -> None:
    toy = Toy()
    acts = (toy.time_s >= 160.0).astype(float)
    found = search.run(toy.record(leak=(0.08, acts)), SETTINGS, laws=False)
    assert found.kind == "variant" and found.variant is not None
    assert found.best is not None and found.best.fit.candidate.names == ("leak",)
    assert found.variant.onset_s == pytest.approx(160.0, abs=4.0)


@pytest.mark.parametrize(("until_s", "grows"), [(220.0, False), (None, True)])
def test_the_end_or_the_growth_of_an_effect_is_found_where_the_twin_says_so(until_s: float | None, grows: bool) -> None:
    toy = Toy()
    toy.courses = True
    schedule = schedule_of(cast(Twin, toy), 100.0, until_s, grows)
    found = search.run(toy.record(leak=(0.08, schedule)), SETTINGS, laws=False)
    assert found.kind == "variant" and found.variant is not None and found.best is not None
    assert found.best.fit.candidate.names == ("leak",)
    assert found.best.fit.magnitudes[0] == pytest.approx(0.08, abs=0.01)
    assert found.variant.onset_s == pytest.approx(100.0, abs=25.0 if grows else 4.0)
    assert found.variant.until_s == (None if until_s is None else pytest.approx(until_s, abs=4.0))
    assert found.variant.grows == grows


def test_region_is_found() -> None:
    toy = Toy()
    acts = (toy.u > 1.75).astype(float)
    toy.record(leak=(0.1, acts))
    null = _at(toy)
    wanted = secant_sizes(toy, list(toy.hypotheses))
    variants = scan(null, score(null, wanted, effect_responses(toy, null, wanted)), 5)
    best = next(v for v in variants if v.name == "leak" and v.region is not None)
    assert best.region is not None
    assert best.region["u"][0] == pytest.approx(1.75, abs=0.3)
    assert np.mean(np.abs(best.schedule - acts) < 0.6) > 0.85


def test_region_with_two_edges_is_named_and_its_edges_found() -> None:
    toy = Toy()
    acts = ((toy.u > 1.2) & (toy.u < 2.2)).astype(float)
    found = search.run(toy.record(gain=0.95, leak=(0.1, acts)), SETTINGS, laws=False)
    assert found.kind == "variant" and found.variant is not None and found.variant.region is not None
    assert found.best is not None and found.best.fit.candidate.names == ("leak",)
    assert found.variant.region["u"] == pytest.approx((1.2, 2.2), abs=0.12)
    assert found.variant.edges == 2
    assert abs(found.best.fit.magnitudes[0] - 0.1) < 4 * found.best.fit.std[1]
    assert found.best.fit.parameters[0] == pytest.approx(0.95, abs=0.02)


def test_two_effects_are_named_where_the_stronger_hides_the_other() -> None:
    found = search.run(Toy().record(gain=0.9, drag=0.2, x_offset=-0.12), SETTINGS, laws=False)
    assert found.kind == "pair"
    assert found.best is not None and set(found.best.fit.candidate.names) == {"drag", "x_offset"}
    for name, size in (("drag", 0.2), ("x_offset", -0.12)):
        at = found.best.fit.candidate.names.index(name)
        assert abs(found.best.fit.magnitudes[at] - size) < 4 * found.best.fit.std[1 + at]


def test_a_second_effect_whose_own_size_is_not_told_is_not_named() -> None:
    """The gain of a pair is one in the metric of health; its sizes are told about itself, beside what it leaves."""
    record = Toy().record(gain=0.9, drag=0.2, x_offset=-0.12)
    pair = search.run(record, SETTINGS, laws=False)
    sure = np.abs(pair.best.fit.magnitudes) / pair.best.fit.std[1:]
    asked = SETTINGS.model_copy(update={"second_size_std": 1.01 * float(sure.min())})
    found = search.run(record, asked, laws=False)
    assert pair.kind == "pair" and found.kind != "pair"
    assert pair.best.fit.candidate.names not in [fit.candidate.names for fit in found.pairs]


def test_what_an_unsure_second_effect_explains_refuses_no_name() -> None:
    found = search.run(Toy().record(gain=0.9, drag=0.2, x_offset=-0.12), SETTINGS, laws=False)
    lead = found.singles[0].candidate.names[0]
    found.pairs, found.variants, found.structure, found.local = [], [], [], []
    choose(found, None, ("heat", "loss"))
    assert found.kind == "law" and found.refused == "single"
    choose(found, None, (lead, "loss"))
    assert found.kind == "single" and found.best.fit.candidate.names == (lead,)


def test_a_second_effect_that_hangs_on_one_window_is_not_named() -> None:
    """What bends one of ten windows isn't an effect of the machine; the same evidence in all of them is."""
    toy, bent = Toy(2000, 10).record(drag=0.2), Toy(2000, 10).record(drag=0.2, x_offset=0.16)
    rows = slice(800, 1000)
    toy.measured[rows] = bent.measured[rows]
    once = search.run(toy, SETTINGS, laws=False)
    assert once.pairs and once.gain(once.pairs[0]) > once.gain(once.singles[0]) + SETTINGS.second_gain
    assert once.spreads["x_offset"] < SETTINGS.least_spread
    assert once.kind != "pair"
    everywhere = search.run(Toy(2000, 10).record(drag=0.2, x_offset=0.08), SETTINGS, laws=False)
    assert everywhere.kind == "pair" and everywhere.spreads["x_offset"] > SETTINGS.least_spread


def test_a_lesser_effect_of_half_a_tolerance_counts_beside_a_strong_one() -> None:
    found = prepare(Toy().record(drag=0.2), SETTINGS)

    def pair(drag: float, offset: float) -> Fit:
        sizes = np.array([drag, offset]) * [0.01, 0.02]  # their tolerances
        return Fit(Candidate(("drag", "x_offset")), np.ones(1), sizes, found.null.fit.local, 0.0, True)

    assert found.of_interest(pair(3.0, -0.5)) and found.of_interest(pair(0.5, 1.0))
    assert not found.of_interest(pair(3.0, 0.3)) and not found.of_interest(pair(0.7, 0.7))


def test_a_term_that_a_name_says_does_not_outdo_it() -> None:
    """The sensor's fault as a term is the same as its name, unless that name is withheld."""
    toy = Toy().record(x_offset=0.2)
    for withhold, known in (((), True), (("x_offset",), False)):
        found = search.run(toy, SETTINGS.asked(tuple(withhold), 0), laws=False)
        at = [item for item in found.structure if item.feature.channel == 0 and item.feature.text == "offset"]
        assert len(at) == 1 and at[0] in found.lasting()
        assert found.known_by_name(at[0]) is known
        assert (at[0] in found.nameless()) is not known


def test_one_window_that_leads_uphill_does_not_stop_a_fit() -> None:
    """Where a stop turns the slope of a window's initial state round, parameters and other windows still move."""
    toy = Toy().record(gain=1.1, drag=0.1)
    right = _at(toy)
    slopes = right.local_response.copy()
    rows = slice(int(toy.starts[3]), int(toy.starts[4]))
    slopes[:, rows] *= -1.0
    turned = Linearisation(toy, right.whitening, right.fit)
    turned.metric = Metric(right.whitening, toy.starts, slopes, toy.state_scales)
    local = right.fit.local.copy()
    local[3] += 1.0
    start = Fit(Candidate(("drag",)), np.array([1.09]), np.array([0.09]), local, np.inf, False)
    here = Linearisation(toy, right.whitening, start, turned)
    make = partial(Linearisation, toy, right.whitening, frozen=turned)
    assert _downhill(make, here, *here.step(), local=True) is None
    reached = fit_fully(toy, right.whitening, start, frozen=turned).fit
    assert reached.converged
    assert reached.magnitudes[0] == pytest.approx(0.1, abs=0.03)
    assert reached.parameters[0] == pytest.approx(1.1, abs=0.03)


def test_a_sensor_accused_by_name_and_by_term_is_named() -> None:
    """The term raises the alarm, the name alone would not: still the name is said."""
    settings = SETTINGS.model_copy(update={"alarm_gain": 1e6, "unnamed_gain": 1e6, "unnamed_sensor_gain": 18.0})
    found = search.run(Toy().record(gain=0.9, x_offset=0.08), settings, laws=False)
    assert found.kind == "single" and found.best is not None
    assert found.best.fit.candidate.names == ("x_offset",)


def test_a_fault_too_small_to_be_of_interest_is_not_called_one_without_a_name() -> None:
    """A name explains all that is beyond chance, of a size that no one asks for: no term takes its place."""
    toy = Toy(900, 6)
    toy.hypotheses = {name: replace(effect, tolerance=1.0) for name, effect in toy.hypotheses.items()}
    found = search.run(toy.record(leak=0.02), SETTINGS, laws=False)
    lead, term = found.singles[0], found.lasting()[0]
    assert lead.candidate.names == ("leak",) and not found.of_interest(lead)
    assert found.gain(lead) > SETTINGS.alarm_gain and term.gain > SETTINGS.unnamed_gain
    assert found.kind == "healthy"
    small = too_small(found)
    assert small is not None and small.name == "leak" and small.probability > 0.9
    assert small.magnitude == pytest.approx(0.02, rel=0.2)
    assert too_small(search.run(Toy(900, 6).record(), SETTINGS, laws=False)) is None
    almost = SETTINGS.model_copy(update={"alarm_gain": found.gain(lead) + 1.0, "unnamed_gain": 18.0,
                                         "unnamed_sensor_gain": 18.0})  # fmt: skip
    assert search.run(toy, almost, laws=False).kind == "healthy"  # nor where the name is a little short of chance's bar
    withheld = search.run(toy, SETTINGS.asked(("leak", "drag"), 0), laws=False)
    assert withheld.gain(withheld.singles[0]) + SETTINGS.law_gain < withheld.lasting()[0].gain
    assert withheld.kind == "law"


def test_an_onset_that_only_the_linear_scan_promises_is_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """A strong promise on a healthy machine; its simulated refit gains nothing."""
    toy = Toy(900, 6, seed=3).record(seed=53)
    real = search.scan_all

    def promising(*given: object) -> list[Variant]:
        return [replace(variant, gain=500.0) for variant in real(*given)]  # type: ignore[arg-type]

    monkeypatch.setattr(search, "scan_all", promising)
    assert search.run(toy, SETTINGS, laws=False).kind == "healthy"


def test_a_refit_that_found_no_way_down_gets_sensitivities_of_its_own() -> None:
    toy = Toy(2000, 10).record(leak=0.15)
    found = prepare(toy, SETTINGS)
    null = found.null.fit
    stuck = Fit(Candidate(("leak",)), null.parameters, np.zeros(1), null.local, null.objective, False)
    freed = singles._unstuck(found, stuck)
    assert freed.magnitudes[0] == pytest.approx(0.15, rel=0.1)
    assert found.gain(freed) > 100.0
    done = replace(stuck, converged=True)
    assert singles._unstuck(found, done) is done
