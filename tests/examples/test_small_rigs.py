"""The two real rigs: what was left out is named, and the half that no fit has seen is simulated better."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dieseltwin.rigs.discover import discover_rig
from dieseltwin.rigs.parameters import load_rig
from dieseltwin.rigs.recording import read_rig
from dieseltwin.rigs.rounds import Options, RigDiscovery
from dieseltwin.rigs.simulate import run_error
from dieseltwin.settings.defaults import default_search

ROOT = Path(__file__).parents[2]


def _halves(rig_name: str, relative: str, most_effects: int) -> tuple[RigDiscovery, float]:
    """What is found on the first half, and the repaired machine's error on the other over the fitted one's.

    `most_effects`: as many as are asked for below; what is named after them makes the error smaller still.
    """
    roots = [os.environ.get("DIESELTWIN_DATA"), ROOT.parent / "shared" / "data"]
    path = next((Path(root) / relative for root in roots if root and (Path(root) / relative).is_file()), None)
    if path is None:
        pytest.skip(f"no {relative}: set DIESELTWIN_DATA to the folder of the recordings")
    rig = load_rig(ROOT / "examples" / "rigs" / f"{rig_name}.yaml")
    whole = read_rig(path, rig)
    half = len(whole.time_s) // 2
    search = default_search().rigs.model_copy(update={"most_effects": most_effects})
    options = Options(law_search=False, search=search)  # the law search takes a minute, and keeps nothing here
    found, late = discover_rig(whole.part(slice(0, half)), rig, options), whole.part(slice(half, None))
    return found, float(run_error(found.repaired, late)[0] / run_error(found.before, late)[0])


@pytest.mark.thorough
def test_positioning_axis() -> None:
    found, share = _halves("positioning_axis", "emps/emps_train.csv", 2)
    sizes = {term.effect: term.magnitude for term in found.repaired.terms}
    assert found.rounds[0].names[0] == "coulomb_friction"
    assert sizes["coulomb_friction"] == pytest.approx(20.4, rel=0.15)  # Janot, Gautier, Brunot 2019
    assert sizes["constant_force"] == pytest.approx(-3.16, rel=0.2)
    assert found.repaired.parameters["mass"].value == pytest.approx(95.1, rel=0.08)
    assert share < 0.35


@pytest.mark.thorough
def test_cascaded_tanks() -> None:
    found, share = _halves("cascaded_tanks", "cascaded_tanks/estimation.csv", 2)
    assert "upper_overflow" in found.rounds[0].names
    assert share < 0.7
