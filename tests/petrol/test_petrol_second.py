"""A second fault in another channel is said beside the first, and only where there is one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from dieseltwin.petrol.discover import discover_petrol
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording, read_petrol

Recorder = Callable[..., PetrolRecording]


@pytest.mark.thorough
def test_two_faults_since_different_times(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    table = pd.read_csv(record(18, 420.0, onset_s=80.0, W_af_kg_s=0.06).path)
    table.loc[table.time_s >= 250.0, "T_ic_K"] += 15.0
    table.to_csv(tmp_path / "two.csv", index=False)
    recording = read_petrol(tmp_path / "two.csv")
    first = discover_petrol(recording, engine)
    d = first.document
    assert d.more_is_missing and d.fit.share_explained is not None and d.fit.share_explained < 0.95
    assert {"more_is_missing", "next_effect"} <= {doubt.code for doubt in d.warnings}
    names = {"w_af_gain", "t_ic_offset"}
    named = d.effects[0].name
    (other,) = names - {named}
    said = next(doubt.text for doubt in d.warnings if doubt.code == "next_effect")
    assert named in names and other in said and f"({other})" in first.sentence
    second = discover_petrol(recording, first.engine)
    assert second.document.effects[0].name == other and f"Beside it, {said[11:40]}" in first.sentence
    third = discover_petrol(recording, second.engine)
    assert not third.document.mismatch


@pytest.mark.parametrize("fault", [{"W_af_kg_s": 0.1}, {"p_im_Pa": -0.06}], ids=["w_af", "p_im"])
def test_one_fault_is_one(engine: PetrolParameters, record: Recorder, fault: dict[str, float]) -> None:
    found = discover_petrol(record(19, 300.0, onset_s=120.0, **fault), engine)
    assert found.document.mismatch and not found.document.more_is_missing
    assert found.document.fit.share_explained == pytest.approx(1.0) and "Beside it" not in found.sentence
