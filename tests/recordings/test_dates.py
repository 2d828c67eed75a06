"""When recordings were made: by their stamps, their names, their files, or the order in which they are given."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.dates import MODIFIED, NAME, ORDER, STAMP, dated, in_time_order
from dieseltwin.recordings.reader import Recording, read_recording, recording
from tests.api.simulated import drive


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return drive(30.0)


def written(table: pd.DataFrame, path: Path) -> Recording:
    table.to_csv(path, index=False)
    return read_recording(path)


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("truck_2026-03-14.csv", datetime(2026, 3, 14, tzinfo=UTC)),
        ("20260314T081530_bus.csv", datetime(2026, 3, 14, 8, 15, tzinfo=UTC)),
        ("2026-02-30.csv", None), ("run_12345678.csv", None), ("20265.csv", None),
    ],
)  # fmt: skip
def test_names(table: pd.DataFrame, tmp_path: Path, name: str, moment: datetime | None):
    found = dated(written(table, tmp_path / name))
    assert found is not None
    assert (found.date_from, found.date) == (NAME, moment) if moment else found.date_from == MODIFIED


def test_stamps_in_the_file_count_for_more_than_its_name(table: pd.DataFrame, tmp_path: Path):
    stamped = table.assign(time_s=[f"{t:%Y-%m-%d %H:%M:%S.%f}" for t in pd.Timestamp("2025-12-24 18:00")
                                   + pd.to_timedelta(table["time_s"], unit="s")])  # fmt: skip
    epoch = table.assign(time_s=table["time_s"] + datetime(2025, 12, 24, 18, tzinfo=UTC).timestamp())
    for k, frame in enumerate((stamped, epoch)):
        found = dated(written(frame, tmp_path / f"2026-01-0{k + 1}.csv"))
        assert found is not None and found.date_from == STAMP
        assert found.date == datetime(2025, 12, 24, 18, tzinfo=UTC)


def test_recordings_stand_in_the_order_of_time(table: pd.DataFrame, tmp_path: Path):
    late, early = written(table, tmp_path / "2026-05-01.csv"), written(table[:100], tmp_path / "any.csv")
    os.utime(tmp_path / "any.csv", (1.7e9, 1.7e9))
    assert [day.recording for day in in_time_order([late, early])] == [early, late]
    with pytest.raises(InputError, match="the same recording twice"):
        in_time_order([late, late])
    bare = [recording(table), recording(table[:120])]
    assert [(day.recording, day.date_from, day.day) for day in in_time_order(bare)] == [
        (bare[0], ORDER, "recording 1"), (bare[1], ORDER, "recording 2")
    ]  # fmt: skip


def test_recordings_of_one_day_keep_their_dates(table: pd.DataFrame, tmp_path: Path):
    """Two files of one day took the dates of all others away."""
    names = ("2026-03-20.csv", "2026-03-14_am.csv", "2026-03-14_pm.csv", "2026-03-14_night.csv")
    later, *same = [written(table[: 100 + k], tmp_path / name) for k, name in enumerate(names)]
    days = in_time_order([later, *same])
    assert [(day.recording, day.day, day.date_from) for day in days] == [
        *((recording, "2026-03-14", NAME) for recording in same), (later, "2026-03-20", NAME)
    ]  # fmt: skip
    assert days[0].date < days[1].date < days[2].date
    for name in ("a.csv", "b.csv"):
        table[: 120 + (name == "b.csv")].to_csv(tmp_path / name, index=False)
        os.utime(tmp_path / name, (1.7e9, 1.7e9))
    copied = [read_recording(tmp_path / name) for name in ("b.csv", "a.csv")]
    assert [day.date_from for day in in_time_order(copied)] == [ORDER, ORDER]
