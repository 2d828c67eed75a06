"""Learning through the front door: the engine that is learned is the one that its file holds."""

from __future__ import annotations

from pathlib import Path

import dieseltwin as dt
from dieseltwin.engine import we2011
from tests.api.simulated import drive


def test_an_engine_is_learned_saved_and_taken(tmp_path: Path) -> None:
    healthy = drive(150.0, we2011.PARAMETERS.replace(eta_cmax=0.72, A_egrmax=3.6e-4))
    found = dt.learn([healthy], map_error=0.02)
    table = found.table()
    assert len(table) > 0 and (table["known_to_pct"] < 0.5 * table["believed_pct"]).all()
    assert found.sentence.startswith("Learned from 2.5 minutes") and "<table" in found._repr_html_()
    assert len(found.plot().axes) == 1
    file = found.save(tmp_path / "mine.yaml")
    assert dt.engine(file) == found.engine
