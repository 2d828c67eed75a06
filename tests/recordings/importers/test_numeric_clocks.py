"""Numbers that are stamps: dates and times of day in one number, whole seconds, spans; statistics about a table."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.guess.facts import clock_of
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.recordings.reader import read_recording

ROWS = 1500
SECONDS = 0.1 * np.arange(ROWS)
STAMPS = pd.Timestamp("2026-03-28 23:58:40") + pd.to_timedelta(SECONDS, unit="s")
OF_DAY = [f"{stamp:%H%M%S}.{stamp.microsecond // 100000}" for stamp in STAMPS]
NUMBERS = {
    "a date and a time with milliseconds": [int(f"{stamp:%Y%m%d%H%M%S%f}"[:17]) for stamp in STAMPS],
    "a date and a time, ten rows each": [int(f"{stamp:%Y%m%d%H%M%S}") for stamp in STAMPS],
    "a date and a time with a fraction": [float(f"{stamp:%Y%m%d%H%M%S.%f}") for stamp in STAMPS],
    "a time of day": [float(text) for text in OF_DAY],
    "a time of day with milliseconds": [round(float(text) * 1e3) for text in OF_DAY],
    "whole seconds": (SECONDS + 1e-9).astype(int),
    "whole seconds since 1970": 1_764_000_000 + (SECONDS + 1e-9).astype(int),
    "spans of time": pd.to_timedelta(SECONDS, unit="s"),
}  # fmt: skip


@pytest.mark.parametrize("what", NUMBERS)
def test_numbers_that_are_stamps_become_seconds(what):
    table, units, notes = in_seconds(pd.DataFrame({"Time": NUMBERS[what], "n": 1000.0}), "table")
    since = table["Time"].to_numpy() - table["Time"].iloc[0]
    np.testing.assert_allclose(since, SECONDS, atol=5e-3)  # a number of 17 digits is as coarse as that
    assert notes or what == "spans of time"
    assert units.get("Time", "s") == "s"


@pytest.mark.parametrize("values", [SECONDS, SECONDS * 1e3, 100.0 + SECONDS, 20_260_000.0 + SECONDS, 1.764e9 + SECONDS])
def test_plain_seconds_stay(values):
    table, units, notes = in_seconds(pd.DataFrame({"Time": values, "t": values[::-1]}), "table")
    np.testing.assert_array_equal(table["Time"], values)
    assert not units and not notes


def test_only_columns_of_times_are_looked_at():
    frame = pd.DataFrame({"counter": NUMBERS["whole seconds"], "p": NUMBERS["a time of day"]})
    pd.testing.assert_frame_equal(in_seconds(frame, "table")[0], frame)


def test_a_clock_with_too_few_digits_says_so(tmp_path):
    rough = np.repeat(np.r_[0.0, 128.0, 256.0], [700, 500, 300]) + 1.764e9
    frame = pd.DataFrame({"Time [s]": rough, "Engine speed [rpm]": 1000.0 + SECONDS})
    frame.to_csv(tmp_path / "a.csv", index=False)
    clock = clock_of(read_raw(tmp_path / "a.csv"))
    assert clock is not None and (clock.name, clock.unit_s) == ("Time [s]", 1.0)
    named = frame.set_axis(["time_s", "n_e_rpm"], axis=1).assign(u_delta_mg=60.0, u_egr_pct=20.0, u_vgt_pct=50.0)
    with pytest.raises(InputError, match="export the time with more digits"):
        read_recording(named, sensors=())


ROW = "{:.1f};{:.1f};2"


@pytest.mark.parametrize("words", [["Mean", "Std"], ["Min", "Max", "Mean"], ["Mittelwert", "Standardabweichung"]])
@pytest.mark.parametrize("below", [True, False])
def test_rows_of_statistics_are_left_out(tmp_path, words, below):
    numbers = [ROW.format(time, 1000.0 + time) for time in SECONDS[:300]]
    figures = [f"{word};1333.6;2" for word in words]
    rows = [*numbers, *figures] if below else [*figures, *numbers]
    (tmp_path / "a.csv").write_text("\n".join(["time;speed;x", "s;rpm;-", *rows]) + "\n")
    raw = read_raw(tmp_path / "a.csv")
    np.testing.assert_allclose(raw.table["time"], SECONDS[:300])
    assert f"{len(words)} rows of statistics left out ({', '.join(words)})" in "; ".join(raw.notes)


def test_a_column_of_such_words_is_no_statistics(tmp_path):
    rows = [f"{word};{speed};2" for speed in range(1000, 1020) for word in ("Mean", "Std")]
    (tmp_path / "a.csv").write_text("\n".join(["kind;speed;x", *rows]) + "\n")
    assert len(read_raw(tmp_path / "a.csv").table) == 40


@pytest.mark.parametrize(("name", "unit_s"), [
    ("time_s", 1.0), ("time_ms", 1e-3), ("Time (ms)", 1e-3), ("Time [min]", 60.0), ("Time (minutes)", 60.0),
])  # fmt: skip
def test_a_reading_a_row_keeps_its_own_time(tmp_path, name, unit_s):
    """Readings at one time were spread over the step as rows of a coarse clock, and a name's unit was not read."""
    time = np.repeat(np.arange(100.0) * 0.2, 4)
    table = pd.DataFrame({name: time / unit_s, "name": ["n", "p", "t", "w"] * 100, "value": np.arange(400.0)})
    table.to_csv(tmp_path / "a.csv", index=False)
    raw = read_raw(tmp_path / "a.csv")
    assert list(raw.signals) == ["n", "p", "t", "w"] and not any("spread" in note for note in raw.notes)
    for signal in raw.signals.values():
        np.testing.assert_allclose(signal.time_s, np.arange(100.0) * 0.2, atol=1e-9)
