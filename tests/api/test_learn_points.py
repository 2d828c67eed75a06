"""Settled points as a reference, by themselves and beside driving: they teach where `simulate` comes to rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.learning import LearnedResult
from dieseltwin.engine import MEASURED, EngineParameters, Inputs, we2011
from dieseltwin.engine import simulate as simulated
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import CorrectionTerm, corrections_in
from dieseltwin.errors import InputError
from dieseltwin.learning.files import load_learned
from dieseltwin.recordings.derived import STAND_IN_PA
from dieseltwin.recordings.noise import SETTLED_NOISE
from dieseltwin.recordings.standing import HOLD_S, of_all_weathers, standing
from dieseltwin.recordings.steady_points import points, read_points
from tests.api.simulated import drive

OWN = we2011.PARAMETERS.replace(eta_cmax=0.72, A_egrmax=3.6e-4)
INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")


def settled(engine: EngineParameters, count: int, seed: int) -> pd.DataFrame:
    """Operating points at which the simulated engine rests, with noise as on a test bed."""
    rng = np.random.default_rng(seed)
    u = rng.uniform([900.0, 60.0, 10.0, 30.0], [1800.0, 160.0, 60.0, 60.0], (count, 4))
    table = pd.DataFrame(u, columns=list(INPUTS))
    readings = at_rest(engine, table)
    for name in MEASURED:
        table[name] = readings[name].to_numpy() * (1.0 + SETTLED_NOISE[name] * rng.standard_normal(count))
    return table.assign(p_amb_pa=engine.p_amb, t_amb_k=engine.T_amb)


def at_rest(engine: EngineParameters, table: pd.DataFrame) -> pd.DataFrame:
    """What the engine's own simulation comes to rest at."""
    rows = table[list(INPUTS)].to_numpy()
    held = (Inputs(np.array([0.0, 0.2]), *(np.full(2, value) for value in row)) for row in rows)
    return pd.concat([simulated(one, engine, oxygen=False).iloc[[-1]] for one in held])


def test_an_engine_is_learned_from_settled_points_alone(tmp_path: Path) -> None:
    given, later = settled(OWN, 40, 3), settled(OWN, 12, 4)
    given.to_csv(tmp_path / "points.csv", index=False)
    found = dt.learn(tmp_path / "points.csv")
    assert isinstance(found, LearnedResult)
    assert found.sentence.startswith("Learned from 40 settled points; maps corrected: ")
    assert "learned from 40 settled points" in found.lines()
    known = load_learned(found.save(tmp_path / "mine.yaml"))
    assert known is not None and known.points == 40 and known.minutes == 0.0
    assert "from 40 settled points" in (tmp_path / "mine.yaml").read_text().splitlines()[0]
    before, after = at_rest(we2011.PARAMETERS, later), at_rest(known.engine, later)
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_c_kg_s", "w_egr_kg_s"):
        left = [float(np.median(np.abs(some[name].to_numpy() / later[name] - 1.0))) for some in (before, after)]
        assert left[1] < max(0.4 * left[0], 1.5 * SETTLED_NOISE[name]), (name, left)


def test_points_and_driving_in_any_order_are_one_reference(tmp_path: Path) -> None:
    given, driven = settled(OWN, 12, 5), drive(70.0, OWN)
    found = dt.learn([given, driven])
    assert isinstance(found, LearnedResult)
    assert found.sentence.startswith("Learned from 1.2 minutes of 1 recording and 12 settled points; ")
    file = dt.learn(given).save(tmp_path / "mine.yaml")
    more = dt.learn([driven, given], file)  # the points again: they count once
    assert isinstance(more, LearnedResult)
    np.testing.assert_array_equal(more.known.belief.mean, found.known.belief.mean)
    np.testing.assert_array_equal(more.known.belief.covariance, found.known.belief.covariance)


def test_points_of_two_days_are_two_recordings() -> None:
    table = settled(OWN, 8, 6)
    table["t_amb_k"] = [288.0] * 4 + [305.0] * 4
    days = standing(points(table, needed=()))
    assert [(len(day.pieces()), day.t_amb_k) for day in days] == [(4, 288.0), (4, 305.0)]
    assert all(day.standing and np.ptp(day.time_s[piece]) == HOLD_S for day in days for piece in day.pieces())
    np.testing.assert_array_equal(days[1].columns["p_im_pa"][:: int(HOLD_S) + 1], table["p_im_pa"][4:])


def test_a_point_of_another_day_is_no_reference_by_itself_and_no_reason_to_refuse_the_others() -> None:
    """It was "not enough excitation"; what reading did to the file was said once a day."""
    table = settled(OWN, 12, 6).assign(t_amb_k=[OWN.T_amb] * 11 + [OWN.T_amb + 8.0])
    table.loc[2, "w_c_kg_s"] = -1.0
    days = standing(points(table, needed=()))
    whole = of_all_weathers(days)
    assert [len(day.pieces()) for day in days] == [11, 1] and len(whole.pieces()) == 12
    assert whole.t_amb_k == OWN.T_amb and of_all_weathers(days[:1]) is days[0]
    found = dt.learn(table)
    assert isinstance(found, LearnedResult) and found.known.points == 12
    assert [line for line in found.lines() if "at or below 0" in line] == [
        "note: recording: 1 value of w_c_kg_s at or below 0 count as missing"]  # fmt: skip
    with pytest.raises(InputError, match="not enough excitation"):
        dt.learn(table[:5])


