"""What the reader of petrol recordings says of rows that it can't use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.petrol.recording import gaps, pooled, read_petrol


@pytest.fixture
def table() -> pd.DataFrame:
    n = 1000
    rise = np.linspace(0.0, 1.0, n)
    return pd.DataFrame({
        "time_s": 0.1 * np.arange(n), "p_ic_pa": 1e5 + 1e4 * rise, "t_ic_k": 300.0 + rise, "p_im_pa": 5e4 + 1e4 * rise,
        "w_af_kg_s": 0.01 + 0.01 * rise, "omega_e_rad_s": 100.0 + rise, "alpha_th_pct": 10.0 + 5.0 * rise,
        "p_amb_pa": 1e5, "t_amb_k": 295.0,
    })  # fmt: skip


def test_rows_without_a_reading_are_said(table: pd.DataFrame) -> None:
    table.loc[100:299, "alpha_th_pct"] = np.nan
    table.loc[500, "p_im_pa"] = np.nan
    read = read_petrol(table)
    assert read.signals.time_s.size == 799  # one more lacks p_im alone: too few to tell of
    (note,) = read.notes
    assert note == "note: 20 % of the rows left out, as alpha_th_pct has no number there"
    assert (note.code, note.affects) == ("left_out", ("alpha_th_pct",))
    another = read_petrol(table.assign(p_im_pa=6e4 + 1e4 * np.linspace(1.0, 0.0, len(table))).dropna())
    assert not another.notes and pooled([read, another]).notes == (note,)


def test_a_few_are_not(table: pd.DataFrame) -> None:
    table.loc[[3, 500, 700], ["p_im_pa", "t_ic_k"]] = np.nan
    assert not read_petrol(table).notes


@pytest.mark.parametrize(
    ("column", "reading", "words"),
    [("omega_e_rad_s", 0.0, "50 rows left out, in which the engine runs at less than 300 rpm"),
     ("p_im_pa", 0.0, "50 rows left out, in which p_im_pa reads less than 5000 Pa")],
)
def test_a_standing_engine_and_a_sensor_that_drops_out_are_left_out(
    table: pd.DataFrame, column: str, reading: float, words: str
) -> None:
    table.loc[400:449, column] = reading
    read = read_petrol(table)
    assert read.signals.time_s.size == 950 and len(gaps(read.signals.time_s)) == 2
    (note,) = read.notes
    assert note == f"note: {words}" and (note.code, note.affects) == ("left_out", (column,))


def test_messages_name_the_row_of_the_file(table: pd.DataFrame) -> None:
    text = table.assign(p_im_pa=table.p_im_pa.astype(object).where(table.index != 4, "none"))
    with pytest.raises(InputError, match="column p_im_pa, data row 5: got 'none'"):
        read_petrol(text)
    with pytest.raises(InputError, match="column p_im_pa: got 0 numbers"):
        read_petrol(table.assign(p_im_pa=np.nan))
    table.loc[10:19, "p_im_pa"] = np.nan
    table.loc[50, "time_s"] = table.time_s[49]
    with pytest.raises(InputError, match="no rise at data row 51"):
        read_petrol(table)


def test_what_was_done_to_the_file_is_said(table: pd.DataFrame, tmp_path: Path) -> None:
    table.to_csv(tmp_path / "a.csv", index=False, sep=";", decimal=",")
    (note,) = read_petrol(tmp_path / "a.csv").notes
    assert (note, note.code) == ("note: read with decimal comma", "reading")
