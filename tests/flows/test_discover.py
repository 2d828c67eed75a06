"""Discovery as a flow: many recordings, one that is refused, results by content, figures in MLflow."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from dieseltwin.errors import InputError
from tasks import discover as steps
from tasks import prove
from tasks.failures import StepFailed
from tasks.run_context import RunContext
from tasks.store import content_hash
from tasks.workspace import Workspace


def test_recordings_are_named_by_their_files(tmp_path: Path) -> None:
    for name in ("a/drive.csv", "b/drive.csv", "bus.parquet"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    paths = [str(tmp_path / name) for name in ("a/drive.csv", "b/drive.csv", "bus.parquet")]
    assert list(steps.named_recordings(paths)) == ["drive", "drive_2", "bus"]
    with pytest.raises(InputError, match="no such file; allowed: a recording"):
        steps.named_recordings([str(tmp_path / "none.csv")])
    with pytest.raises(InputError, match="a folder; allowed: a recording; name a file"):
        steps.named_recordings([str(tmp_path / "a")])
    with pytest.raises(InputError, match="an engine file"):
        steps.engine_file(str(tmp_path / "none.yaml"))
    assert steps.engine_file(None) == {}


def test_a_missing_file_is_one_line_before_anything_starts(
    faked_discovery: Callable[[], RunContext], capsys: pytest.CaptureFixture[str]
) -> None:
    from flows.discover import discover
    from tasks.launch import run_alone

    for arguments in (["none.csv"], ["--engine", "none.yaml"]):
        assert run_alone(discover, arguments, options=steps.options, check=steps.check) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: none.") and error.count("\n") == 1


@pytest.mark.parametrize("option", ["engine", "sensors"])
def test_the_concealed_machine_is_judged_as_the_chain_says(option: str, tmp_path: Path) -> None:
    """Else ``discoveries/``, which DVC compares, would hold a verdict by another engine."""
    given = tmp_path / "engine.yaml"
    given.write_text("J_t: 2.2e-4\n")
    asked = {"recordings": [], "engine": None, "sensors": None}
    steps.check(asked)
    with pytest.raises(InputError, match=f"--{option}: got no recording beside it"):
        steps.check(asked | {option: str(given)})


@pytest.mark.flow
def test_the_chains_own_machine_and_a_list_of_recordings(
    prefect: None, faked_discovery: Callable[[], RunContext], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flows.discover import discover
    from tasks.tracking import Tracker

    assert discover("tiny") == ["concealed"]
    found = tmp_path / "discoveries" / "concealed"
    assert {path.name for path in found.iterdir()} == {*steps.COMPARED, "recording.csv"}
    document = json.loads((found / "discrepancy.json").read_text())
    assert not Path(document["recording"]["path"]).is_absolute()
    assert (tmp_path / "reports" / "discover" / "concealed" / "report.html").exists()
    before = content_hash(tmp_path / "discoveries")
    again = faked_discovery()
    assert discover("tiny") == ["concealed"] and not again.timings
    assert content_hash(tmp_path / "discoveries") == before

    # The user's own: a second good one, and one that can't carry a verdict.
    text = (found / "recording.csv").read_text()
    (tmp_path / "mine.csv").write_text(text)
    (tmp_path / "short.csv").write_text("".join(text.splitlines(keepends=True)[:60]))
    (tmp_path / "heavy.yaml").write_text("J_t: 2.2e-4\n")
    context = faked_discovery()
    with pytest.raises(StepFailed) as failed:
        discover("tiny", [str(tmp_path / "short.csv"), str(tmp_path / "mine.csv")], str(tmp_path / "heavy.yaml"))
    assert failed.value.exit_code == 2 and "\n" not in str(failed.value)
    assert set(context.timings) == {"discover-mine"}
    assert (tmp_path / "reports" / "discover" / "mine" / "report.html").exists()
    assert content_hash(tmp_path / "discoveries") == before

    # The same contents, renamed: beside the first, alone, and beside another file of its name in another folder.
    heavy, again = str(tmp_path / "heavy.yaml"), str(tmp_path / "again.csv")
    shutil.copy(tmp_path / "mine.csv", again)
    (tmp_path / "other").mkdir()
    rows = text.splitlines(keepends=True)
    (tmp_path / "other" / "mine.csv").write_text("".join(rows[:-20]))
    for paths, ran in (
        ([again], set()),
        ([str(tmp_path / "mine.csv"), str(tmp_path / "other" / "mine.csv"), again], {"discover-mine_2"}),
    ):
        context = faked_discovery()
        assert discover("tiny", paths, heavy) == list(steps.named_recordings(paths))
        assert set(context.timings) == ran
    pages = {name: tmp_path / "reports" / "discover" / name / "report.html" for name in ("mine", "mine_2", "again")}
    assert pages["again"].read_bytes() == pages["mine"].read_bytes() != pages["mine_2"].read_bytes()
    assert content_hash(tmp_path / "discoveries") == before

    client = Tracker(Workspace(tmp_path)).client
    experiment = client.get_experiment_by_name("discover")
    runs = {run.info.run_name: run.data for run in client.search_runs([experiment.experiment_id])}
    assert set(runs) == {"concealed", "mine", "mine_2", "again"}
    metrics = runs["mine"].metrics
    assert metrics["p_value"] == document["p_value"] and metrics["mismatch"] == float(document["mismatch"])
    assert metrics["eta_sc_before"] == document["health"]["eta_sc"]["before"]
    assert "detectable/boost_leak" in metrics and runs["mine"].params["effects"]
    assert [runs[name].params["engine"] for name in ("concealed", "mine")] == ["published", "heavy.yaml"]
    assert runs["mine"].params["sensors"] == "all" and runs["mine"].tags["key"]

    # The tool breaks down: the reason is what is said, and what was published stays.
    shutil.rmtree(tmp_path / ".cache" / "discover")
    monkeypatch.setenv("FAKE_DISCOVERY_FAILS", "1")
    faked_discovery()
    with pytest.raises(StepFailed, match="no convergence"):
        discover("tiny")
    assert content_hash(tmp_path / "discoveries") == before


def test_the_concealed_machine_has_a_fault_worth_finding(faked_discovery: Callable[[], RunContext]) -> None:
    """The example of the chain: single, catalogued, three tolerances or more."""
    from dieseltwin.settings.params import load_params

    config = load_params(profile="quick")
    made = prove.benchmark(
        cases=1,
        seed=config.discover.concealed_seed,
        tier="main",
        sensors=6,
        duration_s=120.0,
        jobs=1,
    )
    answers = json.loads((made.path / "benchmark" / "sealed" / "case_0001.json").read_text())
    assert answers["kind"] == "single"
    assert all(effect["ratio"] >= 3.0 for effect in answers["effects"])
