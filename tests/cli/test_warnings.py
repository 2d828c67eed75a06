"""What is doubtful stands in the document, and in the exit code when asked."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.bad_inputs.cases import good_files
from dieseltwin.cli.app import main
from dieseltwin.notes import STRICT_CODE, Note, warnings_of

pytestmark = pytest.mark.usefixtures("no_pictures")


def test_a_note_keeps_its_code_in_copies() -> None:
    note = Note("p_im_pa stands still", "frozen_channel", ("p_im_pa",))
    assert note == "note: p_im_pa stands still"
    expected = [{"code": "frozen_channel", "text": "p_im_pa stands still", "affects": ["p_im_pa"]}]
    assert warnings_of([copy.deepcopy(note)]) == warnings_of([note]) == expected


def test_identify_says_its_doubts_in_the_document_and_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dieseltwin.report.html.identification_sections", lambda *_: [])
    good_files(tmp_path)
    drive = pd.read_csv(tmp_path / "drive.csv")
    drive.loc[5:8, "u_vgt_pct"] = 5.0  # outside the engine's range
    drive.to_csv(tmp_path / "drive.csv", index=False)
    out = tmp_path / "out"
    line = ["identify", str(tmp_path / "drive.csv"), "--out", str(out), "--runs", "1", "--strict"]
    assert main(line) == STRICT_CODE
    warnings = json.loads((out / "identification.json").read_text())["warnings"]
    found = {warning["code"]: warning for warning in warnings}
    assert found["out_of_range"]["affects"] == ["u_vgt_pct"]
    assert "4 of" in found["out_of_range"]["text"]
