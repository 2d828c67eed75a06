"""A law at a point that looks weak by its linear score."""

from __future__ import annotations

from pathlib import Path

import pytest

from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.options import Options
from dieseltwin.engine import we2011
from dieseltwin.recordings.reader import read_recording
from examples.discovery_cases import CASES, make_recording


@pytest.mark.thorough
def test_a_law_that_leaves_too_much_is_looked_for_everywhere(tmp_path: Path) -> None:
    """A back pressure of 90 kPa/(kg/s)^2 was a law of the turbine's efficiency, with 1.4 of chi-square left."""
    (case,) = (case for case in CASES if case.name == "withheld_back_pressure")
    make_recording(case, tmp_path / "recording.csv")
    found = discover(read_recording(tmp_path / "recording.csv"), we2011.PARAMETERS, Options(withhold=case.withhold))
    (effect,) = found.document.effects
    assert found.document.location is not None and found.document.location.site == "turbine_flow"
    assert effect.law is not None and effect.law.endswith("(W_t/0.2 kg/s)^2 (T_em/600 K)")
    assert not found.document.more_is_missing
