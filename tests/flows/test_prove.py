"""The concealed benchmark as a flow: the tool sees a recording alone, case by case, then the seal is opened."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dieseltwin.settings.params import load_params
from tasks import prove as steps
from tasks import run_context
from tasks.run_context import RunContext
from tasks.store import content_hash
from tasks.workspace import Workspace

CASES = 3
SECTIONS = {"sections": steps.case.sections_of(load_params().model_dump(mode="json"))}


def made() -> run_context.Artifact:
    return steps.benchmark(cases=CASES, seed=5, tier="main", sensors=6, duration_s=60.0, jobs=1)


def test_the_tool_sees_the_recording_alone(
    faked_discovery: Callable[[], RunContext], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = tmp_path / "calls.txt"
    monkeypatch.setenv("FAKE_DISCOVERY_CALLS", str(calls))
    benchmark = made()
    entry = steps.cases_of(benchmark)[0]
    artifact = steps.recording_of(benchmark, entry)
    assert artifact.path.is_file() and "sealed" not in str(artifact.path)
    found = steps.case(recording=artifact, kind=entry["case"], withhold=entry["withhold"], tier="main", **SECTIONS)
    where, *files = calls.read_text().split(maxsplit=1)
    assert files == [f"['{entry['case']}']\n"] and not Path(where).is_relative_to(tmp_path)
    assert json.loads((found.path / "discrepancy.json").read_text())["schema"] == 1
    # Times are no part of the result's hash.
    assert json.loads((found.path / "runtime.json").read_text())["seconds"] >= 0.0
    assert "runtime.json" not in json.loads((found.path / "manifest.json").read_text())["files"]


@pytest.mark.thorough
def test_a_case_that_fails_is_a_result_without_its_time(
    faked_discovery: Callable[[], RunContext], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_DISCOVERY_FAILS", "1")
    benchmark = made()
    entry = steps.cases_of(benchmark)[1]
    recording = steps.recording_of(benchmark, entry)
    found = steps.case(recording=recording, kind=entry["case"], withhold=[], tier="main", **SECTIONS)
    failed = json.loads((found.path / "failed.json").read_text())
    assert "no convergence" in failed["error"] and "seconds" not in failed
    opened = steps.opened(benchmark=benchmark, result=found, kind=entry["case"], **SECTIONS)
    parts = {f"result_{entry['case']}": found, f"opened_{entry['case']}": opened}
    scored = steps.score(benchmark=benchmark, **parts, **SECTIONS)
    rows = json.loads((scored.path / "rows.json").read_text())["rows"]
    assert [row["problem"] for row in rows] == [failed["error"]]


def test_numbers_of_a_line_are_flat() -> None:
    numbers = {"value": 0.5, "hits": 1, "interval": [0.1, 0.9], "by_name": {"eta_sc": 2.0}, "text": "x", "none": None}
    assert dict(steps.flat_numbers("site", numbers)) == {
        "site": 0.5,
        "site_hits": 1.0,
        "site_low": 0.1,
        "site_high": 0.9,
        "site_by_name_eta_sc": 2.0,
    }


@pytest.mark.flow
def test_the_flow_publishes_logs_and_resumes(
    prefect: None, faked_discovery: Callable[[], RunContext], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flows.prove import prove
    from tasks.tracking import Tracker

    calls = tmp_path / "calls.txt"
    monkeypatch.setenv("FAKE_DISCOVERY_CALLS", str(calls))
    prove("tiny")
    assert len(calls.read_text().splitlines()) == CASES
    published = {path.name for path in (tmp_path / "proof").iterdir()}
    assert published == set(steps.COMPARED)
    assert (tmp_path / "reports" / "proof" / "score.md").exists()
    before = content_hash(tmp_path / "proof")

    # One case is lost, as after a kill: that one alone runs again.
    lost = next(path.parent for path in (tmp_path / ".cache" / "case").glob("*/discrepancy.json"))
    (lost / "discrepancy.json").write_text("{}")
    context = faked_discovery()
    prove("tiny")
    assert len(calls.read_text().splitlines()) == CASES + 1
    assert len(context.timings) == 1 and next(iter(context.timings)).startswith("case-case_")
    assert content_hash(tmp_path / "proof") == before

    client = Tracker(Workspace(tmp_path)).client
    experiment = client.get_experiment_by_name("prove")
    runs = {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}
    assert {f"case_{k:04d}" for k in range(1, CASES + 1)} <= set(runs)
    table = json.loads((tmp_path / "proof" / steps.METRICS).read_text())
    top = runs[f"benchmark {CASES} cases"].data
    assert top.metrics["detection_hits"] == table["detection_hits"] and top.params["tier"] == "main"
    assert not any("second" in name or name.startswith("time") for name in table)
    assert os.environ["PREFECT_HOME"]
