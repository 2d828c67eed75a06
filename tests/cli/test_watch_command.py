"""`dieseltwin watch`: what it refuses, in one line, and what an empty history says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import dieseltwin as dt
from dieseltwin.api.histories import remove
from dieseltwin.api.watch import begun
from dieseltwin.cli.app import main
from dieseltwin.learning.history import FILE_NAME, Entry, History
from dieseltwin.paths import file_sha256
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
    said, beside = capsys.readouterr()
    assert said.count("not added: ") == 2 and said.count("2026-01-02.csv") == 1  # not twice in one line
    assert "holds no recording" in said and not history.exists()
    assert beside.splitlines() == ["1/2 2026-01-01.csv", "2/2 2026-01-02.csv"]
    History(history, "e" * 64).add(entry(0))
    assert main(["watch", "show", "--history", str(history), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "history.html").is_file()


def test_recordings_of_one_name_in_two_folders_keep_their_own_verdicts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As loggers write them: one folder a day, and always the same name."""
    judged = {
        tmp_path / day / "drive.csv": replace(entry(k), path="drive.csv", verdict=verdict, date_from=known)
        for k, (day, verdict, known) in enumerate(
            [("monday", "healthy", "time stamp"), ("tuesday", "boost_leak", "file's modification time")]
        )
    }

    def asked(path: Path, *_: object) -> tuple[SimpleNamespace, SimpleNamespace]:
        recording = driving(list(judged).index(path), 50)
        return SimpleNamespace(answer=lambda: judged[path]), SimpleNamespace(recording=recording, date=None)

    monkeypatch.setattr("dieseltwin.api.watch._asked", asked)
    monkeypatch.setattr("dieseltwin.api.watch._entry", lambda answer, day, sketched: answer)
    monday, tuesday, note = dt.watch(list(judged), learned_file(tmp_path), tmp_path / "history").lines()[:3]
    assert monday.endswith("monday/drive.csv: added, healthy by itself")
    assert tuesday.endswith("tuesday/drive.csv: added, boost_leak by itself")
    assert note.startswith("note: dated by the file's last change, which copying may have moved: ")
    assert f"moved: {list(judged)[1]} (2026-01-02); where" in note


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


def leaking(k: int) -> Entry:
    """A recording with a boost leak from the third on, far beyond its noise."""
    plain = entry(k)
    score = replace(plain.scores[0], estimate=40e-6 if k > 1 else 0.0, shared=np.zeros(5))
    return replace(plain, date=f"2026-{k + 1:02d}-01T00:00:00+00:00", scores=(score,))


def test_an_alarm_cannot_be_taken_out_unseen(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    store, history = History(tmp_path / "h", "e" * 64), ["--history", str(tmp_path / "h")]
    for k in range(6):
        store.add(leaking(k))
    assert main(["watch", "show", *history]) == 0
    before = capsys.readouterr().out
    assert before.startswith("Alarm with the recording of 2026-0")
    for k in range(2, 6):
        assert main(["watch", "remove", f"{k}.csv", *history, "--reason", "the  wrong\nlorry"]) == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("No alarm over 2 recordings") and said.count(": the wrong lorry") == 4
    assert ", an alarm. The rate of false alarms holds with them" in said
    assert main(["watch", "show", *history, "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "history.html").read_text()
    assert "Taken out" in page and page.count("the wrong lorry") >= 8  # headline and table
    for k in range(2, 6):
        assert main(["watch", "restore", f"2026-{k + 1:02d}-01", *history]) == 0
    assert capsys.readouterr().out.endswith(before)


def test_a_recording_is_taken_out_by_whatever_it_is_known_by(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, file = tmp_path / "h", tmp_path / "anything.csv"
    store, history = History(folder, "e" * 64), ["--history", folder]
    file.write_text("rows")
    hashes = [file_sha256(file), "ab" * 32, "cd" * 32, "ef" * 32]
    for k, sha256 in enumerate(hashes):
        date = f"2026-0{k // 3 + 1}-01T00:00:00+00:00"
        store.add(replace(leaking(0), sha256=sha256, path=f"{k // 2}.csv", date=date))
    why = ["--reason", "no engine"]
    assert "2 recordings in the history: 0.csv (2026-01-01, " in refused(capsys, "remove", "0.csv", *history, *why)
    assert "no recording in the history" in refused(capsys, "remove", "abab", *history, *why)
    assert "--reason" in refused(capsys, "remove", "abababab", *history, "--reason", " ")
    assert "no such file" in refused(capsys, "remove", "0.csv", "--history", tmp_path / "none", *why)
    for known in (file, "ABABABAB", "2026-02-01", "1.csv"):  # each is the only one by then
        assert main(["watch", "remove", str(known), *map(str, history), *why]) == 0
    assert store.entries() == () and {taken.entry.sha256 for taken in store.taken_out()} == set(hashes)
    assert "The history holds no recording. Taken out: " in capsys.readouterr().out
    assert "no recording taken out" in refused(capsys, "restore", "none.csv", *history)


def test_what_was_taken_out_is_not_judged_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    mine, file, history = learned_file(tmp_path), tmp_path / "anything.csv", tmp_path / "h"
    file.write_text("no recording: reading it would say so")
    begun(history, mine).add(replace(entry(0), sha256=file_sha256(file)))
    remove(history, file, "no engine")
    again = refused(capsys, "add", file, "--engine", mine, "--history", history)
    assert "anything.csv: got what was taken out of the history (0.csv, on 2" in again
    assert "`dieseltwin watch restore`" in again
