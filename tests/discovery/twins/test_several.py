"""Several recordings as one twin: it is its parts, one behind the other."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import cast

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import first_fit, parameter_lanes
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import OverRecordings, WithSignals, single
from dieseltwin.discovery.twins.several import Occasion, SeveralTwin, profiles_of, ways_to_differ
from dieseltwin.discovery.verdict.over_recordings import profile_words
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.circumstances import CORRECTED
from dieseltwin.recordings.dates import NAME, ORDER, Dated
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive


@pytest.fixture(scope="module")
def twin() -> SeveralTwin:
    parts = [EngineTwin(recording(drive(40.0, seed=k)), we2011.PARAMETERS) for k in (1, 2)]
    return SeveralTwin(parts, [Occasion(0.0, 298.0), Occasion(30.0, 283.0)])


def test_it_is_a_twin_of_all_rows_with_health_of_each(twin: SeveralTwin):
    assert isinstance(twin, OverRecordings)
    first, second = twin.parts
    assert twin.measured.shape[0] == first.time_s.size + second.time_s.size == twin.time_s.size
    assert np.all(np.diff(twin.time_s) > 0) and len(twin.parameters) == 8
    assert twin.starts.size == first.starts.size + second.starts.size == len(twin.first_local())
    lane = first_fit(twin).lanes()
    assert {name: values.shape for name, values in twin.variables(lane).items()}["p_im"] == twin.time_s.shape
    assert twin.initial(lane.local).shape == (1, twin.starts.size, 3)


def test_every_lane_is_that_of_each_part(twin: SeveralTwin):
    fit = first_fit(twin)
    lanes, _ = parameter_lanes(twin, fit)
    lanes = replace(lanes, magnitudes={"boost_leak": np.full(lanes.size, 1e-5)}, schedules={"boost_leak": twin.spread(
        np.array([0.0, 1.0]))})  # fmt: skip
    together = twin.simulate(lanes)
    for b in (0, 3, 7, lanes.size - 1):
        for r, (part, rows) in enumerate(zip(twin.parts, twin.rows, strict=True)):
            local = np.split(lanes.local[b], [twin.parts[0].starts.size])[r]
            alone = part.simulate(
                single(lanes.parameters[b, 4 * r : 4 * r + 4], local, magnitudes={"boost_leak": np.full(1, 1e-5 * r)})
            )[0]
            assert np.allclose(together[b, rows], alone, rtol=1e-9)
    assert not np.array_equal(together[1, twin.rows[0]], together[0, twin.rows[0]])  # health of the first recording
    assert np.array_equal(together[1, twin.rows[1]], together[0, twin.rows[1]])  # is nothing to the second


def test_lanes_that_all_differ_keep_their_order(twin: SeveralTwin):
    """Every effect had another one's response: what is the same in two lanes is found in sorted order."""
    sizes = {"vgt_offset": np.array([0.0, 0.0, 2.0]), "boost_leak": np.array([3e-5, 1e-5, 0.0])}
    base = first_fit(twin).lanes()
    lanes = replace(
        base, parameters=np.repeat(base.parameters, 3, axis=0), local=np.repeat(base.local, 3, axis=0), magnitudes=sizes
    )
    together = twin.simulate(lanes)
    for b in range(3):
        alone = replace(base, magnitudes={name: values[b : b + 1] for name, values in sizes.items()})
        assert np.allclose(together[b], twin.simulate(alone)[0], rtol=1e-9)


def test_profiles_of_a_year():
    year = [Occasion(90.0 * k, 290.0 + t) for k, t in enumerate((0.0, 10.0, -12.0, 1.0))]
    found = profiles_of(year)
    edges = {f"{way}:{k}" for way in ("begins", "ends") for k in (1, 2, 3)}
    spans = {f"{way}:{j}:{k}" for way in ("only", "gone") for j, k in ((1, 2), (1, 3), (2, 3))}
    assert set(found) == edges | spans | {"grows:0", "grows:1", "cold"}
    assert np.allclose(found["ends:2"], [1.0, 1.0, 0.0, 0.0])
    assert np.allclose(found["grows:0"], [0.0, 1 / 3, 2 / 3, 1.0])
    assert np.allclose(found["cold"], [10 / 22, 0.0, 1.0, 9 / 22])
    assert set(profiles_of(year[:2])) == {"begins:1", "ends:1"}  # that it grew, or comes with the cold, is the same
    assert set(ways_to_differ(year[:2])) == {"begins:1", "ends:1", "grows:0", "cold"}


def test_what_was_there_in_between_or_away_in_between_is_a_way_to_differ():
    """An exhaust leak in the first and third of three recordings without dates was a law of eta_c over the weather."""
    year = [Occasion(73.0 * k, 298.0) for k in range(4)]
    found = profiles_of(year)
    assert found["only:1:3"].tolist() == [0.0, 1.0, 1.0, 0.0] and found["gone:1:2"].tolist() == [1.0, 0.0, 1.0, 1.0]
    assert sum(name.startswith(("only", "gone")) for name in found) == 6
    many = profiles_of([Occasion(float(k), 298.0) for k in range(12)])
    assert not any(name.startswith(("only", "gone")) for name in many)
    some = recording(drive(20.0))
    days = [Dated(some, datetime(2026, month, 14, tzinfo=UTC), NAME) for month in (1, 3, 6, 9)]
    assert profile_words("only:1:3", days) == "was there from 2026-03-14 to 2026-06-14 alone"
    assert profile_words("only:2:3", days) == "was there on 2026-06-14 alone"
    assert profile_words("gone:1:2", days) == "was there, but not on 2026-03-14"
    undated = [Dated(some, datetime(1970, 1, 1 + k, tzinfo=UTC), ORDER) for k in range(4)]
    assert profile_words("gone:1:2", undated) == "was there, but not in recording 2"
    assert profile_words("ends:3", undated) == "was there up to recording 3 and isn't in recording 4 any more"


