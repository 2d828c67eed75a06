"""Bad input gets a clear answer: swapped columns, few points, actuators that never move, which way they open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate, read_geometry
from dieseltwin.calibration.checks import actuators, check_points, conductances, egr_shut, filling_notes
from dieseltwin.calibration.outlying import without_slips
from dieseltwin.calibration.steady_model import ROWS, SteadyModel
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.steady_points import STATES, SteadyPoints, points
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points


@pytest.fixture(scope="module")
def few() -> SteadyPoints:
    """Sixty points."""
    return made_points(count=60)


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [("p_im_pa", "p_em_pa", "p_im_pa and p_em_pa"), ("w_c_kg_s", "w_egr_kg_s", "w_c_kg_s and w_egr_kg_s"),
     ("u_egr_pct", "u_vgt_pct", "u_egr_pct and u_vgt_pct")],
)  # fmt: skip
def test_swapped_columns_are_refused(few: SteadyPoints, a: str, b: str, words: str) -> None:
    swapped = few.with_columns(**{a: few[b], b: few[a]})
    with pytest.raises(InputError, match=words):
        check_points(swapped, "points.csv")


def test_right_columns_pass(few: SteadyPoints) -> None:
    assert check_points(few, "points.csv").size == few.size


def test_twelve_points_are_too_few(few: SteadyPoints) -> None:
    with pytest.raises(InputError, match="12 usable points; allowed: at least 20"):
        check_points(few.take(np.arange(12)), "points.csv")


def test_an_engine_at_rest_is_no_point(few: SteadyPoints) -> None:
    """A row of the engine standing, one cranked, one pulled along without fuel."""
    rows = np.arange(few.size)
    changed = few.with_columns(n_e_rpm=np.where(rows < 2, 120.0 * rows, few["n_e_rpm"]),
                               u_delta_mg=np.where(rows == 2, 0.0, few["u_delta_mg"]))  # fmt: skip
    left = check_points(changed, "points.csv")
    assert left.size == few.size - 3 and "3 points left out" in left.notes[-1]


def test_one_point_sixty_times_is_refused(few: SteadyPoints) -> None:
    with pytest.raises(InputError, match="1 different operating points in 60 rows"):
        check_points(few.take(np.zeros(60, dtype=int)), "points.csv")


def test_a_displacement_that_no_flow_fills_is_said(few: SteadyPoints) -> None:
    assert filling_notes(few, TRUTH) == []
    (note,) = filling_notes(few, TRUTH.replace(V_d=10.0 * TRUTH.V_d))
    assert "by 0.08" in note and note.code == "wrong_engine"


def test_directions_are_found(few: SteadyPoints) -> None:
    egr, vgt = actuators(few)
    assert (egr.opens, vgt.opens) == (1, 1)
    egr, vgt = actuators(few.with_columns(u_egr_pct=100.0 - few["u_egr_pct"], u_vgt_pct=100.0 - few["u_vgt_pct"]))
    assert (egr.opens, vgt.opens) == (-1, -1)
    assert "closes" in egr.sentence()


def test_one_wild_reading_hides_no_direction_and_is_named(few: SteadyPoints) -> None:
    """p_em of one point read ten times too high: by least squares the VGT's direction is lost (0.9 deviations)."""
    wild = few["p_em_pa"].copy()
    wild[7] *= 10.0
    slipped = few.with_columns(p_em_pa=wild)
    assert actuators(slipped)[1].opens == 1
    model = SteadyModel(TRUTH)
    assert without_slips(model, few, {})[1] == []
    kept, (note,) = without_slips(model, slipped, {})
    assert set(few.row) - set(kept.row) == {few.row[7]}
    assert note.affects == ("p_em_pa",) and f"data row {few.row[7]} lies far off" in note
    instead = float(note.split("p_em_pa at about ")[1].split()[0])
    assert instead == pytest.approx(few["p_em_pa"][7], rel=0.1)


def test_noise_about_a_kink_is_no_slip(few: SteadyPoints) -> None:
    """Where p_em is read below p_im the model has no EGR flow, and no slope that tells it from one."""
    p_em = few["p_em_pa"].copy()
    nearest = int(np.argmin(p_em / few["p_im_pa"]))
    p_im = few["p_im_pa"].copy()
    p_im[nearest] = 1.001 * p_em[nearest]
    flow = few["w_egr_kg_s"].copy()
    flow[nearest] = np.median(flow)
    air = few["w_c_kg_s"] + few["w_egr_kg_s"] - flow
    model = SteadyModel(TRUTH)
    bent = few.with_columns(p_im_pa=p_im, w_egr_kg_s=flow, w_c_kg_s=air)
    residual = model.relations(bent, bent.states(), {}).residual[0, nearest, ROWS.index("egr_flow")]
    assert residual > 1.0
    kept, notes = without_slips(model, bent, {})
    assert kept.size == few.size and notes == []


