"""Laws: what was planted is found with its exponent and coefficient; nothing is found on a healthy twin."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dieseltwin.discovery.laws import search as law_search
from dieseltwin.discovery.laws.grammar import (
    Factor,
    Form,
    arguments,
    describe,
    factors,
    lagged,
    operators,
    orifice,
    played,
    rounded,
    unit_of,
)  # fmt: skip
from dieseltwin.discovery.laws.ranking import Ranked, rank
from dieseltwin.discovery.laws.refit import Refit, refit_all_laws, spread_over_forms, start_of
from dieseltwin.discovery.laws.responses import Responses
from dieseltwin.discovery.laws.twin import LawTwin, Placed
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.score import without_parameters
from dieseltwin.discovery.twins.interface import Lanes, Parameter, Point, Twin
from dieseltwin.discovery.twins.simple import Model, SimpleTwin
from dieseltwin.errors import InputError
from tests.discovery.toy import null_fit

NOISE_V = 0.02
ROOT = Factor("power", ("h_1",), (1.0,), 0.5, ("m",))


def _names(form):
    return {name for factor in form.factors for name in factor.variables}


def _root(level):
    return np.sqrt(np.maximum(level, 0.0))


def _rates(x, u, p, s, e):
    q_1, q_2 = p.k_1 * _root(x.h_1), p.k_2 * _root(x.h_2)
    return s("upper_balance", p.k_0 * u.pump - q_1), s("lower_balance", q_1 - q_2)


def _readings(x, u, p, s, e):
    return x.h_1, x.h_2


TANKS = Model(
    states={"h_1": 1.0, "h_2": 1.0},
    parameters=tuple(Parameter(f"k_{i}", 0.06, 0.06, "1/s", 0.005) for i in range(3)),
    inputs=("pump",),
    channels=("level_1", "level_2"),
    rates=_rates,
    readings=_readings,
    points=(
        Point("upper_balance", "upper_tank", False, "m/s", ("h_1",), 0.01),
        Point("lower_balance", "lower_tank", False, "m/s", ("h_1", "h_2"), 0.01),
    ),
    units={"h_1": "m", "h_2": "m", "pump": "V"},
    nearest={"level_1": "h_1", "level_2": "h_2"},
)
TRUTH = np.array([0.05, 0.06, 0.055])


def _tanks(seed: int, placed: Placed | None = None, n: int = 600, window_s: float = 200.0) -> SimpleTwin:
    """A recording of the tanks, with a law that the twin doesn't know."""
    rng = np.random.default_rng(seed)
    pump = np.clip(2.5 + 0.5 * np.cumsum(rng.normal(size=n // 20) * 0.9), 1.0, 4.5).repeat(20)
    time = 4.0 * np.arange(n)
    plant: Twin = SimpleTwin(TANKS, time, {"pump": pump}, np.zeros((n, 2)))
    parameters = TRUTH
    if placed is not None:
        plant = LawTwin(plant, [placed])
        parameters = np.append(TRUTH, abs(placed.coefficient))
    clean = plant.simulate(Lanes(parameters[None], np.array([[[4.0, 4.0]]])))[0]
    measured = clean + NOISE_V * rng.normal(size=clean.shape)
    return SimpleTwin(TANKS, time, {"pump": pump}, measured, window_s)


def _null(twin: SimpleTwin) -> Linearisation:
    return null_fit(twin, Whitening.of(twin.measured, twin.noise(), twin.starts))


def _search(twin: Twin, at: Linearisation, screened: tuple[str, ...] | None = None) -> law_search.Law | None:
    found = law_search.LawSearch(twin, at)
    return None if found.best(screened) is None else found.law()


def test_planted_leak_is_found_with_exponent_and_coefficient():
    true = Factor("power", ("h_2",), (1.0,), 2.0, ("m",))
    twin = _tanks(1, Placed(Form("lower_balance", (true,)), -0.002))
    at = _null(twin)
    found = _search(twin, at)
    assert found is not None and found.site == "lower_tank"
    (placed,) = found.placed
    (factor,) = placed.form.factors
    at_2_m = placed.coefficient * factor.value({"h_2": 2.0})
    assert at_2_m == pytest.approx(-0.008, rel=0.1) and placed.form.point == "lower_balance"
    assert factor.variables == ("h_2",) and factor.shape == 2.0
    reference = factor.references[0]
    assert abs(placed.coefficient + 0.002 * reference**2) < 3.0 * found.std
    readings = at.whitening.present.sum()
    assert at.fit.objective - found.gain < 1.1 * readings < at.fit.objective
    assert "m/s" in found.text and "h_2" in found.text
    assert found.curve is not None and np.all(found.curve.low <= found.curve.high)
    assert np.allclose(found.parameters, TRUTH, rtol=0.02)
    law = LawTwin(twin, found.placed)
    values = np.append(found.parameters, abs(placed.coefficient))
    residual = twin.measured - law.simulate(Lanes(values[None], found.local[None]))[0]
    assert np.std(residual) == pytest.approx(NOISE_V, rel=0.1)


def test_a_root_leak_upstream_keeps_its_exponent():
    """sqrt(h_1) out of the upper tank and out of the lower tank's inflow are one and the same."""
    twin = _tanks(3, Placed(Form("upper_balance", (ROOT,)), -0.006))
    found = _search(twin, _null(twin), screened=("upper_balance",))
    assert found is not None
    (placed,) = found.placed
    assert placed.form.factors[0].shape == 0.5
    reference = placed.form.factors[0].references[0]
    assert abs(placed.coefficient + 0.006 * np.sqrt(reference)) < 3.0 * found.std


def test_no_law_on_healthy_recordings(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(law_search, "_RENEWALS", 0)
    alarms = 0
    for seed in range(20):
        twin = _tanks(100 + seed, n=400)
        alarms += _search(twin, _null(twin)) is not None
    assert alarms == 0


def test_port_rule():
    twin = _tanks(5, Placed(Form("upper_balance", (ROOT,)), -0.006), n=200)
    at = _null(twin)
    lanes = at.fit.lanes()
    ranked = rank(twin, Responses(at, lanes), {**twin.variables(lanes), "time_s": twin.time_s})
    assert ranked
    for item in ranked:
        for placed in item.placed:
            assert _names(placed.form) <= set(arguments(twin.points[item.index]))
            assert "pump" not in _names(placed.form)
    assert "h_2" not in arguments(twin.points[0])


def test_responses_are_the_metric():
    """Norm and gradient of a feature from the impulse responses are those of its own simulated response."""
    twin = _tanks(7, n=200, window_s=100.0)  # few enough samples for a knot at each
    at = _null(twin)
    responses = Responses(at, at.fit.lanes())
    features = np.random.default_rng(0).normal(size=(3, 200)).cumsum(axis=1)
    projected = at.metric.project(responses.signals(1, features))
    direct = without_parameters(at, projected)[:, : projected.shape[1]]  # the readings' rows
    point = responses.point(1)
    values = point.at_knots(features)
    norms = np.einsum("kr,kr->k", direct, projected)
    assert point.norms(values) == pytest.approx(norms, rel=1e-3)
    assert np.diag(point.products(values, values)) == pytest.approx(norms, rel=1e-3)
    gradients = direct @ at.projected_residual
    assert point.gradients(values) == pytest.approx(gradients, rel=0.02, abs=0.02 * float(np.sqrt(norms.max())))


class _Plain:
    """A twin that can't evaluate laws inside its simulation."""

    def __init__(self, twin: SimpleTwin) -> None:
        self._twin = twin

    def __getattr__(self, name: str):
        if name in ("simulate_with_laws", "trajectories"):
            raise AttributeError(name)
        return getattr(self._twin, name)


def test_signals_settle_to_the_law():
    placed = Placed(Form("upper_balance", (ROOT,)), -0.006)
    base = _tanks(9, n=200)
    lanes = Lanes(np.append(TRUTH, 0.006)[None], base.first_local()[None])
    inside = LawTwin(base, [placed]).simulate(lanes)
    settled = LawTwin(_Plain(base), [placed]).simulate(lanes)
    without = base.simulate(replace(lanes, parameters=TRUTH[None]))
    assert np.max(np.abs(settled - inside)) < 0.01 * np.max(np.abs(inside - without))


def test_law_as_signals_is_refitted_alike():
    placed = Placed(Form("lower_balance", (Factor("power", ("h_2",), (1.0,), 2.0, ("m",)),)), -0.0005)
    twin = _tanks(1, placed)
    plain = _Plain(twin)
    whitening = Whitening.of(twin.measured, twin.noise(), twin.starts)
    at, readings = null_fit(plain, whitening), whitening.present.sum()
    found = _search(plain, at, screened=("lower_balance",))
    assert found is not None and found.site == "lower_tank"
    assert "h_2" in _names(found.placed[0].form) and at.fit.objective > 1.3 * readings
    assert at.fit.objective - found.gain < 1.1 * readings


def test_the_deviation_of_a_law_holds_what_other_forms_say_of_its_size():
    """Half a percent by itself; a form that says ten percent more, as good a one, makes it seven."""
    twin = _tanks(1)
    at = _null(twin)
    variables = {"h_2": np.linspace(1.0, 2.0, len(twin.time_s))}
    square = Form("lower_balance", (Factor("power", ("h_2",), (1.0,), 2.0, ("m",)),))

    def refit(form: Form, coefficient: float) -> Refit:
        law = LawTwin(twin, (Placed(form, coefficient),))
        ranked = Ranked(1, "lower_tank", law.laws, 50.0, 10.0)
        return Refit(ranked, law, start_of(at, law), 50.0)

    best, alone = refit(square, -0.002), refit(Form("upper_balance"), -0.5)
    assert spread_over_forms(best.twin, best.fit, [(1.0, alone)], variables) == 0.0
    other = refit(square, -0.0022)
    both = [(1.0, alone), (1.0, other)]
    assert spread_over_forms(best.twin, best.fit, both, variables) == pytest.approx(0.1 / np.sqrt(2.0))
    assert spread_over_forms(best.twin, best.fit, [(0.01, other)], variables) == pytest.approx(0.01, rel=0.01)


def test_orifice():
    assert orifice(3.0, 1.0) == pytest.approx(1.0)  # choked
    assert orifice(1.0, 1.0) == 0.0
    assert orifice(1.0, 1.5) == -orifice(1.5, 1.0)
    flows = [float(orifice(p, 1.0)) for p in (1.05, 1.2, 1.5, 1.8)]
    assert all(a < b for a, b in pairwise(flows))


def test_operators():
    time = np.linspace(0.0, 5.0, 501)
    step = np.where(time > 1.0, 1.0, 0.0)
    assert lagged(step, time, 0.5)[-1] == pytest.approx(1.0, abs=1e-3)
    assert lagged(step, time, 0.5)[150] == pytest.approx(1.0 - np.exp(-1.0), abs=0.02)
    wave = np.sin(time)
    assert np.max(np.abs(played(wave, 0.2) - wave)) <= 0.1 + 1e-12
    assert played(wave, 0.0) == pytest.approx(wave)
    position = Point("u_egr", "egr_actuator", True, "-", ())
    assert {f.kind for f in operators(position, "%")} == {"lag", "dead_time", "play"}
    assert {f.kind for f in operators(replace(position, timed=False), "%")} == {"play"}
    fuel = Point("u_delta", "fuel_injection", True, "-", ())
    assert {f.kind for f in operators(fuel, unit_of("u_delta", {}))} == {"lag", "dead_time", "play"}
    assert not operators(Point("p_im", "intake_mass_balance", False, "Pa", ()), "Pa")


@pytest.mark.parametrize("name, unit", [("u_delta", "mg/cycle"), ("u_egr", "%"), ("p_im", "Pa"), ("n_e", "1/min")])
def test_units_follow_from_the_paper_s_names(name: str, unit: str):
    assert unit_of(name, {}) == unit


@pytest.mark.parametrize("value, expected", [(0.0123, 0.01), (47.0, 50.0), (951.0, 1000.0), (0.0, 1.0)])
def test_references_are_round(value: float, expected: float):
    assert rounded(value) == pytest.approx(expected)


def test_factors_have_text_and_finite_values():
    rng = np.random.default_rng(1)
    values = {
        "p_im": rng.uniform(1e5, 3e5, 50), "p_amb": np.full(50, 1e5), "T_im": rng.uniform(290, 330, 50),
        "v": rng.normal(size=50), "W_c": rng.uniform(0.1, 0.4, 50), "W_egr": rng.uniform(0.0, 0.1, 50),
    }  # fmt: skip
    units = {"v": "m/s", "p_im": "Pa", "p_amb": "Pa", "T_im": "K", "W_c": "kg/s", "W_egr": "kg/s"}
    known = {name: describe(name, v, units[name]) for name, v in values.items()}
    pool = factors(values, known)
    assert {f.kind for f in pool} >= {"power", "sign", "ratio", "difference", "orifice", "excess", "share", "head"}
    for factor in pool:
        assert np.all(np.isfinite(factor.value(values))), factor
        assert factor.text() and all(name in factor.text() for name in factor.variables)
    assert not any(f.variables == ("p_amb",) for f in pool)  # constants enter in pairs only


def test_simple_twin_refuses_what_does_not_fit():
    time = np.arange(10.0)
    with pytest.raises(InputError, match="inputs"):
        SimpleTwin(TANKS, time, {}, np.zeros((10, 2)))
    with pytest.raises(InputError, match="measured"):
        SimpleTwin(TANKS, time, {"pump": time}, np.zeros((10, 1)))
    with pytest.raises(InputError, match="time_s"):
        SimpleTwin(TANKS, time[::-1], {"pump": time}, np.zeros((10, 2)))


def test_simple_twin_is_a_twin():
    twin = _tanks(0, n=100)
    assert isinstance(twin, Twin)
    lanes = Lanes(np.tile(TRUTH, (3, 1)), np.tile(twin.first_local(), (3, 1, 1)))
    signal = np.zeros((3, 100))
    signal[1] = 0.01
    moved = twin.simulate(replace(lanes, lane_points=np.array([-1, 0, 0]), lane_signals=signal))
    shared = twin.simulate(replace(lanes, signals={"upper_balance": signal[1]}))
    assert np.array_equal(moved[0], moved[2])
    assert np.allclose(moved[1], shared[0]) and not np.allclose(moved[1], moved[0])


def test_what_was_refitted_for_some_points_is_known_for_all(monkeypatch: pytest.MonkeyPatch):
    """The best law of the likely points stays the best of all, and none of its forms is refitted again."""
    twin = _tanks(1, Placed(Form("lower_balance", (Factor("power", ("h_2",), (1.0,), 2.0, ("m",)),)), -0.002))
    asked: list[list[object]] = []

    def noted(*given):
        asked.append([item.key for item in given[3]])
        return refit_all_laws(*given)

    monkeypatch.setattr(law_search, "refit_all_laws", noted)
    found = law_search.LawSearch(twin, _null(twin))
    first = found.best(("lower_balance",))
    narrow = len(asked)
    assert first is not None and found.best() is first
    keys = [key for keys in asked for key in keys]
    assert len(set(keys)) == len(keys) > 0
    assert any(key[0][0] != "lower_balance" for keys in asked[narrow:] for key in keys)


def test_lanes_settle_together_as_one_by_one():
    """Lanes whose signal stays leave the rounds; a law without a size has a signal at once."""
    placed = Placed(Form("lower_balance", (Factor("power", ("h_2",), (1.0,), 2.0, ("m",)),)), -0.0005)
    base = _tanks(1, placed, n=200)
    law = LawTwin(_Plain(base), [placed])
    start = start_of(null_fit(_Plain(base), Whitening.of(base.measured, base.noise(), base.starts)), law)
    lanes = start.lanes()
    sizes = np.array([1.0, 1.0001, 1.3, 0.0])
    many = replace(lanes, parameters=np.tile(lanes.parameters, (4, 1)), local=np.tile(lanes.local, (4, 1, 1)))
    many.parameters[:, -1] *= sizes
    together = law.simulate(many)
    for k in range(4):
        one = replace(lanes, parameters=many.parameters[k : k + 1])
        alone = LawTwin(_Plain(base), [placed]).simulate(one)[0]
        assert np.max(np.abs(together[k] - alone)) < 1e-5 * np.max(np.abs(alone))
    assert np.max(np.abs(together[1] - together[0])) > 1e-9  # a difference is more than what is left to settle


def test_what_stands_still_in_each_recording_is_no_argument_of_a_law():
    """Two functions of the weather of two recordings are two sizes: huge, and cancelling but for these."""
    weather = np.repeat([280.0, 295.0], 50)
    together = describe("T_amb", weather, "K", (slice(0, 50), slice(50, 100)))
    assert not together.thresholds and not factors(["T_amb"], {"T_amb": together})
    drifting = weather + np.linspace(0.0, 5.0, 100)
    assert describe("T_amb", drifting, "K", (slice(0, 50), slice(50, 100))).thresholds
    assert describe("T_amb", weather, "K", (slice(0, 100),)).thresholds  # one recording in which it moved
