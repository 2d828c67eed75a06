"""A healthy engine whose fuel is cut and back between the rows of its recorder."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.discovery import fit_test
from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.fit_test import examine
from dieseltwin.discovery.search import run as search_run
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording, recording

EVERY = 5  # of the rows of 25 Hz are recorded
NOISE = (0.001, 0.001, 0.00075, 0.005, 0.001, 0.0025)  # of each channel's mean


def _recorded_at_5_hz(effects: dict[str, float]) -> Recording:
    """Two minutes; fuel goes down to nothing within 0.1 s for half a second at a time, as at a change of gear."""
    rng = np.random.default_rng(21)
    driving = draw_driving("random", 120.0, we2011.PARAMETERS.model_dump(), np.random.default_rng(20))
    slow = pd.DataFrame(driving.columns())
    time_s = np.arange(0.0, float(slow["time_s"].iloc[-1]), 0.04)
    fine = pd.DataFrame({"time_s": time_s, **{name: np.interp(time_s, slow["time_s"], slow[name]) for name in INPUTS}})
    for start in np.sort(rng.uniform(0.0, time_s[-1], 30)):
        away = np.clip(np.minimum(time_s - start, start + 0.5 - time_s) / 0.1, 0.0, 1.0)
        fine["u_delta_mg"] *= 1.0 - 0.95 * away
    simulated = dt.simulate(fine, effects=effects).table()
    table = pd.concat([fine, simulated[list(MEASURED)]], axis=1).iloc[::EVERY].reset_index(drop=True)
    for column, share in zip(MEASURED, NOISE, strict=True):
        table[column] += share * table[column].mean() * rng.standard_normal(len(table))
    return recording({name: table[name].to_numpy() for name in table})


def test_what_inputs_do_between_the_rows_is_no_fault() -> None:
    assert not discover(_recorded_at_5_hz({}), we2011.PARAMETERS).document.mismatch


@pytest.mark.thorough
def test_as_lines_from_row_to_row_it_would_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_run, "with_inputs_between_rows", lambda found: (None, False))
    assert discover(_recorded_at_5_hz({}), we2011.PARAMETERS).document.mismatch


def test_it_is_no_misfit_to_identify_either(monkeypatch: pytest.MonkeyPatch) -> None:
    healthy = _recorded_at_5_hz({})
    found = examine(healthy, we2011.PARAMETERS, MEASURED)
    assert not found.notes and found.health
    for name, told in found.health.items():
        assert abs(told.value - getattr(we2011.PARAMETERS, name)) < 4.0 * told.std
    monkeypatch.setattr(fit_test, "rows_may_be_slow", lambda time_s: False)
    assert examine(healthy, we2011.PARAMETERS, MEASURED).notes


@pytest.mark.thorough
def test_a_leak_is_named_beside_them() -> None:
    (effect,) = discover(_recorded_at_5_hz({"boost_leak": 5e-5}), we2011.PARAMETERS).document.effects
    assert effect.name == "boost_leak" and effect.magnitude == pytest.approx(5e-5, abs=5e-6)
