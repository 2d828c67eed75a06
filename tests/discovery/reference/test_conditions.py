"""Clocks and weather of a healthy engine's recordings: found before anything is learned, and believed of the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.discovery.discover import prepare
from dieseltwin.discovery.reference.conditions import (
    Clock,
    Exponents,
    clocks_of_all,
    exponents_together,
    open_of,
    recorded_twin,
)
from dieseltwin.discovery.reference.evidence import Learned
from dieseltwin.discovery.reference.joint import Joint
from dieseltwin.discovery.reference.learn import learn, learn_engine
from dieseltwin.discovery.reference.part import Part
from dieseltwin.discovery.reference.standing_part import parts_of
from dieseltwin.engine import EngineParameters, Inputs, simulate, we2011
from dieseltwin.learning.belief import MAPS_AT, prior_belief
from dieseltwin.learning.files import LearnedEngine, load_learned, save_learned
from dieseltwin.learning.weather import UNDECIDED, Exponent, of_own_weather
from dieseltwin.recordings.reader import Recording, recording
from dieseltwin.settings.defaults import default_search

MAP_RMS = 0.02
SENSORS = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k")
LABORATORY = we2011.PARAMETERS.model_dump()
ROWS_LATE = {"omega_t_rad_s": 1, "t_em_k": 1, "n_e_rpm": -1}  # of 0.2 s
DAYS = ({"p_amb": 101_300.0, "T_amb": 298.0}, {"p_amb": 94_000.0, "T_amb": 283.0})


def _driven(seed: int, seconds: float = 120.0, **constants: float):
    driving = draw_driving("random", seconds, LABORATORY, np.random.default_rng(seed))
    run = run_plant(driving, LABORATORY | constants)
    frame = read(run, driving, (), SensorSet.perfect(), 6, np.random.default_rng([seed, 1]))
    return frame.drop(columns=["p_amb_pa", "t_amb_k"], errors="ignore")


def _late(seed: int, **constants: float) -> Recording:
    frame = _driven(seed, **constants)
    for column, rows in ROWS_LATE.items():
        frame[column] = frame[column].shift(rows).bfill().ffill()
    return recording(frame.assign(p_amb_pa=we2011.PARAMETERS.p_amb, t_amb_k=we2011.PARAMETERS.T_amb))


@pytest.fixture(scope="module")
def learned() -> tuple[LearnedEngine, Learned]:
    return learn_engine([_late(1), _late(2)], we2011.PARAMETERS, MAP_RMS)


def test_clocks_are_found_and_are_neither_maps_nor_a_fault(learned: tuple[LearnedEngine, Learned]):
    known, found = learned
    assert found.converged and found.suspicions == ()
    assert known.clocks.keys() == ROWS_LATE.keys()
    assert known.clocks == pytest.approx({column: 0.2 * rows for column, rows in ROWS_LATE.items()}, abs=0.03)
    assert known.belief.health == pytest.approx(we2011.PARAMETERS.health(), rel=0.06)


def test_the_next_recording_is_judged_with_the_clocks_of_the_reference(
    learned: tuple[LearnedEngine, Learned], tmp_path
):
    save_learned(learned[0], tmp_path / "mine.yaml")
    known = load_learned(tmp_path / "mine.yaml")
    assert known is not None and known.clocks == learned[0].clocks
    twin = prepare(_late(3), known.engine, learned=known).found.twin
    assert twin.opened == {f"time_shift:{column}" for column in ROWS_LATE}
    assert twin.values["time_shift:t_em_k"] == pytest.approx(0.2)


def test_weather_that_no_column_gives_differs_from_day_to_day():
    twins = [recorded_twin(recording(_driven(k, **day)), we2011.PARAMETERS, MAP_RMS) for k, day in enumerate(DAYS)]
    for twin, day in zip(twins, DAYS, strict=True):
        assert {item.name for item in open_of(twin)} == {"p_amb_pa", "drift:p_amb_pa", "t_amb_k", "t_im_k"}
        assert twin.values.get("p_amb_pa", we2011.PARAMETERS.p_amb) == pytest.approx(day["p_amb"], abs=2500.0)


@pytest.mark.thorough
def test_a_charge_that_no_column_gives_may_differ_from_piece_to_piece():
    ambient = {"p_amb_pa": we2011.PARAMETERS.p_amb, "t_amb_k": we2011.PARAMETERS.T_amb}
    pieces = [
        recording(_driven(k, T_im=we2011.PARAMETERS.T_im + away).assign(**ambient))
        for k, away in enumerate((-4.0, 4.0))
    ]
    known, found = learn_engine(pieces, we2011.PARAMETERS, MAP_RMS)
    assert found.converged and found.suspicions == ()
    free = prior_belief(we2011.PARAMETERS, MAP_RMS).free
    away = known.belief.mean[MAPS_AT][free]  # the plant's maps are the twin's
    covariance = known.belief.covariance[MAPS_AT, MAPS_AT][np.ix_(free, free)]
    # as far as is said, or nearer; 8 K between the pieces, taken for a map, are 13
    assert away @ np.linalg.solve(covariance, away) < 1.0 * free.sum()


def test_a_charge_that_is_taken_wrongly_at_first_is_put_right_along_the_fit(monkeypatch: pytest.MonkeyPatch):
    def warm(*arguments):
        return recorded_twin(*arguments).under({"t_im_k": we2011.PARAMETERS.T_im + 45.0}, frozenset())

    monkeypatch.setattr("dieseltwin.discovery.reference.part.recorded_twin", warm)
    piece = recording(_driven(1).assign(p_amb_pa=we2011.PARAMETERS.p_amb, t_amb_k=we2011.PARAMETERS.T_amb))
    prior = prior_belief(we2011.PARAMETERS, MAP_RMS)
    part = Part(piece, we2011.PARAMETERS, prior, MAP_RMS)
    joint = Joint([part], prior)
    assert joint.fit(12)
    assert part.twin.values["t_im_k"] == pytest.approx(we2011.PARAMETERS.T_im, abs=12.0)
    shown = joint.at[0].conditions_at(joint.residuals[0])
    assert shown == pytest.approx(joint.at[0].applied, abs=0.2)


def test_a_reference_that_says_all_is_taken_as_it_is():
    frame = _driven(4).assign(p_amb_pa=we2011.PARAMETERS.p_amb, t_amb_k=we2011.PARAMETERS.T_amb, t_im_k=309.0)
    twin = recorded_twin(recording(frame), we2011.PARAMETERS, MAP_RMS)
    assert open_of(twin) == () and twin.values == {}
    assert twin.engine.T_im == 309.0  # the column's: the maps would be wrong by what it is off


def test_recordings_are_weighed_by_how_surely_they_say_a_clock():
    one, other, unsure = Clock("t_em_k", 0.2, 0.01), Clock("t_em_k", 0.1, 0.1), Clock("p_im_pa", 0.1, 0.05)
    late = clocks_of_all([(one, unsure), (other,)])
    assert late.keys() == {"t_em_k"} and late["t_em_k"] == pytest.approx(0.2, abs=0.002)
    assert clocks_of_all([(replace(one, std=0.06),)]) == {}


def _shown(value: float, std: float, by_map: float = 0.0) -> Exponents:
    return Exponents(("k_cflow",), np.array([value]), np.array([[std**2]]), np.array([[by_map]]))


def test_what_is_believed_of_an_exponent_counts_once_and_maps_that_are_open_widen_it():
    usual, maps = Exponent(UNDECIDED, default_search().circumstances.k_cflow), np.array([[1.0]])
    beliefs = {"k_cflow": usual}
    nothing, sharp = _shown(UNDECIDED, usual.std), _shown(0.98, 0.02)
    assert exponents_together([Exponents((), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 1)))], maps, beliefs) == {}
    said = exponents_together([nothing] * 5, maps, beliefs)["k_cflow"]
    assert (said.value, said.std) == pytest.approx((UNDECIDED, usual.std))
    alone = exponents_together([nothing, sharp], maps, beliefs)["k_cflow"]
    assert (alone.value, alone.std) == pytest.approx((0.98, 0.02))
    twice = exponents_together([sharp, sharp], maps, beliefs)["k_cflow"]
    assert twice.std == pytest.approx(0.02 / 2**0.5, rel=1e-2) and twice.value > 0.98  # the belief is in once
    beside = exponents_together([_shown(0.98, 0.02, 0.1), _shown(0.98, 0.02, 0.1)], maps, beliefs)["k_cflow"]
    assert beside.std == pytest.approx((0.1**2 + 0.02**2 / 2.0) ** 0.5, rel=0.03)
    of_type = exponents_together([_shown(0.9, 0.04)] * 2, maps, {"k_cflow": Exponent(0.9, 0.04)})["k_cflow"]
    assert (of_type.value, of_type.std) == pytest.approx((0.9, 0.04))  # what engines of the type say counts once, too


def _pedal(seed: int, kicked: bool, engine: EngineParameters = we2011.PARAMETERS) -> Recording:
    """Forty seconds in rows of 5 Hz; fuel and valves moved at once every two seconds, or calmly from row to row."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 40.0, 0.05 if kicked else 0.2)
    ends = ((60.0, 170.0), (5.0, 45.0), (40.0, 70.0))
    if kicked:
        at = np.searchsorted(np.cumsum(rng.uniform(1.6, 2.4, time.size)), time)
        levels = [rng.uniform(*pair, at.max() + 1)[at] for pair in ends]
    else:
        held = np.arange(0.0, 46.0, 6.0)
        levels = [np.interp(time, held, rng.uniform(*pair, held.size)) for pair in ends]
    inputs = Inputs(time, 1300.0 + 200.0 * np.sin(time / 7.0), *levels)
    frame = simulate(inputs, engine, oxygen=False).iloc[:: 4 if kicked else 1]
    frame = frame[["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *SENSORS]].reset_index(drop=True)
    for name in SENSORS:
        frame[name] += 0.004 * frame[name].mean() * rng.standard_normal(len(frame))
    return recording(frame.assign(p_amb_pa=engine.p_amb, t_amb_k=engine.T_amb, t_im_k=300.6))


def test_inputs_of_a_quick_pedal_may_have_moved_between_the_rows_of_a_reference():
    """Taken for straight, a healthy engine's were clocks that are off, and 1.9 times the noise was left."""
    quick, calm = (recorded_twin(_pedal(1, kicked), we2011.PARAMETERS, MAP_RMS) for kicked in (True, False))
    assert quick.between_rows and not quick.opened
    assert not calm.between_rows and not calm.opened


def test_whether_inputs_moved_between_the_rows_is_asked_once(monkeypatch: pytest.MonkeyPatch):
    """All is fitted anew about the exponents that two weathers show, and a recording may not be another by then."""
    engines = [we2011.PARAMETERS.replace(p_amb=p, T_amb=t) for p, t in ((101e3, 300.0), (93e3, 270.0))]
    days = [_pedal(k, kicked, engine) for k, (kicked, engine) in enumerate(zip((True, False), engines, strict=True), 1)]
    told: dict[str, list[tuple[bool | None, bool]]] = {day.sha256: [] for day in days}

    def asked(items, engine, prior, map_rms, beliefs, between_rows):
        parts = parts_of(items, engine, prior, map_rms, beliefs, between_rows)
        for item, moved, part in zip(items, between_rows, parts, strict=True):
            told[item.sha256].append((moved, part.twin.between_rows))
        return parts

    monkeypatch.setattr("dieseltwin.discovery.reference.learn.parts_of", asked)
    assert learn(days, of_own_weather(we2011.PARAMETERS, days), MAP_RMS).exponents
    assert told == {days[0].sha256: [(None, True), (True, True)], days[1].sha256: [(None, False), (False, False)]}
    calm = recorded_twin(days[1], engines[1], MAP_RMS, None, True)
    assert calm.between_rows  # whatever the recording shows by itself
