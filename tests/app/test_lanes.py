"""Jobs in line: a server that was killed, one that ends, jobs that are stopped, files that would burst a worker."""

from __future__ import annotations

import gzip
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import dieseltwin as dt
from dieseltwin.api.driving import DrivingQuestion
from dieseltwin.app.kept import (
    ARCHIVE,
    HISTORY,
    MAP,
    PROGRESS,
    Job,
    JobState,
    KeptRecording,
    Outcome,
    Store,
    save,
)
from dieseltwin.app.lanes import Lanes
from dieseltwin.app.worker import _KINDS, Worker, work
from dieseltwin.app.workplace import Limits, Workplace, new_id
from dieseltwin.errors import InputError
from dieseltwin.learning.history import Entry
from dieseltwin.recordings.dates import Dated
from tests.api.learned import learned_file
from tests.api.simulated import drive
from tests.learning.test_history import entry


@pytest.fixture
def store(tmp_path: Path) -> Store:
    workplace = Workplace(tmp_path / "kept", Limits(memory_gb=3, look_s=60.0))
    workplace.prepare()
    return Store(workplace)


def kept(store: Store, name: str, content: bytes) -> KeptRecording:
    key = new_id()
    store.recording_folder(key).mkdir()
    (store.recording_folder(key) / "recording.csv").write_bytes(content)
    found = KeptRecording(id=key, name=name, file="recording.csv", size=len(content), added="2026-01-01T00:00:00+00:00")
    store.keep_recording(found)
    return found


def until(condition: Callable[[], bool], seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)


def ended(store: Store, job: Job) -> bool:
    return store.state(job.id).status not in ("waiting", "running")


def test_what_a_killed_server_left_is_listed_and_starts_again(store: Store) -> None:
    recording = kept(store, "drive.csv", b"a;b\n1;2\n")
    document = kept(store, "document.csv", b"%PDF-1.7 " + bytes(99))
    cut_off = store.new_job("channels", "was running", (document.id,))
    store.keep_state(cut_off.id, JobState(status="running", started="2026-01-01T00:00:00+00:00"))
    finished = store.new_job("discover", "ended while nobody looked", (recording.id,))
    store.keep_state(finished.id, JobState(status="running", started="2026-01-01T00:00:00+00:00"))
    save(Outcome(sentence="All well."), store.job_folder(finished.id) / "outcome.json")
    waiting = store.new_job("channels", "waited", (recording.id,))
    lanes = Lanes(store, lambda job: None)
    try:
        assert lanes.start() == [cut_off.id]
        assert store.state(cut_off.id).status == "interrupted" and store.state(finished.id).status == "done"
        until(lambda: ended(store, waiting))  # what waited goes on by itself
        assert store.state(waiting.id).status == "done"
        lanes.again(cut_off)
        until(lambda: ended(store, cut_off))
        outcome = store.outcome(cut_off.id)
        assert store.state(cut_off.id).status == "failed" and outcome is not None
        assert outcome.error.startswith("document.csv: got a PDF") and not outcome.defect  # people's name
        assert str(store.workplace.folder) not in outcome.error
    finally:
        lanes.close()


