"""Discovery through the front door: on driving, on settled points, on a petrol engine; the files of the command."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.findings import COLUMNS
from dieseltwin.api.points import PointsDiscovered
from dieseltwin.calibration import calibrate as calibration
from dieseltwin.challenge.petrol_plant import drive as drive_petrol
from dieseltwin.cli.app import main
from dieseltwin.engine import load_engine, we2011
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import fit_maps
from dieseltwin.petrol.parameters import PetrolParameters, save_petrol
from dieseltwin.petrol.recording import read_petrol
from tests.api.simulated import drive
from tests.calibration.simulated import FLAP, GEOMETRY, made_points
from tests.disk import full_beyond
from tests.pages import without_pictures


def same_files(one: Path, other: Path, *, but: tuple[str, ...] = ("runtime.json", "report.html")) -> None:
    """The two folders hold the same files with the same bytes; of `but` (they hold times) only the names."""
    files = {path.relative_to(one) for path in one.rglob("*") if path.is_file()}
    assert files == {path.relative_to(other) for path in other.rglob("*") if path.is_file()}
    for file in files:
        assert file.name in but or (one / file).read_bytes() == (other / file).read_bytes(), file


# --- driving


@pytest.fixture(scope="module")
def leaking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute and a half of an exact engine with a large leak."""
    path = tmp_path_factory.mktemp("leaking") / "drive.csv"
    engine = we2011.PARAMETERS.replace(terms=(Term(effect="boost_leak", magnitude=6e-5),))
    drive(90.0, engine).to_csv(path, index=False)
    return path


@pytest.mark.thorough
def test_function_and_command_find_and_write_the_same(leaking: Path, tmp_path: Path) -> None:
    found = dt.discover(leaking, withhold=["exhaust_leak"], seed=3)
    assert "boost_leak" in found.document.effects[0].names
    table = found.table()
    assert tuple(table.columns) == COLUMNS and table["effect"][0] == found.document.effects[0].name
    assert found.sentence.startswith("The twin leaves out") and found.sentence in str(found)
    assert "<table" in found._repr_html_() and found.plot("candidates").axes
    asked = ["--withhold", "exhaust_leak", "--seed", "3"]
    with without_pictures():
        found.save(tmp_path / "function")
        assert main(["discover", str(leaking), *asked, "--out", str(tmp_path / "command")]) == 0
    same_files(tmp_path / "function", tmp_path / "command")
    assert load_engine(tmp_path / "command" / "engine.yaml") == found.engine
    # the repaired engine is one that everything takes
    repaired = dt.simulate(leaking, found.engine)
    assert repaired.table()["w_leak_im_kg_s"].max() > 1e-3
    details = json.loads((tmp_path / "function" / "details.json").read_text())
    assert details["options"]["withhold"] == ["exhaust_leak"] and details["options"]["engine_sha256"] is None


def test_a_refusal_is_one_line_and_nothing_is_searched(leaking: Path) -> None:
    table = pd.read_csv(leaking)
    with pytest.raises(InputError, match="60 s or more"):
        dt.discover(table[table.time_s <= 20.0])
    with pytest.raises(InputError, match="did you mean boost_leak"):
        dt.discover(table, withhold=["boost_lek"])
    with pytest.raises(InputError, match="no name"):
        dt.discover(table, sensors=[])
    with pytest.raises(InputError, match="settled points"):
        dt.discover(table.drop(columns="time_s"), map_tolerance=0.01)
    with pytest.raises(InputError, match="diesel engine"):
        dt.discover(dt.read(table), PetrolParameters())


# --- settled points


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An engine whose exhaust is throttled by a flap, 0.5 % noise."""
    made = made_points(count=36, noise=0.005, effects=FLAP)
    path = tmp_path_factory.mktemp("points") / "points.csv"
    pd.DataFrame(dict(made.columns)).to_csv(path, index=False)
    return path


@pytest.fixture
def quick_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """One start: seconds instead of a minute."""
    monkeypatch.setattr(calibration, "STARTS", 0)


@pytest.mark.thorough
@pytest.mark.usefixtures("quick_points")
def test_points_are_calibrated_discovered_and_answered_for(points: Path, tmp_path: Path) -> None:
    calibrated = dt.calibrate(points, geometry=GEOMETRY)
    (tmp_path / "full").mkdir()
    with full_beyond(2**15), pytest.raises(InputError, match="no space left"):  # its page needs more
        calibrated.save(tmp_path / "full" / "engine.yaml")
    assert not list((tmp_path / "full").iterdir())
    file = calibrated.save(tmp_path / "engine.yaml")
    assert dt.engine(file) == calibrated.engine and "36 points" in calibrated.sentence
    assert set(calibrated.table().columns) >= {"held_out_pct", "tolerance_pct"} and len(calibrated.plot().axes) == 6
    found = dt.discover(points, file)
    assert isinstance(found, PointsDiscovered) and found.document.mismatch and "flap" in found.sentence
    with without_pictures():
        found.save(tmp_path / "function")
        assert main(["discover", str(points), "--engine", str(file), "--out", str(tmp_path / "command")]) == 0
    same_files(tmp_path / "function", tmp_path / "command")
    implied = dt.imply(points, found)
    assert {"p_es_pa", "p_es_pa_std"} <= set(implied.table()) and len(implied.plot().axes) == 5
    again = dt.imply(dt.read(points), tmp_path / "command" / "repaired.yaml")
    pd.testing.assert_frame_equal(implied.table(), again.table(), rtol=1e-9)
    repaired = str(tmp_path / "command" / "repaired.yaml")
    assert main(["imply", str(points), "--engine", repaired, "--out", str(tmp_path / "implied.csv")]) == 0
    again.save(tmp_path / "again.csv")
    assert (tmp_path / "implied.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()


# --- petrol


@pytest.mark.thorough
def test_petrol_engine(tmp_path: Path) -> None:
    drive_petrol(600.0, 1).to_csv(tmp_path / "healthy.csv", index=False)
    drive_petrol(250.0, 10, W_af_kg_s=0.12).to_csv(tmp_path / "drive.csv", index=False)
    engine = fit_maps(read_petrol(tmp_path / "healthy.csv").signals, PetrolParameters())[0]
    file = save_petrol(engine, tmp_path / "engine.yaml")
    found = dt.discover(tmp_path / "drive.csv", file)
    assert found.document.effects[0].name == found.table()["effect"][0] == "w_af_gain"
    assert isinstance(found.engine, PetrolParameters) and found.plot("candidates").axes
    command = ["discover", str(tmp_path / "drive.csv"), "--engine", str(file), "--out", str(tmp_path / "command")]
    with without_pictures():
        found.save(tmp_path / "function")
        assert main(command) == 0
    same_files(tmp_path / "function", tmp_path / "command")
    repaired = dt.simulate(tmp_path / "drive.csv", tmp_path / "command" / "engine.yaml")
    assert repaired.engine == dt.engine(tmp_path / "command" / "engine.yaml") and len(repaired.plot().axes) == 2
    with pytest.raises(InputError, match="did you mean intake_leak"):
        dt.discover(tmp_path / "drive.csv", file, withhold=["intake_lek"])
    with pytest.raises(InputError, match="at least 600 s"):
        dt.calibrate(tmp_path / "drive.csv", "liu_petrol")