def test_a_missing_reading_is_in_no_balance(few: SteadyPoints) -> None:
    """The compressor's power at a missing p_im was a number, 0 W, and the error of the balance 170 %."""
    x = few.states()
    x[0, STATES.index("p_im_pa")] = np.nan
    x[1, STATES.index("p_em_pa")] = np.nan
    balances = SteadyModel(TRUTH).relations(few, x, {}).residual[0]
    missing = {row: np.isnan(balances[:2, i]).tolist() for i, row in enumerate(ROWS)}
    assert missing == {"cylinder_flow": [True, False], "turbine_flow": [False, True], "turbo_power": [True, True],
                       "compressor_flow": [True, False], "egr_flow": [True, True], "exhaust_temperature": [True, True]}
    assert np.isfinite(balances[2:]).all()


def test_a_turbo_at_rest_and_an_error_code_are_no_readings(few: SteadyPoints) -> None:
    speed, flow = few["omega_t_rad_s"].copy(), few["w_egr_kg_s"].copy()
    speed[3], flow[4] = 0.0, -9999.0
    made = points({**few.columns, "omega_t_rad_s": speed, "w_egr_kg_s": flow})
    assert np.isnan(made["omega_t_rad_s"][3]) and np.isnan(made["w_egr_kg_s"][4])
    assert [word for word in ("omega_t_rad_s", "w_egr_kg_s") if any(word in note for note in made.notes)] == [
        "omega_t_rad_s", "w_egr_kg_s"]  # fmt: skip


def test_copies_count_once(few: SteadyPoints) -> None:
    copied = check_points(few.take(np.tile(np.arange(30), 2)), "points.csv")
    assert copied.row.tolist() == few.row[:30].tolist()
    assert copied.notes == ("30 of 60 points are copies of others, digit by digit, and count once",)
    with pytest.raises(InputError, match="15 usable points; allowed: at least 20"):
        check_points(few.take(np.tile(np.arange(15), 4)), "points.csv")


def test_constant_vgt_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STARTS", 0)
    found = calibrate(made_points(count=40, u_vgt_pct=40.0), we2011.PARAMETERS, GEOMETRY)
    assert any("not identifiable: u_vgt_pct doesn't move" in note for note in found.notes)
    assert "c_vgt1" not in {c.name for c in found.coefficients}
    assert found.engine.c_vgt1 == we2011.PARAMETERS.c_vgt1


def test_shut_egr_is_stated(monkeypatch: pytest.MonkeyPatch, few: SteadyPoints) -> None:
    monkeypatch.setattr(module, "STARTS", 0)
    shut = few.with_columns(w_egr_kg_s=np.zeros(few.size), w_c_kg_s=few["w_c_kg_s"] + few["w_egr_kg_s"],
                            u_egr_pct=np.zeros(few.size))
    assert egr_shut(shut)
    found = calibrate(shut.take(np.arange(40)), we2011.PARAMETERS, GEOMETRY)
    assert any("EGR valve is shut in every point" in note for note in found.notes)
    assert not {c.name for c in found.coefficients} & {"A_egrmax", "c_egr1", "c_egr3", "Pi_egropt"}


@pytest.mark.thorough
def test_fuel_in_kg_h_under_mg_is_asked_about_and_a_missing_ambient_said(few: SteadyPoints) -> None:
    """27 mg or 27 kg/h: both could be, but not with this exhaust."""
    right = calibrate(few.with_columns(p_amb_pa=few["p_amb_pa"] - 100.0), we2011.PARAMETERS)
    assert not any("another unit" in note or "the ambient" in note for note in right.notes)
    hourly = 1e-6 * few["u_delta_mg"] * few["n_e_rpm"] * 6 / 120.0 * 3600.0
    base = we2011.PARAMETERS
    plain = few.with_columns(u_delta_mg=hourly, p_amb_pa=np.full(few.size, base.p_amb),
                             t_amb_k=np.full(few.size, base.T_amb))  # fmt: skip
    said = " ".join(calibrate(plain, base).notes)
    assert "exhaust_temperature: " in said and "fuel in kg/h under u_delta_mg" in said
    assert "the ambient of every point is the engine's own, 101.1 kPa and 298" in said


def test_geometry_file(tmp_path: Path) -> None:
    file = tmp_path / "geometry.yaml"
    file.write_text("bore_mm: 130\nstroke_mm: 162\nn_cyl: 6\nr_c: 19\n")
    engine = read_geometry(file, we2011.PARAMETERS)
    assert engine.V_d == pytest.approx(0.0129015, rel=1e-4)
    assert engine.r_c == 19.0
    file.write_text("bore_mm: 130\n")
    with pytest.raises(InputError, match="bore or stroke alone"):
        read_geometry(file, we2011.PARAMETERS)
    file.write_text("bor_mm: 130\n")
    with pytest.raises(InputError, match="bore_mm"):
        read_geometry(file, we2011.PARAMETERS)


