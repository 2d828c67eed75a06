"""The sealed tier of settled points: made, run, opened and scored; the same question by the command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.challenge import points_cases
from dieseltwin.challenge.plant_effects import FAMILIES, FLAP
from dieseltwin.challenge.points_cases import SETTLED, draw_points
from dieseltwin.cli.app import main
from dieseltwin.discovery.twins.diesel_points import hypotheses_of
from dieseltwin.recordings.steady_points import STATES

pytestmark = pytest.mark.usefixtures("no_pictures")
ONLY = "p_em_offset"


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty-five points of one large fault beside forty of the reference."""
    monkeypatch.setattr(points_cases, "SETTLED", (ONLY,))
    monkeypatch.setattr(points_cases, "HEALTHY_SHARE", 0.0)
    monkeypatch.setattr(points_cases, "COUNTS", (25,))
    monkeypatch.setattr(points_cases, "REFERENCE_COUNT", 40)


def test_every_family_is_one_that_points_can_show() -> None:
    known = hypotheses_of(STATES, ("u_flap_pct",))
    assert set(SETTLED) <= set(known)
    assert FAMILIES[FLAP].tolerance == known[FLAP].tolerance


def test_the_same_seed_draws_the_same_points(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points_cases, "COUNTS", (15,))
    monkeypatch.setattr(points_cases, "REFERENCE_COUNT", 20)
    table, reference, answers = draw_points(2, 7)
    again, _, same = draw_points(2, 7)
    assert answers == same and table.equals(again)
    assert reference is not None and len(reference) == 20 and len(table) == 15
    assert np.isfinite(table.to_numpy()).all() and (table["p_em_pa"] > table["p_im_pa"]).mean() > 0.9
    assert draw_points(2, 7, healthy=True)[2]["effects"] == []


@pytest.mark.thorough
def test_made_run_and_scored(small: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, jobs = tmp_path / "sealed_points", ("--jobs", "1")
    assert main(["challenge", "make", "--tier", "points", "--n", "1", "--seed", "8", "--out", str(out), *jobs]) == 0
    assert ONLY not in (out / "manifest.json").read_text()
    assert main(["challenge", "run", str(out), *jobs]) == 0
    assert main(["challenge", "score", str(out), *jobs]) == 0
    assert "false alarms, healthy" in capsys.readouterr().out
    answers = json.loads((out / "sealed" / "case_0001.json").read_text())
    found = json.loads((out / "results" / "case_0001" / "discrepancy.json").read_text())
    truth = answers["effects"][0]
    effect = found["effects"][0]
    assert effect["name"] == ONLY
    assert effect["magnitude"] == pytest.approx(truth["magnitude"], abs=4.0 * effect["std"])
    assert found["reference"]["recordings"] == 1
    for name, change in answers["since_reference"].items():
        said = found["health"][name]["since_reference"]
        assert said["value"] == pytest.approx(change, abs=4.0 * said["std"]), name


def test_points_of_the_reference_are_refused(small: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, reference, _ = draw_points(1, 8)
    assert reference is not None
    judged, known = tmp_path / "points.csv", tmp_path / "healthy.csv"
    pd.concat([table, reference.head(3)]).to_csv(judged, index=False)
    reference.to_csv(known, index=False)
    assert main(["discover", str(judged), "--reference", str(known), "--out", str(tmp_path / "found")]) == 2
    assert "3 of 28 points that are in a reference too" in capsys.readouterr().err
    assert not (tmp_path / "found").exists()
