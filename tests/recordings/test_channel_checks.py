"""Channels that show their fault by themselves, and those that don't have one."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.notes import Note, of_reading
from dieseltwin.recordings.channel_checks import clipped, replayed, series_notes, spikes
from dieseltwin.recordings.unread import stuck_unread

TIME = 0.2 * np.arange(1500)
SPEED = 1300.0 + 200.0 * np.sin(0.05 * TIME)


@pytest.fixture
def pressure() -> np.ndarray:
    rng = np.random.default_rng(3)
    return 2e5 + 4e4 * np.sin(0.2 * TIME) * np.sin(0.03 * TIME) + 2e3 * rng.standard_normal(TIME.size)


def codes(values: np.ndarray) -> list[str]:
    return [note.code for note in series_notes(TIME, {"p_im_pa": values}, SPEED)]


@pytest.mark.parametrize("step", [0.0, 500.0, 4000.0], ids=["float", "fine steps", "coarse steps"])
def test_a_sound_channel_has_no_note(pressure: np.ndarray, step: float) -> None:
    assert codes(np.round(pressure / step) * step if step else pressure) == []


def test_a_frozen_channel_is_told_with_its_time(pressure: np.ndarray) -> None:
    pressure[400:700] = pressure[400]
    note = series_notes(TIME, {"p_im_pa": pressure}, SPEED)[0]
    assert note.code == "frozen_channel" and "60 s from 80 s" in note and note.affects == ("p_im_pa",)


def _columns(pressure: np.ndarray, speed: np.ndarray) -> dict[str, np.ndarray]:
    return {"time_s": TIME, "p_im_pa": pressure, "n_e_rpm": speed, "u_delta_mg": 0.05 * speed}


def test_what_a_stuck_sensor_shows_is_no_reading(pressure: np.ndarray) -> None:
    pressure[400:700] = pressure[400]
    columns = _columns(pressure.copy(), SPEED)
    (note,) = stuck_unread(columns)
    assert isinstance(note, Note) and (note.code, note.affects) == ("frozen_channel", ("p_im_pa",))
    assert "from 80 to 140 s while the engine moves" in note
    assert np.isnan(columns["p_im_pa"][400:700]).all() and np.isfinite(columns["p_im_pa"]).sum() == TIME.size - 300
    assert series_notes(TIME, {"p_im_pa": columns["p_im_pa"]}, SPEED) == []  # it is said once
    assert of_reading(note, "a.csv: ").startswith("note: a.csv: p_im_pa") and of_reading(note).code == note.code
    assert of_reading("p_im_pa is held").code == "reading"


def test_an_idling_engine_and_a_dead_channel_are_left(pressure: np.ndarray) -> None:
    idle = np.where((TIME >= 80.0) & (TIME <= 140.0), 600.0 + np.sin(TIME), SPEED)
    pressure[400:700] = pressure[400]
    assert stuck_unread(_columns(pressure, idle)) == []  # a coarse channel repeats itself there
    assert stuck_unread(_columns(np.full(TIME.size, 2e5), SPEED)) == []  # no channel at all; others say so
    flow = {"time_s": TIME, "w_egr_kg_s": np.where(TIME < 100.0, 0.0, pressure), "n_e_rpm": SPEED, "u_delta_mg": SPEED}
    assert stuck_unread(flow) == []


@pytest.mark.parametrize("step", [0.0, 500.0])
def test_a_block_that_comes_twice_is_found_to_the_row(pressure: np.ndarray, step: float) -> None:
    values = np.round(pressure / step) * step if step else pressure
    values[900:1100] = values[200:400]
    found = replayed(values)
    assert found is not None
    first, again, count = found
    assert (again - first, count >= 200) == (700, True) and 195 <= first <= 200
    assert codes(values) == ["replayed_channel"]


def test_idle_in_coarse_steps_repeats_itself_rightly() -> None:
    rng = np.random.default_rng(5)
    assert replayed(np.round(600.0 + 1.5 * rng.standard_normal(5000))) is None


def test_a_clipped_channel_is_told_on_either_side(pressure: np.ndarray) -> None:
    limit = float(np.quantile(pressure, 0.9))
    assert clipped(np.minimum(pressure, limit)) == int(np.count_nonzero(pressure >= limit))
    assert codes(np.minimum(pressure, limit)) == ["clipped_channel"]
    assert codes(np.maximum(pressure, np.quantile(pressure, 0.1))) == ["clipped_channel"]
    assert clipped(-np.maximum(pressure - 2e5, 0.0)) == 0  # zero is no limit


def test_spikes_are_told_by_row_and_steps_are_none(pressure: np.ndarray) -> None:
    pressure[700:] += 5e4
    assert spikes(pressure).size == 0
    pressure[[100, 800]] += [3e5, -4e5]
    assert spikes(pressure).tolist() == [100, 800]
    assert codes(pressure) == ["spikes"]