def test_a_worker_ends_when_its_server_is_gone(store: Store) -> None:
    recording = kept(store, "drive.csv", b"a;b\n1;2\n")
    job = store.new_job("channels", "looking", (recording.id,))
    code = f"""
import sys, time
from dieseltwin.app import worker
worker._KINDS["channels"] = lambda w: time.sleep(600)
worker.main({[str(store.workplace.folder), job.id, "4"]!r})
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE)
    try:
        time.sleep(0.5)
        assert process.poll() is None and process.stdin is not None
        process.stdin.close()  # what the system does when a server is killed
        assert process.wait(30.0) == 3
    finally:
        process.kill()


def test_a_waiting_job_is_stopped(store: Store) -> None:
    job = store.new_job("discover", "waits", ("0" * 16,))
    lanes = Lanes(store, lambda job: None)
    lanes.put(job)
    assert lanes.ahead(job) == 0
    lanes.stop(job.id)
    assert store.state(job.id).status == "stopped"


def test_before_an_analysis_stand_analyses_alone(store: Store) -> None:
    look, running, waits = (store.new_job(kind, kind, ("0" * 16,)) for kind in ("channels", "discover", "identify"))
    lanes = Lanes(store, lambda job: None)
    process = subprocess.Popen(["true"])
    process.wait()
    lanes._running.update({look.id: process, running.id: process})
    lanes.put(waits)
    assert lanes.ahead(waits) == 1


def test_a_process_that_can_not_be_started_is_a_failed_job(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*args: object, **options: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("dieseltwin.app.lanes.subprocess.Popen", refused)
    job = store.new_job("channels", "looking", (kept(store, "drive.csv", b"a;b\n1;2\n").id,))
    lanes = Lanes(store, lambda job: None)
    lanes._run(job)
    outcome = store.outcome(job.id)
    assert store.state(job.id).status == "failed" and outcome is not None
    assert outcome.error == "its process can't be started (Resource temporarily unavailable); start it again later"


def test_a_result_stays_whose_recording_goes_meanwhile(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = kept(store, "drive.csv", b"a;b\n1;2\n")
    (store.recording_folder(recording.id) / MAP).write_text("a: time_s\n")
    job = store.new_job("discover", "searching", (recording.id,))
    worker = Worker(store, job)

    def found(worker: Worker) -> str:
        worker.result().mkdir()
        (worker.result() / "report.html").write_text("<p>report</p>")
        store.remove(store.recording_folder(recording.id))
        return "A leak."

    monkeypatch.setitem(_KINDS, "discover", found)
    assert work(worker) == Outcome(sentence="A leak.")
    with zipfile.ZipFile(worker.folder / ARCHIVE) as zipped:
        assert set(zipped.namelist()) == {"report.html", MAP} and zipped.read(MAP) == b"a: time_s\n"


def test_a_history_names_the_recording_as_people_do_and_says_when_its_date_is_the_uploads(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its search is left out: it takes a minute."""
    mine, recording = learned_file(tmp_path), kept(store, "lorry 7.csv", drive(65.0).to_csv(index=False).encode())

    def judged(found: object, day: Dated, sketched: str) -> Entry:
        return replace(entry(0), path=str(day.recording.path), date_from=day.date_from)

    monkeypatch.setattr(DrivingQuestion, "answer", lambda self: None)
    monkeypatch.setattr("dieseltwin.api.watch._entry", judged)
    monkeypatch.setattr(Worker, "engine", lambda self: mine)
    engine = new_id()
    store.engine_folder(engine).mkdir()
    worker = Worker(store, store.new_job("watch", "in the history", (recording.id,), engine))
    assert not work(worker).error
    assert [one.path for one in dt.history(store.engine_folder(engine) / HISTORY).entries] == ["lorry 7.csv"]
    told = (worker.folder / PROGRESS).read_text()
    assert "lorry 7.csv: added" in told and "note: dated by the file's last change" in told
    assert str(store.workplace.folder) not in told


def test_a_file_that_would_burst_the_memory_fails_alone(store: Store) -> None:
    member = gzip.compress(b"1;2\n" * 2_500_000)
    recording = kept(store, "bomb.csv.gz", 150 * member)  # 1.5 GB of rows in a few MB
    assert recording.size < 5_000_000
    job = store.new_job("channels", "looking", (recording.id,))
    lanes = Lanes(store, lambda job: None)
    try:
        lanes.start()
        until(lambda: ended(store, job))
        outcome = store.outcome(job.id)
        assert store.state(job.id).status == "failed" and outcome is not None and "memory" in outcome.error
    finally:
        lanes.close()


def test_one_folder_has_one_server(store: Store) -> None:
    with store.workplace.lock(), pytest.raises(InputError, match="another server works there"):
        store.workplace.lock()
