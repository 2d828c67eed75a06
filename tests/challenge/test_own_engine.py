"""The own-engine tier: one machine, one set of sensors, wear since the reference, each recording its own weather."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.challenge.cases import Case, Plan, build_case
from dieseltwin.challenge.own_engine import WEAR
from dieseltwin.challenge.records import CaseRow
from dieseltwin.challenge.table import lines
from dieseltwin.engine import HEALTH, we2011


@pytest.fixture(scope="module")
def case() -> Case:
    plan = Plan(1, "healthy", (), ("boost_leak",), "random")
    laboratory = we2011.PARAMETERS.model_dump()
    return build_case(plan, 3, laboratory, tier="own-engine", duration_s=60.0, reference_min=1.5)


def test_wear_is_what_is_between_reference_and_case(case: Case):
    for name, (low, high) in WEAR.items():
        assert 1.0 + low <= case.answers["since_reference"][name] <= 1.0 + high
        assert case.answers["health"][name] == case.machine.parameters[name]


def test_every_recording_has_its_own_ambient(case: Case):
    days = [frame["p_amb_pa"].iloc[0] for frame in (case.recording, case.held_out, *case.references)]
    assert len(set(days)) == len(days) and np.ptp(days) < 6000.0
    assert [round(frame["time_s"].iloc[-1]) for frame in case.references] == [90]


def test_the_reference_is_other_driving(case: Case):
    assert not np.allclose(case.recording["n_e_rpm"].to_numpy()[:200], case.references[0]["n_e_rpm"].to_numpy()[:200])


def test_the_table_has_a_line_for_the_change_since_the_reference():
    true = dict.fromkeys(HEALTH, 0.9)
    row = CaseRow("case_0001", "healthy", None, "random", (), (), since_true=true,
                  since_said={name: (0.903, 0.003) for name in HEALTH})  # fmt: skip
    found = {line.key: line for line in lines([row])}
    assert "A_egrmax 0.33 %" in found["since"].value and found["since"].passed
    assert "4/4" in found["since_coverage"].value
    assert "since" not in {line.key for line in lines([CaseRow("case_0002", "healthy", None, "random", (), ())])}