@pytest.mark.parametrize(
    ("text", "words"),
    [("bore_mm: 130\nstroke_mm: 162\nn_cyl: six\n", r"geometry\.yaml: engine parameter n_cyl: got 'six'"),
     ("bore_mm: 130\nstroke_mm: 162\nn_cyl: -6\n", r"geometry\.yaml: engine parameter n_cyl: got -6"),
     ("bore_mm: 130\nstroke_mm: 162\ndisplacement_l: 12.9\n", "got bore_mm and stroke_mm beside displacement_l"),
     ("V_d: 0.0129\ndisplacement_l: 12.9\n", "got displacement_l beside V_d; allowed: the displacement once"),
     ("bore_mm: 1300\nstroke_mm: 1620\n", r"geometry\.yaml: bore_mm, stroke_mm: engine parameter V_d: got 12.9")],
)  # fmt: skip
def test_a_geometry_that_cannot_be_is_refused_by_what_was_typed(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "geometry.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=words):
        read_geometry(file, we2011.PARAMETERS)


def test_a_geometry_may_be_a_mapping() -> None:
    engine = read_geometry({"displacement_l": 4.4, "n_cyl": 4}, we2011.PARAMETERS)
    assert (engine.V_d, engine.n_cyl) == (0.0044, 4)
    with pytest.raises(InputError, match="geometry: engine parameter n_cyl: got 0"):
        read_geometry({"displacement_l": 4.4, "n_cyl": 0}, we2011.PARAMETERS)


@pytest.mark.parametrize(
    ("call", "words"),
    [(lambda frame: dt.calibrate(frame, geometry=3), "geometry: got a int; allowed: a YAML file, a mapping"),
     (lambda frame: dt.calibrate(frame, 5), "base: got a int; allowed: we2011"),
     (lambda frame: dt.calibrate(frame, ["we2011"]), "base: got a list"),
     (lambda frame: dt.calibrate(frame, noise_pct="1"), "--noise: got 1; allowed: 0 to 20 %"),
     (lambda frame: dt.calibrate(frame, seed=1.5), "--seed: got 1.5; allowed: a whole number"),
     (lambda frame: dt.imply(frame, None), "engine: got a NoneType; allowed: what `discover` found"),
     (lambda frame: dt.imply(frame, we2011.PARAMETERS), "engine: got a EngineParameters")],
)  # fmt: skip
def test_python_arguments_of_another_kind_are_refused(few: SteadyPoints, call: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        call(pd.DataFrame(dict(few.columns)))


def test_the_fuel_is_that_of_all_cylinders(few: SteadyPoints) -> None:
    """Air flow and EGR flow in each other's column: four cylinders burn two thirds of what six do of one injection."""
    four, six = (conductances(few, cylinders)[1] for cylinders in (4, 6))
    fuel = 1e-6 / 120.0 * few["u_delta_mg"] * few["n_e_rpm"]
    assert np.exp(six - four) == pytest.approx((few["w_c_kg_s"] + 6.0 * fuel) / (few["w_c_kg_s"] + 4.0 * fuel))
    little = few.with_columns(w_c_kg_s=few["w_egr_kg_s"], w_egr_kg_s=few["w_c_kg_s"])
    scarce = np.median(little["w_c_kg_s"] / (14.57 * fuel))  # cylinders that this air would do for
    check_points(little, "points.csv", int(scarce))
    with pytest.raises(InputError, match="w_c_kg_s and w_egr_kg_s"):
        check_points(little, "points.csv", int(scarce) + 2)


def test_infinite_cells_count_as_missing_and_are_said(few: SteadyPoints) -> None:
    flow = few["w_c_kg_s"].copy()
    flow[[3, 5]] = np.inf
    speed = few["n_e_rpm"].copy()
    speed[7] = np.inf
    made = points({**few.columns, "w_c_kg_s": flow, "n_e_rpm": speed})
    assert sorted(made.notes) == [
        "1 infinite values of n_e_rpm count as missing", f"1 of {few.size} rows are left out: an input is missing",
        "2 infinite values of w_c_kg_s count as missing",
    ]  # fmt: skip
    assert np.isnan(made["w_c_kg_s"]).sum() == 2 and made.size == few.size - 1


def test_a_recorded_charge_temperature_is_no_other_unit(few: SteadyPoints, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model's charge has one temperature: how the recorded one varies is never explained, and says no unit."""
    monkeypatch.setattr(module, "STARTS", 0)
    warm = few.with_columns(t_im_k=300.0 + 20.0 * np.random.default_rng(3).uniform(size=few.size))
    found = calibrate(warm, TRUTH, GEOMETRY)
    assert found.fits["T_im"].coefficient_of_determination < 0.5  # it is read as it likes
    assert not any("T_im" in note and "another unit" in note for note in found.notes)
