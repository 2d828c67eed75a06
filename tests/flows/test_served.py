"""Flows with a schedule: what is checked before they start, their help, a name of its own for each schedule."""

from __future__ import annotations

import importlib
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest
import tiny_settings

from dieseltwin.errors import InputError
from tasks import served

LORRY_7 = {"profile": "tiny", "folder": "in", "engine": "mine.yaml", "history": "lorry_7"}


def test_every_schedule_has_a_name_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = served.deployment_name("watch", LORRY_7)
    assert name == served.deployment_name("watch", dict(reversed(LORRY_7.items())))
    others = {served.deployment_name("watch", {**LORRY_7, key: "other"}) for key in LORRY_7}
    others.add(served.deployment_name("retrain", LORRY_7))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")  # the same names, other files
    others.add(served.deployment_name("watch", LORRY_7))
    assert len(others) == 6 and name not in others


@pytest.mark.flow
def test_a_second_schedule_leaves_the_first_one_alone_and_missed_runs_are_forgotten(
    prefect: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from prefect.client.orchestration import get_client
    from prefect.states import Scheduled

    from flows.watch import watch

    tiny_settings.write_params(tmp_path)
    monkeypatch.setattr(
        type(watch), "serve",
        lambda flow, name, cron, parameters, **_: flow.to_deployment(name, cron=cron, parameters=parameters).apply(),
    )  # fmt: skip
    both = [LORRY_7, {**LORRY_7, "history": "lorry_8"}]
    monkeypatch.setattr(served, "_end_group_with_parent", lambda: None)
    names = [f"watch/{served.deployment_name('watch', parameters)}" for parameters in both]
    for parameters in both:
        assert served._run_when_due(watch, "0 3 * * 0", parameters) == 0
    now = datetime.now(UTC)
    with get_client(sync_client=True) as client:
        found = [client.read_deployment_by_name(name) for name in names]
        assert [deployment.parameters for deployment in found] == both
        due = {name: now + timedelta(hours=k) for k, name in ((-2, "missed"), (-1, "missed too"), (5, "to come"))}
        for deployment in found:
            for name, moment in due.items():
                client.create_flow_run_from_deployment(deployment.id, name=name, state=Scheduled(scheduled_time=moment))
        assert served._run_when_due(watch, "0 3 * * 0", LORRY_7) == 0
        left = [(run.deployment_id, run.name) for run in client.read_flow_runs() if run.name in due]
    assert sorted(left, key=str) == sorted(
        [(found[0].id, "to come"), *((found[1].id, name) for name in due)], key=str
    )


@pytest.mark.parametrize("serve", [[], ["--serve"]])
@pytest.mark.parametrize(
    ("arguments", "cluster", "free", "said"),
    [
        (["--profile", "none"], "", 1e12, "profile"),
        (["--profile", "tiny"], "foo", 1e12, "DIESELTWIN_CLUSTER: got 'foo'"),
        (["--profile", "tiny"], "", 3e6, "got 3 MB free; allowed: 500 MB; free some space"),
    ],
)
def test_retraining_does_not_start_with_what_the_user_can_mend(
    serve: list[str], arguments: list[str], cluster: str, free: float, said: str,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    from flows.retrain import main

    tiny_settings.write_params(tmp_path)
    tiny_settings.new_context(tmp_path)
    monkeypatch.setenv("DIESELTWIN_CLUSTER", cluster)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    monkeypatch.setattr("sys.argv", ["retrain", *arguments, *serve])
    assert main() == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and said in error and error.count("\n") == 1


def test_a_run_of_a_schedule_looks_at_the_disk_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from flows.retrain import retrain
    from flows.watch import watch

    tiny_settings.write_params(tmp_path)
    tiny_settings.new_context(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=3e6))
    for run in (lambda: retrain.fn("tiny"), lambda: watch.fn("tiny", "in", "mine.yaml", "lorry_7")):
        with pytest.raises(InputError, match="got 3 MB free"):
            run()


@pytest.mark.parametrize("flow", ["watch", "retrain"])
def test_the_help_names_the_schedule_and_every_profile(
    flow: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", [flow, "--help"])
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"flows.{flow}").main()
    printed = capsys.readouterr().out
    usage, _, told = printed.partition("\n\n")
    assert "--serve" in usage and "--cron" in usage
    assert "quick, paper, or tiny" in " ".join(told.split()) and "``" not in told
