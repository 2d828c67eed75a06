"""`dieseltwin watch`: what it refuses, in one line, and what an empty history says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import dieseltwin as dt
from dieseltwin.cli.app import main
from dieseltwin.learning.history import FILE_NAME, History
from tests.api.learned import learned_file
from tests.api.simulated import drive
from tests.learning.test_history import driving, entry

TANKS = Path(__file__).resolve().parents[2] / "examples" / "rigs" / "cascaded_tanks.yaml"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path, command: str = "watch") -> str:
    assert main([command, *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("dieseltwin: ") and error.count("\n") == 1
    return error


def test_wrong_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    drive(20.0).to_csv(tmp_path / "2026-01-01.csv", index=False)
    (tmp_path / "plain.yaml").write_text("J_t: 2.0e-4\n")
    good, plain, history = tmp_path / "2026-01-01.csv", tmp_path / "plain.yaml", tmp_path / "history"
    assert "no such file" in refused(capsys, "show", "--history", history)
    assert "no learned engine" in refused(capsys, "add", good, "--engine", plain, "--history", history)
    assert "none.csv" in refused(capsys, "add", tmp_path / "none.csv", "--engine", plain, "--history", history)
    assert not history.exists()
    History(history, "e" * 64).add(entry(0))
    assert "--alarms-per-year" in refused(capsys, "show", "--history", history, "--alarms-per-year", "2")
    assert "another engine file" in refused(
        capsys, "add", good, "--engine", learned_file(tmp_path), "--history", history
    )
    (history / FILE_NAME).write_bytes(b"x" * 5000)
    assert FILE_NAME in refused(capsys, "show", "--history", history)


def test_a_recording_that_is_no_good_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    drive(20.0).to_csv(tmp_path / "2026-01-01.csv", index=False)
    mine = learned_file(tmp_path)
    drive(25.0).to_csv(tmp_path / "2026-01-02.csv", index=False)
    history, good = tmp_path / "history", tmp_path / "2026-01-01.csv"
    assert "2026-01-01.csv" in refused(capsys, "add", good, "--engine", mine, "--history", history)
    assert main(["watch", "add", str(good), str(tmp_path / "2026-01-02.csv"), "--engine", str(mine), "--history",
                 str(history)]) == 2  # fmt: skip
    said = capsys.readouterr().out
    assert said.count("not added: ") == 2 and "holds no recording" in said and not history.exists()
    History(history, "e" * 64).add(entry(0))
    assert main(["watch", "show", "--history", str(history), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "history.html").is_file()


def test_recordings_of_one_name_in_two_folders_keep_their_own_verdicts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As loggers write them: one folder a day, and always the same name."""
    judged = {
        tmp_path / day / "drive.csv": replace(entry(k), path="drive.csv", verdict=verdict)
        for k, (day, verdict) in enumerate([("monday", "healthy"), ("tuesday", "boost_leak")])
    }

    def asked(path: Path, *_: object) -> tuple[SimpleNamespace, SimpleNamespace]:
        recording = driving(list(judged).index(path), 50)
        return SimpleNamespace(answer=lambda: judged[path]), SimpleNamespace(recording=recording)

    monkeypatch.setattr("dieseltwin.api.watch._asked", asked)
    monkeypatch.setattr("dieseltwin.api.watch._entry", lambda answer, day, sketched: answer)
    monday, tuesday = dt.watch(list(judged), learned_file(tmp_path), tmp_path / "history").lines()[:2]
    assert monday.endswith("monday/drive.csv: added, healthy by itself")
    assert tuesday.endswith("tuesday/drive.csv: added, boost_leak by itself")


def test_machines_without_a_history_are_told_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """A petrol engine and a rig are learned too, by another way: "learn the engine first" would lead nowhere."""
    mine, history = learned_file(tmp_path), tmp_path / "history"
    drive(20.0).drop(columns="time_s").to_csv(tmp_path / "points.csv", index=False)
    points = tmp_path / "points.csv"
    said = refused(capsys, "add", points, "--engine", mine, "--history", history)
    assert "points.csv: got settled points; allowed: recordings over time" in said
    for engine, kind in (("liu_petrol", "a petrol engine"), (TANKS, "no engine")):
        assert kind in refused(capsys, "add", points, "--engine", engine, "--history", history)
        assert kind in refused(capsys, engine, "--c", tmp_path / "engine.c", command="export")
    assert not history.exists() and not (tmp_path / "engine.c").exists()
