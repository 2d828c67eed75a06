"""Identification through the front door: what was planted is found, and the command writes the same."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.identified_words import with_tolerances
from dieseltwin.cli.app import main
from dieseltwin.discovery.fit_test import Tolerant
from dieseltwin.engine import we2011
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from tests.api.simulated import drive


@pytest.fixture(scope="module")
def worn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes of an engine whose EGR valve is a quarter too small."""
    path = tmp_path_factory.mktemp("worn") / "drive.csv"
    drive(120.0, we2011.PARAMETERS.replace(A_egrmax=3e-4)).to_csv(path, index=False)
    return path


def test_function_and_command_find_and_write_the_same(
    worn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = dt.identify(worn, runs=2, seed=3, segment_s=60.0)
    table = found.table()
    mean, std, low, high = table.loc["A_egrmax", ["mean", "std", "low", "high"]]
    assert low < mean < high and abs(mean - 3e-4) < 4.0 * std and mean < 3.2e-4
    assert (table["segments"] == 2).any()
    assert found.sentence.startswith("classical, 2 segments: beside tolerances of maps and sensors A_egrmax 29")
    assert "; with exact ones A_egrmax 29" in found.sentence and found.sentence.count(" mm²") == 4
    assert "not identifiable" not in str(found) and "<table" in found._repr_html_()
    assert found.plot("states").axes
    # the figures are drawn by the command's own tests
    monkeypatch.setattr("dieseltwin.report.html.identification_sections", lambda *_: [])
    found.save(tmp_path / "function")
    page = (tmp_path / "function" / "report.html").read_text(encoding="utf-8")
    assert "Beside tolerances of maps and sensors" in page
    lines = found.lines()
    first = lines[lines.index("beside tolerances of maps and sensors:") + 1].split()
    assert first[:2] == ["A_egrmax", f"{found.document['with_tolerances']['A_egrmax']['mean']:.6g}"]
    assert any(line.startswith("by classical, with exact maps and sensors: the intervals are noise") for line in lines)
    command = ["identify", str(worn), "--runs", "2", "--seed", "3", "--segment", "60"]
    assert main([*command, "--out", str(tmp_path / "command")]) == 0
    for name in ("identification.json", "states.parquet"):
        assert (tmp_path / "function" / name).read_bytes() == (tmp_path / "command" / name).read_bytes()
    from_table = dt.identify(pd.read_csv(worn), runs=2, seed=3)
    assert from_table.found.to_json() == found.found.to_json()


@pytest.mark.thorough
def test_a_hill_that_no_column_tells_is_found_and_identified_as_such() -> None:
    there = drive(180.0, we2011.PARAMETERS.replace(A_egrmax=3e-4, p_amb=93e3, T_amb=285.0))
    found = dt.identify(there, runs=1, seed=3)
    (note,) = (note for note in found.notes if isinstance(note, Note) and note.code == "circumstances")
    assert "the ambient pressure is 9" in note and not any(item["code"] == "misfit" for item in found.warnings)
    mean, std = found.table().loc["A_egrmax", ["mean", "std"]]
    assert abs(mean - 3e-4) < 4.0 * std
    assert found.problems[0].parameters.p_amb == pytest.approx(93e3, abs=1500.0)


def test_what_can_not_be_identified_is_one_line(worn: Path) -> None:
    table = pd.read_csv(worn)
    with pytest.raises(InputError, match="t_em_k"):
        dt.identify(dt.read(table.drop(columns="t_em_k")))
    with pytest.raises(InputError, match="did you mean classical"):
        dt.identify(table, method="clasical")
    with pytest.raises(InputError, match="no such folder"):
        dt.identify(table, method="few-shot-newton", setup=dt.Setup(models="nowhere"))


@pytest.mark.parametrize("told", [Tolerant(4e-4, 5e-4), Tolerant(float("nan"), 1e-6), Tolerant(4e-4, float("inf"))])
def test_what_the_fit_beside_tolerances_does_not_know_is_left_out(told: Tolerant) -> None:
    by_method = {"A_egrmax": {"mean": 4e-4, "std": 1e-6}, "h_tot": {"mean": 96.0, "std": 1.0}}
    document = with_tolerances({"parameters": by_method}, {"A_egrmax": told, "h_tot": Tolerant(96.0, 2.0)})
    assert set(document["with_tolerances"]) == {"h_tot"}
    low, high = document["with_tolerances"]["h_tot"]["interval_90"]
    assert low < 96.0 < high and high - low == pytest.approx(2 * 1.645 * 2.0, rel=0.01)
