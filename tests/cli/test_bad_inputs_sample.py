"""A sample of the bad inputs of `benchmarks.bad_inputs`, which runs all of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.bad_inputs.cases import Case, cases
from benchmarks.bad_inputs.run import run_case

QUICK = ("yaml as engine", "yaml as params", "engine value: V_d", "engine value: J_t", "learned:", "data fetch from")
SAMPLE = [case for case in cases() if case.name.startswith(QUICK)][::3]


@pytest.mark.parametrize("case", SAMPLE, ids=lambda case: case.name[:60])
def test_a_bad_input_is_refused_in_one_line(tmp_path: Path, case: Case) -> None:
    outcome = run_case(case, tmp_path)
    assert not outcome.faults, outcome


def test_there_are_four_hundred() -> None:
    assert len({case.name for case in cases()}) >= 400