def test_circumstances_are_those_of_each_recording():
    parts = [LoggedTwin(recording(drive(40.0, seed=k)), we2011.PARAMETERS) for k in (1, 2)]
    twin = SeveralTwin(parts, [Occasion(0.0, 298.0), Occasion(30.0, 283.0)])
    assert {item.recording for item in twin.circumstances} == {0, 1}
    lanes = first_fit(twin).lanes()
    simulated = twin.simulate(lanes)[0]
    (response,) = twin.circumstance_responses(lanes, simulated, ["t_im_k@1"])
    moved = twin.under({"t_im_k@1": we2011.PARAMETERS.T_im + 0.5}, frozenset(), like=True)
    assert moved.values == {"t_im_k@1": we2011.PARAMETERS.T_im + 0.5} and moved.parts[0].values == parts[0].values
    change = moved.simulate(lanes)[0] - simulated
    assert not change[twin.rows[0]].any() and not response[twin.rows[0]].any()
    assert np.abs(change - 0.5 * response).max() < 0.05 * np.abs(change).max()


def test_the_compressor_is_one_in_all_recordings_of_other_weather():
    own = we2011.PARAMETERS.replace(k_cflow=0.5, k_cspeed=0.5)
    days = [recording(drive(40.0, seed=k)) for k in (1, 2, 3)]
    weather = ((own.p_cmap, own.T_cmap), (9e4, own.T_cmap), (9e4, 280.0))
    parts = [LoggedTwin(replace(day, p_amb_pa=p_amb, t_amb_k=t_amb), own)
             for day, (p_amb, t_amb) in zip(days, weather, strict=True)]  # fmt: skip
    twin = SeveralTwin(parts, [Occasion(30.0 * k, t_amb) for k, (_, t_amb) in enumerate(weather)])
    names = [item.name for item in twin.circumstances if item.kind == CORRECTED]
    assert names == ["corrected:k_cflow", "corrected:k_cspeed"]
    assert {item.recording for item in twin.circumstances if item.kind == CORRECTED} == {None}
    lanes = first_fit(twin).lanes()
    simulated = twin.simulate(lanes)[0]
    moved = twin.under({"corrected:k_cflow": 0.55}, frozenset(), like=True)
    assert moved.values == {"corrected:k_cflow": 0.55} and {part.engine.k_cflow for part in moved.parts} == {0.55}
    change, response = moved.simulate(lanes)[0] - simulated, twin.circumstance_responses(lanes, simulated, names)
    for rows in twin.rows[1:]:
        assert np.abs(change[rows] - 0.05 * response[0][rows]).max() < 0.05 * np.abs(change[rows]).max()
    assert not response[:, twin.rows[0]].any() and not response[1][twin.rows[1]].any() and response[1].any()


def test_windows_that_are_cut_under_other_circumstances_are_cut_there_alone():
    parts = [LoggedTwin(recording(drive(40.0, seed=k)), we2011.PARAMETERS) for k in (1, 2)]
    twin = SeveralTwin(parts, [Occasion(0.0, 298.0), Occasion(30.0, 283.0)])
    lanes, windows = first_fit(twin).lanes(), twin.starts.size
    before = twin.simulate(lanes)
    moved = twin.under({"t_im_k@1": we2011.PARAMETERS.T_im + 0.5}, frozenset())
    moved.split(np.ones(windows, dtype=bool), 4, moved.first_local())
    assert moved.starts.size > windows == twin.starts.size
    assert np.array_equal(twin.simulate(lanes), before, equal_nan=True)


def test_a_delay_is_no_finding_where_one_recording_does_not_know_when_a_command_was_given():
    given = LoggedTwin(recording(drive(40.0, seed=1)), we2011.PARAMETERS)
    open_clock = LoggedTwin(
        recording(drive(40.0, seed=2)), we2011.PARAMETERS, opened=frozenset({"time_shift:u_egr_pct"})
    )
    twin = SeveralTwin([given, open_clock], [Occasion(0.0, 298.0), Occasion(30.0, 283.0)])
    assert {point.name: point.timed for point in twin.points if not point.timed} == {"u_egr": False}


def test_a_twin_with_signals_answers_the_weather_with_them():
    twin = LoggedTwin(recording(drive(40.0, seed=1)), we2011.PARAMETERS)
    signals = {"W_t": np.full(twin.time_s.size, 0.1)}
    fixed, lanes = cast(LoggedTwin, WithSignals(twin, signals)), first_fit(twin).lanes()
    entered = replace(lanes, signals=signals)
    there = fixed.circumstance_responses(lanes, fixed.simulate(lanes)[0], ["p_amb_pa"])
    assert np.array_equal(there, twin.circumstance_responses(entered, twin.simulate(entered)[0], ["p_amb_pa"]))
    assert np.array_equal(fixed.trajectories(lanes)[0], twin.simulate(entered), equal_nan=True)


def test_one_recording_or_other_sensors_are_refused(twin: SeveralTwin):
    with pytest.raises(InputError, match="two or more"):
        SeveralTwin(twin.parts[:1], twin.occasions[:1])
    fewer = EngineTwin(recording(drive(40.0, seed=3)), we2011.PARAMETERS, ("p_im_pa", "p_em_pa", "omega_t_rad_s"))
    with pytest.raises(InputError, match="sensors"):
        SeveralTwin([twin.parts[0], fewer], twin.occasions)
