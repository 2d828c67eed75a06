"""Effects that begin at a point: settled points in the order of the file are a sequence."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.onsets import FEWEST, may_begin
from dieseltwin.calibration.verdict import details, document
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.steady_points import SteadyPoints
from dieseltwin.report.points import sentence
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points

HOLE_M2 = 30e-6
BEFORE, BEHIND = 34, 30


def together(*parts: SteadyPoints) -> SteadyPoints:
    """Points of one file, one part behind the other."""
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0].columns}
    return SteadyPoints(Columns(columns), np.arange(1, len(next(iter(columns.values()))) + 1))


def discovered(data: SteadyPoints) -> PointsDiscovery:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        one = default_search().points.model_copy(update={"most_effects": 1})
        return discover_points(calibrate(data, we2011.PARAMETERS, GEOMETRY), Options(law_search=False, search=one))


@pytest.fixture(scope="module")
def found() -> PointsDiscovery:
    """A hose came off before point 35 of 64."""
    well = made_points(TRUTH, count=BEFORE, noise=0.004, seed=3)
    return discovered(together(well, made_points(TRUTH, BEHIND, 0.004, 4, {"boost_leak": HOLE_M2})))


def test_a_leak_since_a_point_is_found(found: PointsDiscovery) -> None:
    magnitude, std = found.effects["boost_leak"]
    assert magnitude == pytest.approx(HOLE_M2, abs=min(3.0 * std, 0.15 * HOLE_M2))
    assert found.onsets["boost_leak"].row == pytest.approx(BEFORE + 1, abs=2)
    assert found.onsets["boost_leak"].acts.sum() == pytest.approx(BEHIND, abs=2)


def test_the_document_and_the_words_say_since_which_point(found: PointsDiscovery) -> None:
    said = document(found)
    row = found.onsets["boost_leak"].row
    assert said.effects[0].since_row == row and said.p_value < 1e-6
    assert f"since data row {row}" in sentence(found)
    assert details(found, {})["rounds"][0]["since_row"] == row


def test_the_repaired_engine_is_that_of_the_last_point(found: PointsDiscovery) -> None:
    (term,) = found.engine().terms
    assert isinstance(term, Term) and term.effect == "boost_leak" and term.onset_s is None


def test_points_in_an_order_of_their_own_say_nothing_of_an_onset() -> None:
    inputs = made_points(TRUTH, count=60).inputs()
    mixed, by_speed = may_begin(inputs, 0.1), may_begin(inputs[np.argsort(inputs[:, 0])], 0.1)
    assert mixed[10:50].all() and not mixed[: max(6, FEWEST)].any() and not mixed[-5:].any()
    assert not by_speed[15:45].any()
