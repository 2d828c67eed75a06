"""A valve that stands still, from the recording to the verdict and to the machine that the next search takes."""

from __future__ import annotations

from pathlib import Path

import pytest

import dieseltwin as dt
from dieseltwin.discovery.discover import Options, prepare
from dieseltwin.discovery.search.standing import names_of, worth_trying
from dieseltwin.engine import EngineParameters, we2011
from dieseltwin.engine.terms import Term
from tests.api.simulated import drive
from tests.pages import without_pictures

WORN = we2011.PARAMETERS.replace(A_egrmax=0.85 * we2011.PARAMETERS.A_egrmax, h_tot=1.1 * we2011.PARAMETERS.h_tot)


def _with(*terms: Term) -> EngineParameters:
    return WORN.replace(terms=terms)


def test_vanes_that_seized_are_named_dated_and_repaired(tmp_path: Path) -> None:
    """And what is missing beside them is found by the next search, on the machine that the first one left."""
    path = tmp_path / "drive.csv"
    drive(150.0, _with(Term(effect="vgt_stuck", magnitude=42.0, onset_s=61.0),
                       Term(effect="boost_leak", magnitude=6e-5))).to_csv(path, index=False)  # fmt: skip
    found = dt.discover(path)
    document = found.document
    (effect,), place = document.effects, document.location
    assert effect.name == "vgt_stuck" and effect.probability > 0.99 and place is not None
    assert place.site == "vgt_actuator" and place.until_s is None
    assert place.onset_s == pytest.approx(61.0, abs=2.0) and effect.magnitude == pytest.approx(42.0, abs=3.0)
    assert document.more_is_missing and "stand still" in found.sentence
    with without_pictures():
        found.save(tmp_path / "first")
    again = dt.discover(path, engine=tmp_path / "first" / "engine.yaml").document
    assert [effect.name for effect in again.effects] == ["boost_leak"]
    assert again.effects[0].magnitude == pytest.approx(6e-5, rel=0.1)
    for name, value in again.health.items():
        assert abs(value.value - getattr(WORN, name)) < 4.0 * (value.std or 0.0)


@pytest.mark.thorough
def test_vanes_that_stood_for_a_while_are_given_their_span(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    drive(150.0, _with(Term(effect="vgt_stuck", magnitude=42.0, onset_s=40.0, until_s=95.0))).to_csv(path, index=False)
    document = dt.discover(path).document
    (effect,), place = document.effects, document.location
    assert effect.name == "vgt_stuck" and place is not None and not document.more_is_missing
    assert (place.onset_s, place.until_s) == (pytest.approx(40.0, abs=2.0), pytest.approx(95.0, abs=2.0))
    assert abs((effect.magnitude or 0.0) - 42.0) < 4.0 * (effect.std or 0.0)


@pytest.mark.thorough
def test_a_valve_that_sticks_now_and_then_is_given_its_parts(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    term = Term(effect="vgt_stuck", magnitude=42.0, onset_s=25.0, until_s=125.0, gone_s=((60.0, 85.0),))
    drive(150.0, _with(term)).to_csv(path, index=False)
    document = dt.discover(path).document
    (effect,), place = document.effects, document.location
    assert effect.name == "vgt_stuck" and place is not None and not document.more_is_missing
    times = (place.onset_s, *place.gone_s[0], place.until_s)
    assert times == pytest.approx((25.0, 60.0, 85.0, 125.0), abs=2.0)
    assert abs((effect.magnitude or 0.0) - 42.0) < 4.0 * (effect.std or 0.0)


@pytest.mark.thorough
def test_vanes_that_stood_all_along_leave_health_as_believed(tmp_path: Path) -> None:
    """Their position and the area of health can't be told apart, and are told as badly as that."""
    path = tmp_path / "drive.csv"
    drive(120.0, _with(Term(effect="vgt_stuck", magnitude=45.0))).to_csv(path, index=False)
    document = dt.discover(path).document
    (effect,), area = document.effects, document.health["A_vgtmax"]
    assert effect.name == "vgt_stuck" and document.location is not None and document.location.onset_s is None
    assert (effect.std or 0.0) > 5.0 and (area.std or 0.0) > 0.1 * WORN.A_vgtmax
    assert abs(area.value - WORN.A_vgtmax) < 2.0 * (area.std or 0.0)


def test_no_other_fault_is_taken_for_a_valve(tmp_path: Path) -> None:
    """A large leak leaves as much as a valve; a command that hardly moves says nothing of its valve."""
    path = tmp_path / "drive.csv"
    drive(90.0, _with(Term(effect="exhaust_leak", magnitude=1e-4))).to_csv(path, index=False)
    leaking = prepare(dt.read(path), we2011.PARAMETERS).found
    assert worth_trying(leaking) and not leaking.standing
    settings = Options(withhold=("egr_stuck", "vgt_stuck")).settings()
    assert names_of(leaking.twin, settings) == []
