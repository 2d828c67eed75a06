"""The two real rigs: what was left out is named, and the half that no fit has seen is simulated better."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))


def _recording(relative: Path) -> Path:
    roots = [os.environ.get("DIESELTWIN_DATA"), ROOT.parent / "shared" / "data"]
    for root in roots:
        if root and (Path(root) / relative).is_file():
            return Path(root) / relative
    pytest.skip(f"no {relative}: set DIESELTWIN_DATA to the folder of the recordings")


def test_positioning_axis():
    import _show
    import positioning_axis as axis

    story, _, _, errors = _show.evaluate(axis.twin, _recording(axis.DATA), 1.0, 3.0, 1e-5)
    first, second = story.steps[:2]
    assert (first.name, first.site) == ("coulomb_friction", "force_balance") and not first.rivals
    assert "constant_force" in (second.name, *second.rivals)
    coulomb = story.magnitudes["coulomb_friction"][0] + 0.5 * story.magnitudes.get("asymmetric_friction", (0.0, 0.0))[0]
    assert coulomb == pytest.approx(20.4, rel=0.15)  # Janot, Gautier, Brunot 2019
    assert story.after.parameters[0] == pytest.approx(95.1, rel=0.08)
    assert errors["names"] < 0.35 * errors["before"]


def test_cascaded_tanks():
    import _show
    import cascaded_tanks as tanks

    story, _, _, errors = _show.evaluate(tanks.twin, _recording(tanks.DATA), 350.0, None, 0.01, 50)
    assert story.steps[0].name == "upper_overflow"
    assert errors["names"] < 0.6 * errors["before"]
