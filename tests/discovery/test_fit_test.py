"""`identify` doesn't vouch for a fit that isn't one, and has no doubts about a recording that is sound."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.discovery import fit_test
from dieseltwin.discovery.fit_test import fit_notes
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.recordings.reader import recording

NOISE = dict(zip(MEASURED, (0.03, 0.03, 0.01, 0.05, 0.03, 0.03), strict=True))
INPUTS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct"]


@pytest.fixture(scope="module")
def clean(project_root: Path) -> pd.DataFrame:
    """Two minutes with the paper's noise."""
    trace = pd.read_csv(project_root / "tests" / "reference" / "field_random_300s.csv").iloc[:601]
    rng = np.random.default_rng(8)
    made = trace[INPUTS].copy()
    for name in MEASURED[:5]:
        made[name] = trace[name] + NOISE[name] * trace[name].mean() * rng.standard_normal(len(trace))
    return made


def test_sound_recordings_raise_no_doubt(clean: pd.DataFrame, project_root: Path) -> None:
    assert dt.identify(clean, runs=1).warnings == []
    exact = pd.read_csv(project_root / "tests" / "reference" / "field_random_300s.csv").iloc[:601]
    assert dt.identify(exact, runs=1).warnings == []


def test_a_short_hole_in_an_input_is_no_reason_not_to_test(clean: pd.DataFrame) -> None:
    holes = clean.copy()
    holes.loc[200:202, "u_delta_mg"] = np.nan
    assert fit_notes(recording(holes), we2011.PARAMETERS, MEASURED[:5]) == []


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
    notes = fit_notes(recording(change(clean)), we2011.PARAMETERS, MEASURED[:5])
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
    assert fit_notes(recording(broken), we2011.PARAMETERS, MEASURED[:5]) == []


def test_what_is_too_short_is_said_to_be_untested(clean: pd.DataFrame) -> None:
    notes = fit_notes(recording(clean.iloc[:200]), we2011.PARAMETERS, MEASURED[:5])
    assert [note.code for note in notes] == ["untested"]
