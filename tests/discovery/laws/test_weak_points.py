"""A law at a point that looks weak by its linear score."""

from __future__ import annotations

from pathlib import Path

import pytest

from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.options import Options
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.recordings.reader import read_recording, recording
from examples.discovery_cases import CASES, make_recording
from tests.api.simulated import drive


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


@pytest.mark.thorough
def test_a_lag_of_the_gas_without_its_name_is_no_lag_of_the_fuel() -> None:
    """It gained most of what is missing, and the gas' own wasn't among the terms without a name."""
    slow = we2011.PARAMETERS.replace(terms=(Term(effect="exhaust_thermal_inertia", magnitude=1.0),))
    options = Options(withhold=("exhaust_thermal_inertia",))
    (effect,) = discover(recording(drive(180.0, slow)), we2011.PARAMETERS, options).document.effects
    assert effect.law is not None and effect.law.startswith("T_em becomes lag[T_em, ")
    assert float(effect.law.split(",")[1].split("±")[0]) == pytest.approx(1.0, abs=0.1)
