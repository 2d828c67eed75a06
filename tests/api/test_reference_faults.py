"""Words for the faults that a reference may have had."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dieseltwin.api.reference_faults import alike_line, hidden_line, suspected_faults
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.files import LearnedEngine, load_learned
from tests.api.learned import learned_file

TOLD = 25.0
LEAK = FaultBeside("exhaust_leak", "m2", 3.3e-5, 3e-6, 121.0, 5e-6)
DRIFT = FaultBeside("injector_drift", "-", 0.03, 0.007, 15.0, 0.01)


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> LearnedEngine:
    found = load_learned(learned_file(Path(tmp_path_factory.mktemp("learned"))))
    assert found is not None
    return found


def _beside(known: LearnedEngine, rival: float) -> LearnedEngine:
    return replace(known, faults=tuple(replace(item, rival=rival) for item in (LEAK, DRIFT)))


def test_a_fault_that_explains_more_than_errors_of_maps_is_suspected(known: LearnedEngine) -> None:
    (said,) = suspected_faults(_beside(known, 104.0), TOLD, said=False)
    assert said.startswith("the reference itself looks like exhaust_leak of 33.0 ± 3.0 mm²") and "11.0 standard" in said
    assert suspected_faults(_beside(known, 104.0), TOLD, said=True) == []
    assert suspected_faults(_beside(known, 200.0), TOLD, said=False) == []
    assert suspected_faults(known, TOLD, said=False) == []  # of a file that an earlier version wrote


def test_errors_of_maps_are_said_to_look_like_the_faults_that_fit_best(known: LearnedEngine) -> None:
    (line,) = alike_line(_beside(known, 200.0), TOLD)
    assert "exhaust_leak of 33.0 ± 3.0 mm² (60 % of what they gain)" in line and "injector_drift" not in line
    assert "none of the main ones fits nearly as well" in alike_line(_beside(known, 1e4), TOLD)[0]
    assert alike_line(_beside(known, 0.0), TOLD) == []


def test_what_a_reference_could_hide_is_said_with_its_size(known: LearnedEngine) -> None:
    assert "exhaust_leak 15 mm², injector_drift 3.5 %" in hidden_line(_beside(known, 0.0), TOLD)[0]
    assert "exhaust_leak 42 mm²" in hidden_line(_beside(known, 200.0), TOLD)[0]
    assert hidden_line(known, TOLD) == []
