"""A learned engine's compressor in weather that isn't that of its learning: by mass flow or corrected flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.discovery.discover import Prepared, prepare
from dieseltwin.discovery.fit_test import examine
from dieseltwin.discovery.likelihood.circumstances import Estimate, estimates
from dieseltwin.discovery.likelihood.fit import first_fit
from dieseltwin.discovery.reference.learn import learn_engine
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin, exponents_of
from dieseltwin.engine import EngineParameters, Inputs, simulate, we2011
from dieseltwin.learning.belief import HEALTH_AT, Belief, prior_belief
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.recordings.reader import Recording, recording
from dieseltwin.settings.defaults import default_search

BELIEFS = default_search().circumstances
REFERENCE = {"p_amb": 101_300.0, "T_amb": 293.0}
HIGH_UP = {"p_amb": 85_000.0, "T_amb": 275.0}
SENSORS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s")


def _recorded(engine: EngineParameters, seed: int, seconds: float = 150.0) -> Recording:
    rng, time = np.random.default_rng(seed), np.arange(0.0, seconds, 0.2)
    held = np.arange(0.0, seconds + 10.0, 5.0)
    levels = ((1000.0, 1700.0), (40.0, 170.0), (5.0, 45.0), (35.0, 70.0))
    inputs = Inputs(time, *(np.interp(time, held, rng.uniform(*ends, held.size)) for ends in levels))
    table = simulate(inputs, engine, oxygen=False)
    frame = table[["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *SENSORS]].copy()
    for name in SENSORS:
        frame[name] += 0.01 * frame[name].mean() * rng.standard_normal(time.size)
    return recording(frame.assign(p_amb_pa=engine.p_amb, t_amb_k=engine.T_amb, t_im_k=engine.T_im))


def _engine(k: float, **weather: float) -> EngineParameters:
    maps = {"p_cmap": REFERENCE["p_amb"], "T_cmap": REFERENCE["T_amb"], "k_cflow": k, "k_cspeed": k}
    return we2011.PARAMETERS.replace(**maps, **weather)


@pytest.fixture(scope="module")
def learned() -> LearnedEngine:
    """Learned in one weather, where mass flow and corrected flow are the same; maps known to 0.3 %."""
    healthy = _recorded(_engine(1.0, **REFERENCE), 1, 30.0)
    prior = prior_belief(we2011.PARAMETERS, 0.003)
    covariance = prior.covariance.copy()
    covariance[HEALTH_AT, HEALTH_AT] *= 1e-3
    return LearnedEngine(we2011.PARAMETERS, Belief(prior.mean, covariance), 0.02, (healthy,), {}, {healthy.sha256: 1.0})


def _judged(learned: LearnedEngine, k: float, **said: float) -> Prepared:
    return prepare(_recorded(_engine(k, **HIGH_UP), 2), learned.engine.replace(**said), learned=learned)


def _exponents(prepared: Prepared) -> dict[str, Estimate]:
    return {item.circumstance.column: item for item in estimates(prepared.found.null)}


@pytest.mark.parametrize("k", [0.0, 1.0])
def test_mass_flow_and_corrected_flow_are_told_and_neither_is_a_fault(learned: LearnedEngine, k: float):
    prepared = _judged(learned, k)
    told = _exponents(prepared)
    for name, sharp in (("k_cflow", 0.05), ("k_cspeed", 0.3)):
        assert told[name].std < sharp
        assert abs(told[name].value - k) < 3.0 * told[name].std
    assert max(item.gain for item in prepared.found.scored) < 18.0


def test_a_compressor_that_is_said_to_go_by_mass_flow_is_taken_at_its_word(learned: LearnedEngine):
    prepared = _judged(learned, 1.0, k_cflow=0.0, k_cspeed=0.0)
    assert not {"k_cflow", "k_cspeed"} & _exponents(prepared).keys()
    assert max(item.gain for item in prepared.found.scored) > 50.0


def test_where_the_weather_is_that_of_learning_nothing_is_open(learned: LearnedEngine):
    case = _recorded(_engine(1.0, **REFERENCE), 3, 30.0)
    assert exponents_of(case, learned.engine, BELIEFS) == ()
    colder = replace(case, t_amb_k=280.0)
    assert [item.column for item in exponents_of(colder, learned.engine, BELIEFS)] == ["k_cflow", "k_cspeed"]
    higher = replace(case, p_amb_pa=95e3)
    assert [item.column for item in exponents_of(higher, learned.engine, BELIEFS)] == ["k_cflow"]
    assert exponents_of(higher, we2011.PARAMETERS, BELIEFS) == ()


def test_identify_fits_a_compressor_by_corrected_flow(learned: LearnedEngine):
    case = _recorded(_engine(1.0, **HIGH_UP), 2)
    assert examine(case, learned.engine, SENSORS, learned).notes == ()
    raw = learned.engine.replace(k_cflow=0.0, k_cspeed=0.0)
    assert examine(case, raw, SENSORS, learned).notes != ()


def test_responses_are_those_of_the_simulation(learned: LearnedEngine):
    twin = LoggedTwin(_recorded(_engine(1.0, **HIGH_UP), 2, 40.0), learned.engine, belief=learned.belief)
    names = ["corrected:k_cflow", "corrected:k_cspeed"]
    lanes = first_fit(twin).lanes()
    simulated = twin.simulate(lanes)[0]
    for name, response in zip(names, twin.circumstance_responses(lanes, simulated, names), strict=True):
        moved = twin.under({name: 0.52}, frozenset(), like=True).simulate(lanes)[0] - simulated
        assert np.abs(moved - 0.02 * response).max(axis=0) / np.abs(moved).max(axis=0) == pytest.approx(0.0, abs=0.05)


@pytest.mark.thorough
def test_days_of_different_weather_show_how_the_compressor_goes():
    days = [_recorded(_engine(1.0, p_amb=p_amb, T_amb=T_amb), 4 + k, 120.0)
            for k, (p_amb, T_amb) in enumerate(((101_300.0, 305.0), (88_000.0, 275.0)))]  # fmt: skip
    known, found = learn_engine(days, we2011.PARAMETERS, 0.02)
    assert found.suspicions == ()
    assert known.exponents["k_cflow"].std < 0.15
    for name, item in known.exponents.items():
        assert abs(item.value - 1.0) < 3.0 * item.std, name
        assert getattr(known.engine, name) == item.value
