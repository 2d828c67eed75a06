"""The frozen verdicts are whole, and a changed verdict is seen and judged by the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.frozen_verdicts import PARTS, Effect, Verdict, compare, difference, main, read_table

LEAK = Effect("boost_leak", 4e-5, 1e-6)
TRUE = (Effect("boost_leak", 4.1e-5, site="intake_mass_balance", ratio=10.0),)
FOUND = Verdict("six/case_0001", "0" * 64, "single", TRUE, {"eta_sc": 1.1}, mismatch=True, site="intake_mass_balance",
                effects=(LEAK,), health={"eta_sc": (1.11, 0.01)})  # fmt: skip
SILENT = replace(FOUND, mismatch=False, site=None, effects=())


@pytest.fixture(scope="module")
def reference(project_root: Path) -> Path:
    return project_root / "benchmarks" / "frozen_verdicts.jsonl"


def test_the_reference_is_whole(reference: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = read_table(reference)
    assert {part: sum(case.startswith(f"{part}/") for case in table) for part in PARTS} == {"six": 40, "five": 20}
    assert {verdict.kind for verdict in table.values()} == {"healthy", "single", "two", "partial", "withheld"}
    assert all(verdict.problem is None and verdict.health for verdict in table.values())
    assert all(bool(verdict.effects) == verdict.mismatch for verdict in table.values())
    assert main(["compare", str(reference), str(reference)]) == 0
    assert capsys.readouterr().out.endswith("60 same, 0 worse\n")


CHANGES: list[tuple[str, Callable[[Verdict], Verdict], str]] = [
    ("nothing", lambda v: v, "same"),
    ("a tenth of a deviation", lambda v: replace(v, effects=(replace(LEAK, magnitude=4.01e-5),)), "same"),
    ("nearer", lambda v: replace(v, effects=(replace(LEAK, magnitude=4.09e-5),)), "better"),
    ("farther", lambda v: replace(v, effects=(replace(LEAK, magnitude=3.8e-5),)), "worse"),
    ("another site", lambda v: replace(v, site="compressor_power"), "worse"),
    ("a wider set", lambda v: replace(v, effects=(replace(LEAK, equivalent_names=("blow_by",)),)), "worse"),
    ("a second name", lambda v: replace(v, effects=(LEAK, Effect("blow_by", 0.02, 0.001))), "worse"),
    ("silence", lambda v: SILENT, "worse"),
    ("a traceback", lambda v: replace(SILENT, problem="ValueError"), "worse"),
    ("another onset", lambda v: replace(v, onset_s=200.0), "other"),
    ("a health parameter", lambda v: replace(v, health={"eta_sc": (1.13, 0.01)}), "other"),
]


@pytest.mark.parametrize(("change", "kind"), [c[1:] for c in CHANGES], ids=[c[0] for c in CHANGES])
def test_a_change_is_judged_by_the_truth(change: Callable[[Verdict], Verdict], kind: str) -> None:
    assert difference(FOUND, change(FOUND), 0.25).kind == kind


def test_an_alarm_on_a_healthy_machine_is_worse_and_its_end_better() -> None:
    alarm, quiet = (replace(v, kind="healthy", truth=()) for v in (FOUND, SILENT))
    assert difference(quiet, alarm, 0.25).kind == "worse"
    assert difference(alarm, quiet, 0.25).kind == "better"


def test_a_withheld_effect_is_right_without_a_name() -> None:
    named = replace(FOUND, kind="withheld", effects=(Effect("blow_by", 0.02, 0.001),))
    none = replace(named, effects=(Effect("none_of_these", None, law="W = 0.01 p_im/p_amb"),))
    assert difference(named, none, 0.25).kind == "better"


def test_the_form_of_a_law_counts_and_its_numbers_do_not() -> None:
    def law(text: str) -> Verdict:
        return replace(FOUND, kind="withheld", effects=(Effect("none_of_these", law=text),))

    first = law("added to W: 0.01 kg/s (T_em/600 K)^2")
    assert first.law_form == "added to W: # kg/s (T_em/# K)^2"
    assert difference(first, law("added to W: 0.011 kg/s (T_em/600 K)^2"), 0.25).kind == "same"
    assert difference(first, law("added to W: 0.01 kg/s (T_em/600 K)^-1"), 0.25).kind == "other"


def test_what_differs_is_printed_beside_the_truth() -> None:
    lines, code = compare({FOUND.case: FOUND}, {FOUND.case: SILENT}, 0.25)
    assert code == 1 and lines[-1] == "0 same, 1 worse"
    assert "boost_leak 4.1e-05 (10 x tolerance) at intake_mass_balance" in lines[0]
    assert any("names: boost_leak -> healthy" in line for line in lines)


def test_a_case_without_a_verdict_is_counted() -> None:
    assert compare({FOUND.case: FOUND}, {}, 0.25) == (["seconds of the cases in both: 0 -> 0", "0 same, 0 worse, "
                                                       "1 not run"], 1)  # fmt: skip


def test_a_file_that_is_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "no.jsonl"
    file.write_text("[]\n")
    assert main(["compare", str(file), str(file)]) == 2
    assert "frozen_verdicts.py table" in capsys.readouterr().err
