"""Columns with our names in another unit: what can't be told by a range is told by balances, in a note."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.recordings.guess.physics import exhaust_line
from dieseltwin.recordings.reader import recording
from dieseltwin.recordings.unit_checks import unit_notes

P_AMB = 101_300.0
WRONG = {
    "p_im_pa": ("gauge", lambda x: x - P_AMB, "p_im_pa comes down to"),
    "p_em_pa": ("gauge", lambda x: x - P_AMB, "p_em_pa comes down to"),
    "omega_t_rad_s": ("Hz", lambda x: x / (2.0 * np.pi), "wheel of"),
    "w_egr_kg_s": ("kg/min", lambda x: 60.0 * x, "of the charge"),
    "t_em_k": ("degF", lambda x: 1.8 * x - 459.67, "K at no fuel, far below"),
    "u_delta_mg": ("g, of a large engine", lambda x: 8e-3 * x, "is this g or kg"),  # of a lorry's it is refused
}


@pytest.fixture(scope="module")
def drive(trace: pd.DataFrame) -> pd.DataFrame:
    return trace.assign(p_amb_pa=P_AMB)


def test_a_good_recording_has_no_such_notes(drive):
    assert recording(drive).notes == ()


@pytest.mark.parametrize("column", WRONG)
def test_a_wrong_unit_that_ranges_allow_is_noted(drive, column):
    _, wrong, text = WRONG[column]
    wronged = drive.assign(**{column: wrong(drive[column])})
    usual = {"t_em_k": drive["t_em_k"] > 560.0, "w_egr_kg_s": drive["w_egr_kg_s"] < 0.015}
    if column in usual:  # cold rows, and so much EGR, are refused
        wronged = wronged[usual[column]].reset_index(drop=True)
        wronged["time_s"] = 0.2 * np.arange(len(wronged))
    if column in ("p_im_pa", "p_em_pa"):  # of a truck that is never idle; one that is is refused by its median
        wronged = wronged[wronged[column] > 1.5e4].reset_index(drop=True)
        wronged["time_s"] = 0.2 * np.arange(len(wronged))
        wronged[column] += 5e4 - min(5e4, float(wronged[column].median()) - 1e3)
    notes = recording(wronged, sensors=()).notes
    assert any(text in note for note in notes), notes


def test_the_exhausts_line_without_fuel_lies_near_the_intake(drive):
    columns = {name: drive[name].to_numpy() for name in drive}
    line = exhaust_line(columns, 6)
    assert line is not None and 290.0 < line[0] < 420.0 and 1e4 < line[1] < 1.8e4 and line[2] < 10.0
    columns["u_delta_mg"] = 2.0 * columns["u_delta_mg"]  # nor does it depend on the unit of fuel
    again = exhaust_line(columns, 6)
    assert again is not None and again[0] == pytest.approx(line[0], abs=40.0)


@pytest.mark.parametrize(("unit", "taken"), [(lambda t: t, "degC"), (lambda t: 1.8 * t - 459.67, "degC")])
def test_channels_marks_an_exhaust_temperature_that_is_not_in_its_unit(tmp_path, drive, unit, taken):
    frame = drive.assign(**{f"Exhaust temperature before turbine [{taken}]": unit(drive["t_em_k"])}).drop(
        columns="t_em_k")  # fmt: skip
    frame.to_csv(tmp_path / "a.csv", index=False)
    warnings = dt.channels(tmp_path / "a.csv").proposal.guesses["t_em_k"].reading.warnings
    assert any("taken as degC" in text or "no fuel can heat" in text for text in warnings), warnings


@pytest.mark.parametrize("given", [True, False])
def test_a_direction_that_nothing_tells_is_to_be_checked(tmp_path, drive, given):
    frame = drive if given else drive.drop(columns=["p_em_pa", "w_egr_kg_s", "w_c_kg_s"])
    frame.to_csv(tmp_path / "a.csv", index=False)
    guesses = dt.channels(tmp_path / "a.csv").proposal.guesses
    for name in ("u_vgt_pct", "u_egr_pct"):
        texts = guesses[name].reading.warnings
        assert any("direction couldn't be checked" in text for text in texts) != given


@pytest.mark.parametrize("one, other, text", [
    ("p_im_pa", "p_em_pa", "p_em_pa lies below p_im_pa in"),
    ("u_egr_pct", "u_vgt_pct", "u_egr_pct and u_vgt_pct swapped"),
])  # fmt: skip
def test_columns_that_stand_for_each_other_are_noted(drive, one, other, text):
    shut = drive["time_s"].between(50.0, 90.0)  # a valve is shut now and then
    drive = drive.assign(**{name: drive[name].where(~shut, 0.0) for name in ("u_egr_pct", "w_egr_kg_s")})
    assert not [note for note in recording(drive).notes if "swapped" in note]
    swapped = drive.assign(**{one: drive[other], other: drive[one]})
    assert [note for note in recording(swapped).notes if text in note]


def test_a_fuel_flow_that_is_not_the_injected_fuel_is_noted(drive):
    columns = {name: drive[name].to_numpy() for name in drive}
    columns["w_f_kg_s"] = 1e-6 * columns["u_delta_mg"] * columns["n_e_rpm"] / 120.0 * 6
    assert unit_notes(columns, P_AMB, 6) == []
    assert unit_notes(columns | {"w_f_kg_s": 1.06 * columns["w_f_kg_s"]}, P_AMB, 6) == []
    (note,) = unit_notes(columns, P_AMB, 4)
    assert note.startswith("w_f_kg_s is 1.5 times what u_delta_mg gives 4 cylinders")
