"""`identify` doesn't vouch for a fit that isn't one, and has no doubts about a recording that is sound."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.discovery import fit_test
from dieseltwin.discovery.fit_test import examine
from dieseltwin.engine import HEALTH, MEASURED, we2011
from dieseltwin.recordings.reader import recording

NOISE = dict(zip(MEASURED, (0.03, 0.03, 0.01, 0.05, 0.03, 0.03), strict=True))
INPUTS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"]


@pytest.fixture(scope="module")
def clean(trace: pd.DataFrame) -> pd.DataFrame:
    """Two minutes with the paper's noise."""
    return driven(trace, 1.0)


def driven(trace: pd.DataFrame, share: float) -> pd.DataFrame:
    """Two minutes with a share of the paper's noise."""
    rng, trace = np.random.default_rng(8), trace.iloc[:601]
    made = trace[INPUTS].copy()
    for name in MEASURED[:5]:
        made[name] = trace[name] + share * NOISE[name] * trace[name].mean() * rng.standard_normal(len(trace))
    return made


def test_sound_recordings_raise_no_doubt(clean: pd.DataFrame, trace: pd.DataFrame) -> None:
    assert dt.identify(clean, runs=1).warnings == []
    assert dt.identify(trace.iloc[:601], runs=1).warnings == []


def test_a_short_hole_in_an_input_is_no_reason_not_to_test(clean: pd.DataFrame) -> None:
    holes = clean.copy()
    holes.loc[200:202, "u_delta_mg"] = np.nan
    assert not examine(recording(holes), we2011.PARAMETERS, MEASURED[:5]).notes


@pytest.mark.parametrize(
    ("change", "affects"),
    [
        (lambda t: t.assign(time_s=0.9 * t["time_s"]), "time_s"),
        (lambda t: t.assign(p_em_pa=1.08 * t["p_em_pa"]), "p_em_pa"),
        (lambda t: t.assign(omega_t_rad_s=t["omega_t_rad_s"].shift(6, fill_value=t["omega_t_rad_s"][0])),
         "omega_t_rad_s"),
    ],
    ids=["clock", "gain", "late"],
)  # fmt: skip
def test_a_fault_of_the_recording_is_said_and_named(
    clean: pd.DataFrame, change: Callable[[pd.DataFrame], pd.DataFrame], affects: str
) -> None:
    notes = examine(recording(change(clean)), we2011.PARAMETERS, MEASURED[:5]).notes
    misfit = next(note for note in notes if note.code == "misfit")
    assert "doesn't fit this recording" in misfit and "dieseltwin discover" in misfit
    assert misfit.affects == (affects,)


@pytest.mark.thorough
def test_a_frozen_position_is_no_quiet_answer(clean: pd.DataFrame) -> None:
    found = dt.identify(clean.assign(u_egr_pct=float(clean["u_egr_pct"][0])), runs=1)
    assert "misfit" in {warning["code"] for warning in found.warnings}
    without = dt.identify(clean.assign(u_egr_pct=float(clean["u_egr_pct"][0])), runs=1, setup=dt.Setup(fit_test=False))
    assert not any("dieseltwin discover" in warning["text"] for warning in without.warnings)


def test_a_sensor_that_is_dead_for_one_part_is_left_out_there_alone(
    clean: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_test, "LONGEST_PART_S", 60.0)
    broken = clean.assign(t_em_k=clean["t_em_k"].where(clean["time_s"] > clean["time_s"].iloc[0] + 61.0))
    assert not examine(recording(broken), we2011.PARAMETERS, MEASURED[:5]).notes


def test_what_is_too_short_is_said_to_be_untested(clean: pd.DataFrame) -> None:
    short = examine(recording(clean.iloc[:200]), we2011.PARAMETERS, MEASURED[:5])
    assert [note.code for note in short.notes] == ["untested"] and not short.health


def test_health_beside_tolerances_holds_the_truth_where_sensors_are_off_within_theirs(trace: pd.DataFrame) -> None:
    quiet = driven(trace, 0.1)
    off = quiet.assign(p_em_pa=1.005 * quiet["p_em_pa"], p_im_pa=0.996 * quiet["p_im_pa"], t_em_k=quiet["t_em_k"] + 2.0)
    told = dt.identify(off, runs=1)
    assert told.warnings == []
    table, truth = told.table(), [getattr(we2011.FIELD, name) for name in HEALTH]
    assert ((table["tolerant_mean"] - truth).abs() / table["tolerant_std"]).max() < 2.0
    level = ["A_vgtmax", "eta_sc"]  # the others' intervals are as wide for noise that the settings overestimate here
    assert (table["tolerant_std"] > 1.5 * table["std"])[level].all()
    untested = dt.identify(off, runs=1, setup=dt.Setup(fit_test=False))
    assert untested.table()["tolerant_std"].isna().all() and "tolerances" not in untested.sentence


def test_more_driving_averages_no_tolerance_away(clean: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_test, "LONGEST_PART_S", 60.0)
    alone = examine(recording(clean.iloc[:301]), we2011.PARAMETERS, MEASURED[:5]).health
    both = examine(recording(clean), we2011.PARAMETERS, MEASURED[:5]).health
    for name in HEALTH:
        assert 0.5 * alone[name].std < both[name].std < 1.1 * alone[name].std
        assert abs(both[name].value - alone[name].value) < both[name].std
    # two parts of equal certainty: independent ones would give 0.71 of it
    assert both["A_vgtmax"].std > 0.9 * alone["A_vgtmax"].std


def test_no_health_beside_tolerances_where_it_could_not_hold(clean: pd.DataFrame) -> None:
    faulty = examine(recording(clean.assign(p_em_pa=1.08 * clean["p_em_pa"])), we2011.PARAMETERS, MEASURED[:5])
    assert faulty.notes and not faulty.health
    # 2.5 times the engine file's h_tot, beyond what the search allows: the fit would stop at its limit
    far = we2011.PARAMETERS.replace(h_tot=we2011.FIELD.h_tot / 2.5)
    assert not examine(recording(clean), far, MEASURED[:5]).health
