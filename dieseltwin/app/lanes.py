"""Jobs in line: a lane for quick looks into files, one for analyses; every job is a process of its own."""

from __future__ import annotations

import logging
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from dieseltwin.app.kept import ACTIVE, OUTCOME, PROGRESS, Job, JobState, Outcome, Store, now, save
from dieseltwin.errors import InputError

logger = logging.getLogger(__name__)
LOOKS = 2  # quick looks at a time
POLITE_S = 3.0  # between asking a process to end and ending it
LOG = "log.txt"


class Lanes:
    """Runs the jobs of a store.

    Args:
        store: where jobs stand.
        finished: called with every job that is done, in the thread of its lane.
    """

    def __init__(self, store: Store, finished: Callable[[Job], None]) -> None:
        self.store, self.finished = store, finished
        self.limits = store.workplace.limits
        self._looks: queue.Queue[str | None] = queue.Queue()
        self._analyses: queue.Queue[str | None] = queue.Queue()
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._stopped: set[str] = set()
        self._guard = threading.Lock()
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    def start(self) -> list[str]:
        """Take up work; returns the jobs that an earlier server left unfinished and that can be started again."""
        interrupted = []
        for job in reversed(self.store.jobs()):
            state = self.store.state(job.id)
            if state.status == "running":
                outcome = self.store.outcome(job.id)
                if outcome is not None:  # it ended while nobody looked
                    self._end(job, "failed" if outcome.error else "done", state)
                else:
                    self._end(job, "interrupted", state)
                    interrupted.append(job.id)
            elif state.status == "waiting":
                self.put(job)
        counts = [(self._looks, LOOKS), (self._analyses, self.limits.workers)]
        for line, count in counts:
            for _ in range(count):
                thread = threading.Thread(target=self._work, args=(line,), daemon=True)
                thread.start()
                self._threads.append(thread)
        return interrupted

    def put(self, job: Job) -> None:
        """Let a waiting job stand in line."""
        (self._analyses if job.long else self._looks).put(job.id)

    def again(self, job: Job) -> None:
        """Run a job that has ended once more."""
        for name in (OUTCOME, PROGRESS):
            (self.store.job_folder(job.id) / name).unlink(missing_ok=True)
        with self._guard:
            self._stopped.discard(job.id)
        self.store.keep_state(job.id, JobState())
        self.put(job)

    def ahead(self, job: Job) -> int:
        """How many jobs of its lane stand before a waiting one."""
        line = self._analyses if job.long else self._looks
        waiting = [key for key in list(line.queue) if key is not None]
        others = [self.store.job(key) for key in list(self._running) if key != job.id] if job.long else []
        running = sum(1 for other in others if other is not None and other.long)
        return (waiting.index(job.id) if job.id in waiting else 0) + running

    def stop(self, key: str) -> None:
        """End a job, running or not."""
        with self._guard:
            state = self.store.state(key)
            if state.status not in ACTIVE:
                return
            self._stopped.add(key)
            process = self._running.get(key)
            if process is None:
                self.store.keep_state(key, state.model_copy(update={"status": "stopped", "ended": now()}))
        if process is not None:
            _end_process(process)

    def close(self) -> None:
        """End every process; what was running is said to be interrupted when the next server starts."""
        self._closing.set()
        for _ in self._threads:
            self._looks.put(None)
            self._analyses.put(None)
        for process in list(self._running.values()):
            _end_process(process)
        for thread in self._threads:
            thread.join(timeout=POLITE_S)

    def _work(self, line: queue.Queue[str | None]) -> None:
        while not self._closing.is_set():
            key = line.get()
            job = None if key is None else self.store.job(key)
            if job is None:
                continue
            try:
                self._run(job)
            except (InputError, OSError) as error:  # taken away meanwhile, or a full disk: the next job may go
                logger.warning("job %s: %s", job.id, error)

    def _run(self, job: Job) -> None:
        folder = self.store.job_folder(job.id)
        with self._guard:
            if job.id in self._stopped or self.store.state(job.id).status != "waiting" or self._closing.is_set():
                return
            state = JobState(status="running", started=now())
            self.store.keep_state(job.id, state)
            try:
                process = self._started(job, folder / LOG)
            except OSError as error:  # no memory or no process left, a full disk
                self._fail(job, state, f"its process can't be started ({error.strerror}); start it again later")
                return
            self._running[job.id] = process
        late = False
        try:
            process.wait(self.limits.analysis_s if job.long else self.limits.look_s)
        except subprocess.TimeoutExpired:
            late = True
            _end_process(process)
        finally:
            if process.stdin is not None:
                process.stdin.close()
            with self._guard:
                self._running.pop(job.id, None)
        self._conclude(job, state, process.returncode, late)

    def _started(self, job: Job, log: Path) -> subprocess.Popen[bytes]:
        with log.open("wb") as file:
            return subprocess.Popen(
                [sys.executable, "-m", "dieseltwin.app.worker", str(self.store.workplace.folder), job.id,
                 str(self.limits.memory_gb)],
                stdin=subprocess.PIPE, stdout=file, stderr=file, env=_environment(), start_new_session=True,
            )  # fmt: skip

    def _fail(self, job: Job, state: JobState, words: str) -> None:
        save(Outcome(error=words), self.store.job_folder(job.id) / OUTCOME)
        self._end(job, "failed", state)

    def _conclude(self, job: Job, state: JobState, code: int, late: bool) -> None:
        if not self.store.job_folder(job.id).is_dir():  # taken away meanwhile
            return
        outcome = self.store.outcome(job.id)
        if job.id in self._stopped:
            self._end(job, "stopped", state)
        elif outcome is not None:
            self._end(job, "failed" if outcome.error else "done", state)
        elif self._closing.is_set():
            self._end(job, "interrupted", state)
        else:
            self._fail(job, state, _last_words(code, late, self.limits.memory_gb))

    def _end(self, job: Job, status: str, state: JobState) -> None:
        if status == "done":
            self.finished(job)
        ended = JobState.model_validate({**state.model_dump(), "status": status, "ended": now()})
        self.store.keep_state(job.id, ended)


def _last_words(code: int, late: bool, memory_gb: int) -> str:
    if late:
        return "it took longer than this server allows and was ended; cut the recording into shorter ones"
    if code == -signal.SIGKILL:
        return f"the system ended it, most likely for its memory (limit {memory_gb} GB); cut the recording"
    return f"the worker process ended with code {code} and said nothing; the server's log of this job may say more"


def _environment() -> dict[str, str]:
    """One thread a process, and this very library for it."""
    here = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path, "PYTHONIOENCODING": "utf-8"}


def _end_process(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(POLITE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
