"""Jobs in line: a server that was killed, one that ends, jobs that are stopped, files that would burst a worker."""

from __future__ import annotations

import gzip
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from dieseltwin.app.kept import Job, JobState, KeptRecording, Outcome, Store, save
from dieseltwin.app.lanes import Lanes
from dieseltwin.app.workplace import Limits, Workplace, new_id
from dieseltwin.errors import InputError


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
