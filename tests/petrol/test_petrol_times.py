"""When something happened is said with the file's own time stamps, wherever it is said."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

import dieseltwin as dt
from dieseltwin.api.petrol import PetrolDiscovered
from dieseltwin.petrol.parameters import PetrolParameters
from dieseltwin.petrol.recording import PetrolRecording
from dieseltwin.report.petrol import balances_over_time

Recorder = Callable[..., PetrolRecording]
FIRST_S, ONSET_S, STUCK_S = 1500.0, 80.0, 180.0


@pytest.mark.usefixtures("no_pictures")
def test_a_file_that_begins_late(engine: PetrolParameters, record: Recorder, tmp_path: Path) -> None:
    """A fault since 100 s and an air flow that stands still from 240 s on, in a file that begins at 1500 s."""
    table = pd.read_csv(record(7, 240.0, onset_s=ONSET_S, p_im_Pa=0.1).path)
    still = table.time_s >= STUCK_S
    table.loc[still, "W_af_kg_s"] = table.W_af_kg_s[still].iloc[0]
    table["time_s"] += FIRST_S
    table.to_csv(tmp_path / "late.csv", index=False)
    found = dt.discover(tmp_path / "late.csv", engine)
    assert isinstance(found, PetrolDiscovered)
    location = found.document.location
    assert location is not None and location.onset_s == pytest.approx(FIRST_S + ONSET_S, abs=3.0)
    assert f"since {location.onset_s:.0f} s" in found.sentence
    assert any("w_af_kg_s stands still for 60 s from 1680 s on" in doubt["text"] for doubt in found.warnings)
    drawn = balances_over_time(found.found)
    assert drawn.marks[0].at == location.onset_s
    assert drawn.panels[0].x.min() > FIRST_S
    found.save(tmp_path / "out")
    onsets = re.findall(r'"onset_s": ([0-9.]+)', (tmp_path / "out" / "details.json").read_text())
    assert onsets and min(map(float, onsets)) > FIRST_S
