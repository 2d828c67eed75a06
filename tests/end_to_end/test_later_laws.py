"""What has no name and begins in the middle: what it is, how large, since when; in the repaired engine, too."""

from __future__ import annotations

import pytest

from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.discovery.discover import discover
from dieseltwin.discovery.options import Options
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import NONE_OF_THESE
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import LawTerm, SensorTerm
from dieseltwin.recordings.reader import recording
from tests.end_to_end.engines import Machine, recorded

SINCE_S = 150.0


def _discovered(fault: Fault) -> tuple[Discovery, str]:
    """What is found of a fault whose name is withheld, and where."""
    table = recorded(Machine((fault,)), seed=5)
    columns = {name: table[name].to_numpy() for name in table}
    found = discover(recording(columns), we2011.PARAMETERS, Options(withhold=(fault.effect,)))
    (effect,), location = found.document.effects, found.document.location
    assert effect.name == NONE_OF_THESE and effect.law is not None and location is not None
    assert location.onset_s == pytest.approx(SINCE_S, abs=3.0) and not found.document.more_is_missing
    assert location.onset_range_s is not None
    low, high = location.onset_range_s
    assert low <= SINCE_S <= high < low + 10.0 and low <= location.onset_s <= high
    return found, location.site


def test_a_sensors_gain_that_begins_later_is_a_law_since_then() -> None:
    """It was 5 % less fuel since 36 s, as long as no term without a name could begin later."""
    found, site = _discovered(Fault("t_em_gain", -0.08, SINCE_S))
    assert site == "sensor:t_em_k"
    (term,) = found.engine.terms
    assert isinstance(term, SensorTerm) and term.fault == "gain" and term.onset_s == pytest.approx(SINCE_S, abs=3.0)
    assert term.magnitude == pytest.approx(-0.08, abs=0.008)


@pytest.mark.thorough
def test_a_leak_that_begins_later_is_a_nozzle_since_then() -> None:
    """8e-5 m2: at 1 bar and 300 K 0.0187 kg/s where it chokes."""
    found, site = _discovered(Fault("boost_leak", 8e-5, SINCE_S))
    assert site == "intake_mass_balance"
    (term,) = found.engine.terms
    assert isinstance(term, LawTerm) and term.onset_s == pytest.approx(SINCE_S, abs=3.0)
    assert [group.kind for group in term.groups] == ["orifice"] and ("p_im", 1e5, 1.0) in term.factors
    assert term.coefficient == pytest.approx(-0.0187, rel=0.08)