def test_few_points_are_not_said_to_count_the_other_way_by_chance() -> None:
    """Of a hundred sets of twelve points of an engine that is as it should be, five were refused."""
    table, rng = settled(OWN, 120, 3), np.random.default_rng(1)
    for _ in range(60):
        assert standing(points(table.iloc[rng.choice(120, 8, replace=False)], needed=()))


def test_what_no_reference_can_be_made_of_is_refused() -> None:
    table = settled(OWN, 8, 7)
    with pytest.raises(InputError, match="4 settled points; allowed: 5 or more"):
        standing(points(table[:4], needed=()))
    with pytest.raises(InputError, match=r"points in 8 weathers .* learn from the points of some days at a time"):
        standing(points(table.assign(t_amb_k=np.linspace(263.0, 313.0, 8)), needed=()))
    with pytest.raises(InputError, match=r"column u_vgt_pct: got the turbine's flow area falls .* turn it round"):
        dt.learn(settled(OWN, 60, 3).assign(u_vgt_pct=lambda t: 100.0 - t["u_vgt_pct"]))
    with pytest.raises(InputError, match=r"column w_egr_kg_s: got none .* go without: --sensors"):
        dt.learn(table.drop(columns="w_egr_kg_s"))


def test_weather_that_drifts_within_a_day_is_one() -> None:
    """Whatever round number it goes across; points in between two days go to that with more of them."""
    table = settled(OWN, 9, 8).assign(t_amb_k=[290.1, 291.0, 292.9, 291.5, 292.2, 290.5, 291.2, 290.8, 303.0])
    days = standing(points(table, needed=()))
    assert [len(day.pieces()) for day in days] == [8, 1]
    assert days[1].t_amb_k == 303.0


def test_copies_of_a_point_count_once() -> None:
    table = settled(OWN, 8, 6)
    (day,) = standing(points(pd.concat([table, table[:3]]), needed=()))
    assert len(day.pieces()) == 8 and any("3 of 11 points are copies" in note for note in day.notes)


def test_weather_that_no_column_gives_is_not_taken_for_read() -> None:
    """Points of 950 hPa and 285 K were an intake sensor that reads 5.9 kPa too little, by 7.7 standard deviations."""
    elsewhere = OWN.replace(p_amb=95_000.0, T_amb=285.0)
    found = dt.learn(settled(elsewhere, 40, 3).drop(columns=["p_amb_pa", "t_amb_k"]))
    assert isinstance(found, LearnedResult) and not found.known.suspected and found.known.converged
    assert not {"p_amb_pa", "t_amb_k"} & set(found.known.recordings[0].columns)


def test_an_ambient_that_some_cells_lack_is_that_of_the_others() -> None:
    """They had the engine's own, and were points of another day."""
    table = settled(OWN.replace(p_amb=92_000.0), 8, 6)
    table.loc[[0, 3], "p_amb_pa"] = np.nan
    assert [(len(day.pieces()), day.p_amb_pa) for day in standing(points(table, needed=()))] == [(8, 92_000.0)]


@pytest.mark.parametrize("assumed", [90_000.0, STAND_IN_PA])
def test_gauge_pressures_of_points_are_under_the_ambient_that_the_map_says(tmp_path: Path, assumed: float) -> None:
    table = settled(OWN, 8, 6)
    gauge = table["p_im_pa"] - OWN.p_amb
    table.drop(columns=["p_amb_pa", "p_im_pa"]).assign(boost=1e-3 * gauge).to_csv(tmp_path / "p.csv", index=False)
    channels = tmp_path / "map.yaml"
    channels.write_text(f"boost: {{column: p_im_pa, unit: kPa, via: gauge, ambient_pa: {assumed:.0f}}}\n")
    read = read_points(tmp_path / "p.csv", channels, OWN)
    ambient = OWN.p_amb if assumed == STAND_IN_PA else assumed
    assert read["p_amb_pa"] == pytest.approx(ambient) and read["p_im_pa"] == pytest.approx(gauge + ambient)
    (day,) = standing(read)
    assert day.p_amb_pa == pytest.approx(ambient) and day.made.follows == {"p_im_pa": {"p_amb_pa": 0}}


def test_learning_begins_at_corrections_that_an_engine_has(tmp_path: Path) -> None:
    """As of what `discover` repaired on points: more is learned of the maps, about where they were corrected to."""
    corrections = 0.015 * np.random.default_rng(9).standard_normal(len(basis().names)) * basis().usual
    corrected = OWN.replace(terms=(CorrectionTerm(coefficients=tuple(corrections)),))
    found = dt.learn(settled(corrected, 20, 10), corrected)
    assert isinstance(found, LearnedResult)
    assert any("learning begins there" in line for line in found.lines())
    assert corrections_in(found.known.base.terms) is None
    assert np.std(found.known.belief.coefficients - corrections) < 0.5 * np.std(corrections)
    again = load_learned(found.save(tmp_path / "mine.yaml"))
    assert again is not None and again.engine == found.engine
    known_further = tmp_path / "mine.yaml"  # forgot what it had begun at, and began at the siblings' maps
    for engine in (corrected, known_further):
        with pytest.raises(InputError, match="beside an engine whose maps are corrected"):
            dt.learn(settled(corrected, 8, 11), engine, siblings=[tmp_path / "mine.yaml"])
