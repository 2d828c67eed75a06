"""Reading points without time, and quasi-steady windows of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.errors import InputError
from dieseltwin.recordings.named_columns import import_columns
from dieseltwin.recordings.steady_points import STATES, SteadyPoints, quasi_steady, read_points
from tests.calibration.simulated import made_points


@pytest.fixture(scope="module")
def data() -> SteadyPoints:
    """Thirty points."""
    return made_points(count=30)


def test_points_survive_the_file(tmp_path: Path, data: SteadyPoints) -> None:
    file = tmp_path / "points.csv"
    pd.DataFrame(dict(data.columns)).to_csv(file, index=False)
    assert not import_columns(file).timed
    read = read_points(file)
    np.testing.assert_allclose(read.states(), data.states(), rtol=1e-12)
    assert read.origin == "points"


def test_missing_column_and_text(tmp_path: Path, data: SteadyPoints) -> None:
    frame = pd.DataFrame(dict(data.columns))
    file = tmp_path / "points.csv"
    frame.drop(columns="w_c_kg_s").to_csv(file, index=False)
    with pytest.raises(InputError, match="column w_c_kg_s"):
        read_points(file)
    frame = frame.astype({"p_im_pa": object})
    frame.loc[3, "p_im_pa"] = "much"
    frame.to_csv(file, index=False)
    with pytest.raises(InputError, match="p_im_pa, data row 4"):
        read_points(file)


def test_quasi_steady_windows_of_a_recording(tmp_path: Path, data: SteadyPoints) -> None:
    hold = 75  # samples at 5 Hz
    wide = {name: np.repeat(values[:6], hold) for name, values in data.columns.items()}
    wide["time_s"] = np.arange(6 * hold) * 0.2
    means, notes = quasi_steady(wide)
    assert not notes
    assert 5 <= means["n_e_rpm"].size <= 10
    nearest = np.abs(means["n_e_rpm"][:, None] - data["n_e_rpm"][None, :6]).argmin(axis=1)
    for name in STATES:
        np.testing.assert_allclose(means[name], data[name][nearest], rtol=1e-9)
    file = tmp_path / "recording.csv"
    pd.DataFrame(wide).to_csv(file, index=False)
    assert import_columns(file).timed
    assert "quasi-steady" in read_points(file).origin


def test_points_of_a_recording_are_means_of_readings_alone(data: SteadyPoints) -> None:
    """Error codes were averaged in, and a sensor of 1 Hz in rows of 5 Hz left no window at all."""
    wide = {name: np.repeat(values[:6], 75) for name, values in data.columns.items()}
    wide["time_s"] = np.arange(6 * 75) * 0.2
    row = np.arange(6 * 75)
    whole, _ = quasi_steady(wide)
    holes = {
        **wide,
        "p_im_pa": np.where(row % 50 == 7, -9999.0, wide["p_im_pa"]),
        "omega_t_rad_s": np.where(row % 5 == 0, wide["omega_t_rad_s"], np.nan),
        "u_egr_pct": np.where(row % 40 == 7, np.nan, wide["u_egr_pct"]),
    }
    means, notes = quasi_steady(holes)
    assert any("p_im_pa are an error code (-9999)" in note for note in notes)
    assert any("u_egr_pct are bridged" in note for note in notes)
    for name in STATES:
        np.testing.assert_allclose(means[name], whole[name], rtol=1e-9)


def test_restless_recording_is_refused() -> None:
    time = np.arange(200) * 0.2
    wide = {name: 50.0 + 20.0 * np.sin(time) for name in ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")}
    with pytest.raises(InputError, match="stand still"):
        quasi_steady({"time_s": time, **wide})
    with pytest.raises(InputError, match="leave time_s out where each row is a settled point"):
        quasi_steady({"time_s": 300.0 * time, **wide})
    with pytest.raises(InputError, match="strictly increasing"):
        quasi_steady({**wide, "time_s": time[::-1] * 1e18})
    with pytest.raises(InputError, match="got text; allowed: seconds"):
        quasi_steady({**wide, "time_s": time.astype(str)})
