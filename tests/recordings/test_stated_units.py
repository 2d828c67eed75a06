"""A unit that the file states decides: against our name the file is refused, `channels` takes it, a map is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.errors import InputError

UNITS = {"time_s": "s", "n_e_rpm": "1/min", "u_delta_mg": "mg/Hub", "u_egr_pct": "-", "u_vgt_pct": "%", "p_im_pa": "Pa",
         "p_em_pa": "Pa", "omega_t_rad_s": "1/s", "t_em_k": "K"}  # fmt: skip


def drive() -> pd.DataFrame:
    time = np.arange(0.0, 60.0, 0.2)
    wave = np.sin(time)
    return pd.DataFrame({
        "time_s": time, "n_e_rpm": 1300.0 + 200.0 * wave, "u_delta_mg": 120.0 + 40.0 * wave, "u_egr_pct": 20.0,
        "u_vgt_pct": 50.0, "p_im_pa": 1.7e5 + 2e4 * wave, "p_em_pa": 1.9e5 + 2e4 * wave,
        "omega_t_rad_s": 6500.0 + 500.0 * wave, "t_em_k": 750.0 + 60.0 * wave,
    })  # fmt: skip


def written(folder: Path, **units: str) -> Path:
    names, rows = drive().to_csv(index=False).split("\n", 1)
    path = folder / "drive.csv"
    path.write_text(f"{names}\n{','.join({**UNITS, **units}.values())}\n{rows}", encoding="utf-8")
    return path


def test_units_as_our_names_say_are_read(tmp_path: Path) -> None:
    assert dt.read(written(tmp_path)).columns["t_em_k"][0] == 750.0


@pytest.mark.parametrize(("column", "unit"), [("t_em_k", "°F"), ("u_delta_mg", "mm3/Hub"), ("p_im_pa", "kPa")])
def test_another_unit_than_our_name_says_is_refused(tmp_path: Path, column: str, unit: str) -> None:
    with pytest.raises(InputError, match=f"column {column}: got the unit {unit} in the file"):
        dt.read(written(tmp_path, **{column: unit}))


def test_channels_takes_the_unit_that_the_file_states(tmp_path: Path) -> None:
    path = written(tmp_path, u_delta_mg="mm3/Hub")
    dt.channels(path).save(tmp_path / "map.yaml")
    read = dt.read(path, channels=tmp_path / "map.yaml")
    assert read.columns["u_delta_mg"][0] == pytest.approx(0.835 * 120.0)
    assert not any("by the channel map" in note for note in read.notes)


def test_a_map_with_another_unit_than_the_file_is_questioned(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("T3: {column: t_em_k, unit: degF}\n")
    path = written(tmp_path, t_em_k="°C")
    path.write_text(path.read_text(encoding="utf-8").replace("t_em_k", "T3"), encoding="utf-8")
    notes = dt.read(path, channels=tmp_path / "map.yaml").notes
    assert "T3 is in degF by the channel map and in °C by the file: the map's unit is taken" in notes
