"""`dieseltwin channels FILE --engine PETROL`: foreign names and units become the signals that our own columns give."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import dieseltwin
from dieseltwin.api import channels as api
from dieseltwin.challenge.petrol_plant import drive
from dieseltwin.cli.channels import run_channels
from dieseltwin.errors import InputError
from dieseltwin.petrol.recording import read_petrol

BAR, RPM, DEGF = 1e5, np.pi / 30.0, (5.0 / 9.0, 459.67 * 5.0 / 9.0)
Written = Mapping[str, tuple[str, float, float]]

# our column -> (their name, ours = scale * theirs + offset)
GERMAN: Written = {
    "time_s": ("Zeit [s]", 1.0, 0.0), "omega_e_rad_s": ("nmot [1/min]", RPM, 0.0),
    "W_af_kg_s": ("HFM_kg_h", 1.0 / 3600.0, 0.0), "p_im_Pa": ("Saugrohrdruck [hPa]", 100.0, 0.0),
    "p_ic_Pa": ("Ladedruck vor DK [hPa]", 100.0, 0.0), "T_ic_K": ("Ladelufttemperatur [°C]", 1.0, 273.15),
    "alpha_th_pct": ("Drosselklappenwinkel [%]", 1.0, 0.0), "p_amb_Pa": ("Umgebungsdruck [hPa]", 100.0, 0.0),
    "T_amb_K": ("Umg_T_C", 1.0, 273.15),
}  # fmt: skip
SCANTOOL: Written = {
    "time_s": ("Time (sec)", 1.0, 0.0), "omega_e_rad_s": ("Engine RPM (rpm)", RPM, 0.0),
    "W_af_kg_s": ("Mass Air Flow (g/s)", 1e-3, 0.0), "p_im_Pa": ("Intake Manifold Pressure (kPa)", 1e3, 0.0),
    "p_ic_Pa": ("Boost Pressure (psi)", 6894.757293168, 0.0), "T_ic_K": ("Charge Air Temp (degF)", *DEGF),
    "alpha_th_pct": ("Throttle Position (%)", 1.0, 0.0), "p_amb_Pa": ("Barometric Pressure (kPa)", 1e3, 0.0),
    "T_amb_K": ("Ambient Air Temp (degF)", *DEGF),
}  # fmt: skip
WITHOUT_UNITS: Written = {
    "time_s": ("t", 1.0, 0.0), "omega_e_rad_s": ("n_mot", RPM, 0.0), "W_af_kg_s": ("MAF", 1.0 / 3600.0, 0.0),
    "p_im_Pa": ("MAP", 1e3, 0.0), "p_ic_Pa": ("p_boost", BAR, 0.0), "T_ic_K": ("T_IC", 1.0, 273.15),
    "alpha_th_pct": ("TPS", 100.0, 0.0), "p_amb_Pa": ("p_amb", BAR, 0.0), "T_amb_K": ("T_amb", 1.0, 273.15),
}  # fmt: skip


@pytest.fixture(scope="module")
def ours() -> pd.DataFrame:
    return drive(120.0, 5)


def foreign(ours: pd.DataFrame, written: Written, path: Path) -> Path:
    pd.DataFrame({name: (ours[column] - offset) / scale for column, (name, scale, offset) in written.items()}).to_csv(
        path, index=False
    )
    return path


@pytest.mark.parametrize("written", [GERMAN, SCANTOOL, WITHOUT_UNITS], ids=["german", "scantool", "without units"])
def test_the_map_gives_what_our_own_columns_give(ours: pd.DataFrame, written: Written, tmp_path: Path) -> None:
    path = foreign(ours, written, tmp_path / "log.csv")
    ours.to_csv(tmp_path / "ours.csv", index=False)
    lines = list(run_channels(path, tmp_path / "map.yaml", engine=Path("liu_petrol")))
    assert not any("not found" in line for line in lines)
    assert any("air balance" in line and "displacement" in line for line in lines)
    units = any("CHECK: the file gives no unit" in line for line in lines)
    assert units == (written is WITHOUT_UNITS)
    read = read_petrol(path, tmp_path / "map.yaml").signals
    expected = read_petrol(tmp_path / "ours.csv").signals
    for name in ("time_s", "p_ic", "T_ic", "p_im", "W_af", "omega_e", "alpha", "p_amb", "T_amb"):
        assert getattr(read, name) == pytest.approx(getattr(expected, name), rel=1e-9), name
    assert f"discover {path.name} --channels" in (tmp_path / "map.yaml").read_text(encoding="utf-8")


def test_a_boost_over_the_ambient_is_gauge(ours: pd.DataFrame, tmp_path: Path) -> None:
    written = {**SCANTOOL, "p_ic_Pa": ("Boost Pressure (kPa)", 1e3, 0.0)}
    table = ours.assign(p_ic_Pa=ours["p_ic_Pa"] - ours["p_amb_Pa"])
    path = foreign(table, written, tmp_path / "log.csv")
    found = api.channels(path, engine="liu_petrol")
    assert found.proposal.guesses["p_ic_pa"].reading.entry.via == "gauge"
    found.save(tmp_path / "map.yaml")
    assert read_petrol(path, tmp_path / "map.yaml").signals.p_ic == pytest.approx(ours["p_ic_Pa"].to_numpy(), rel=1e-9)


def test_pressures_in_each_others_place_are_to_be_checked(ours: pd.DataFrame, tmp_path: Path) -> None:
    swapped = {**SCANTOOL, "p_im_Pa": SCANTOOL["p_ic_Pa"], "p_ic_Pa": SCANTOOL["p_im_Pa"]}
    path = foreign(ours, swapped, tmp_path / "log.csv")
    guesses = api.channels(path, engine="liu_petrol").proposal.guesses
    assert any("is it another pressure?" in warning for warning in guesses["p_ic_pa"].reading.warnings)
    both = {"p_im_Pa": "Intake Manifold Pressure (bar)", "p_ic_Pa": "Boost Pressure abs (bar)"}
    table = ours.assign(p_im_Pa=1.2 * ours["p_ic_Pa"])
    path = foreign(table, {**SCANTOOL, **{column: (name, BAR, 0.0) for column, name in both.items()}}, path)
    guesses = api.channels(path, engine="liu_petrol").proposal.guesses
    assert any("are the two swapped?" in warning for warning in guesses["p_im_pa"].reading.warnings)


def test_without_its_engine_a_throttle_is_pointed_at(ours: pd.DataFrame, tmp_path: Path) -> None:
    path = foreign(ours, GERMAN, tmp_path / "log.csv")
    assert any("'Drosselklappenwinkel [%]' is a throttle" in line for line in run_channels(path))
    diesel = tmp_path / "diesel.csv"
    ours[["time_s", "alpha_th_pct"]].assign(egr_valve_pct=ours["alpha_th_pct"]).to_csv(diesel, index=False)
    assert not any("is a throttle" in line for line in run_channels(diesel))


def test_its_recording_without_its_engine_is_told_so(ours: pd.DataFrame, tmp_path: Path) -> None:
    ours.to_csv(tmp_path / "ours.csv", index=False)
    with pytest.raises(InputError, match="a petrol engine's columns: give its file"):
        dieseltwin.discover(tmp_path / "ours.csv")


def test_a_rig_names_its_columns_itself(ours: pd.DataFrame, tmp_path: Path, project_root: Path) -> None:
    path = foreign(ours, GERMAN, tmp_path / "log.csv")
    with pytest.raises(InputError, match="its file names the columns"):
        api.channels(path, engine=project_root / "examples" / "rigs" / "cascaded_tanks.yaml")
