"""The sealed tier of petrol engines: made, run, opened and scored by the same commands."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.challenge import petrol_cases
from dieseltwin.challenge.petrol_cases import FAMILIES, draw_petrol
from dieseltwin.challenge.records import petrol_truth
from dieseltwin.challenge.run import _calibrated
from dieseltwin.cli.app import main
from dieseltwin.errors import InputError
from dieseltwin.petrol.effects import HYPOTHESES

ONLY = "w_af_gain"


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five minutes of one fault from the start on: what is drawn is as quick as it goes."""
    monkeypatch.setattr(petrol_cases, "MINUTES", (5.0,))
    monkeypatch.setattr(petrol_cases, "FROM_THE_START", 1.0)
    monkeypatch.setattr(petrol_cases, "FAMILIES", {ONLY: FAMILIES[ONLY]})
    monkeypatch.setattr(petrol_cases, "CALIBRATION_S", 900.0)


def test_places_and_sizes_of_interest_are_those_of_the_catalogue() -> None:
    """They are written twice, as the plant imports nothing of what it proves."""
    for name, family in FAMILIES.items():
        known = HYPOTHESES[name]
        assert (family.site, family.tolerance) == (known.site, known.tolerance)
        assert all(known.limits[0] <= size <= known.limits[1] for size in family.sizes)


def test_the_same_seed_draws_the_same_machine(short: None) -> None:
    table, answers = draw_petrol(3, 17)
    again, same = draw_petrol(3, 17)
    assert answers == same and table.equals(again)
    assert not table.equals(draw_petrol(3, 18)[0])
    assert draw_petrol(3, 17, healthy=True)[1]["effects"] == []
    if answers["gap_s"] is not None:
        assert not table["time_s"].between(*answers["gap_s"]).any()
    assert all(np.isfinite(table[column]).all() for column in table)


def test_made_run_and_scored(
    short: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, jobs = tmp_path / "sealed_petrol", ("--jobs", "1")
    assert main(["challenge", "make", "--tier", "petrol", "--n", "2", "--seed", "5", "--out", str(out), *jobs]) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["tier"] == "petrol"
    opened = json.dumps(manifest)
    assert ONLY not in opened and "magnitude" not in opened
    assert main(["challenge", "run", str(out), *jobs]) == 0
    kept = (out / "results" / "petrol_engine.yaml").stat().st_mtime_ns
    entry = manifest["cases"][0]
    assert _calibrated(out, entry).stat().st_mtime_ns == kept
    monkeypatch.setattr("dieseltwin.challenge.run.code_sha256", lambda *parts: "another calibration")
    assert _calibrated(out, entry).stat().st_mtime_ns > kept
    assert main(["challenge", "score", str(out), *jobs]) == 0
    said = capsys.readouterr().out
    score = json.loads((out / "score" / "score.json").read_text())
    answers = [json.loads((out / "sealed" / f"case_000{k}.json").read_text()) for k in (1, 2)]
    assert all(a["seed"] == 5 for a in answers)
    assert "beforehand: seed, answers, recordings, references." in (out / "score" / "score.md").read_text()
    large = [truth for a in answers for truth in petrol_truth(a) if truth.ratio >= 3.0]
    line = next(item for item in score["lines"] if item["key"] == "name_in_set")
    assert line["numbers"]["of"] == len(large) == line["numbers"]["hits"] and large
    assert "false alarms, healthy" in said
    (out / "sealed" / "case_0001.json").write_text("{}")
    with pytest.raises(InputError, match="hash"):
        from dieseltwin.challenge.score import score_challenge

        score_challenge(out)
