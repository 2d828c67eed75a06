"""Effects that begin at a point: settled points in the order of the file are a sequence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.onsets import FEWEST, may_begin
from dieseltwin.calibration.saved import answers_of, as_repaired_by, load_repaired, write_repaired
from dieseltwin.calibration.steady_model import SteadyModel, term_values
from dieseltwin.calibration.told_apart import sensor_notes
from dieseltwin.calibration.verdict import details, document
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term, effect_terms
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.steady_points import SINCE, SteadyPoints
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
    (term,) = effect_terms(found.engine().terms)
    assert isinstance(term, Term) and term.effect == "boost_leak" and term.onset_s is None


def test_the_repaired_engine_judges_its_own_points_from_the_onset_on(found: PointsDiscovery, tmp_path: Path) -> None:
    write_repaired(found, tmp_path / "repaired.yaml")
    row = found.onsets["boost_leak"].row
    same = replace(found.calibration.points, sha256="a", notes=())
    other = replace(same, sha256="b")
    assert as_repaired_by(tmp_path / "repaired.yaml", same) is same  # it wasn't said which points they were
    read = replace(found, repaired=replace(found.repaired, points=replace(found.points, sha256="a")))
    write_repaired(read, tmp_path / "repaired.yaml")
    assert as_repaired_by(tmp_path / "repaired.yaml", other) is other
    told = as_repaired_by(tmp_path / "repaired.yaml", same)
    by_imply = load_repaired(tmp_path / "repaired.yaml").acting(same)
    assert told.notes == by_imply.notes and np.array_equal(told[f"{SINCE}boost_leak"], by_imply[f"{SINCE}boost_leak"])
    assert "boost_leak (since data row" in told.notes[0]
    assert np.array_equal(told[f"{SINCE}boost_leak"], same.row >= row)
    model = SteadyModel(found.engine())
    x, values = same.states(), {"h_tot": found.engine().h_tot, **term_values(found.engine().terms)}
    acting, without = model.relations(told, x, values), model.relations(same, x, {**values, "boost_leak": 0.0})
    before = same.row < row
    apart = np.abs(acting.residual[0] - without.residual[0])[:, 0]
    assert apart[before].max() < 2e-4  # the middle flow, by which small ones are damped, is another one
    assert np.median(apart[~before]) > 0.01


def test_what_is_left_near_by_is_told_with_the_onset(found: PointsDiscovery) -> None:
    local = answers_of(found).first.local
    assert local is not None and f"{SINCE}boost_leak" in local.points
    left, acts = local.residual(answers_of(found).first.values)[0][:, 0], local.points[f"{SINCE}boost_leak"] > 0.5
    assert abs(left[acts].mean() - left[~acts].mean()) < 0.01


def test_a_charge_that_reads_too_much_since_a_point_leaves_nothing_else() -> None:
    generator = np.random.default_rng(2)
    made = made_points(TRUTH, count=80, noise=0.004)
    charge = TRUTH.T_im + 0.4 * generator.standard_normal(made.size) + np.where(np.arange(made.size) < 40, 0.0, 12.0)
    found = discovered(made.with_columns(t_im_k=charge))
    magnitude, std = found.effects["t_im_k:offset"]
    assert magnitude == pytest.approx(12.0, abs=2.0 * std) and not found.more_is_missing
    (note,) = sensor_notes(found)  # a charge of one temperature: 4 % too much is 12 K too much
    assert note.affects == ("t_im_k",) and "can't be told apart" in note


def test_points_in_an_order_of_their_own_say_nothing_of_an_onset() -> None:
    inputs = made_points(TRUTH, count=60).inputs()
    mixed, by_speed = may_begin(inputs, 0.1), may_begin(inputs[np.argsort(inputs[:, 0])], 0.1)
    assert mixed[10:50].all() and not mixed[: max(6, FEWEST)].any() and not mixed[-5:].any()
    assert not by_speed[15:45].any()
