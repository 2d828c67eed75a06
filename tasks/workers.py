"""The processes in which steps run, as the process that started them sees them.

Each is a :mod:`tasks.worker`, forked by a :mod:`tasks.fork_server`; they end with this process, or when :func:`stop`
is called.
"""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from tasks.failures import StepFailed
from tasks.fork_server import ForkedProcess, ForkServer

# One thread of linear algebra per process: two spinning threads beside a busy neighbour were 10-70 times slower than
# one, and one thread gives the same bits every time.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_WAIT_POLICY": "PASSIVE",
    "PYTHONHASHSEED": "0",
}

_workers: set[ForkedProcess] = set()
_stopping = False
_asking = threading.Lock()
_server: tuple[str, ForkServer] | None = None


def run(
    specification: Mapping[str, Any], libraries: Sequence[str], log: Path, tell: Callable[[float], None]
) -> tuple[int, dict[str, Any]]:
    """Run what :mod:`tasks.worker` is told by a specification; ``libraries``: that it begins with; ``tell`` gets the
    fraction that is done. Returns the process's exit status and its last message: its error or its CPU seconds."""
    with log.open("w", encoding="utf-8") as stream, _forked(specification["environment"], libraries, stream) as worker:
        try:
            last = _talk(worker, specification, tell)
        except BaseException:
            worker.kill()
            raise
        finally:
            _workers.discard(worker)
    return int(worker.returncode or 0), last


def stopping() -> bool:
    """Whether the workers were stopped, so that the end of one is no accident."""
    return _stopping


def stop() -> None:
    """Kill the workers of this process (Ctrl-C) and start no others; the threads that wait for them remove their
    temporary folders."""
    global _stopping
    _stopping = True
    _kill()
    with _asking:  # and what was just being forked
        _kill()


def _kill() -> None:
    if _server is not None:
        _server[1].kill()
    for worker in tuple(_workers):
        worker.kill()


def stop_on(*signals: signal.Signals, then: Callable[[], None] = lambda: None) -> None:
    """Stop the workers as soon as one of the signals comes, whoever handles it; `then` is called after it.

    In a flow Prefect's handler of SIGTERM stands in the place of ours, and what it raises waits for the threads that
    wait for the workers. So a thread of our own hears of the signal by Python's pipe; the handlers end the process.
    """
    heard, told = os.pipe()
    os.set_blocking(told, False)
    signal.set_wakeup_fd(told, warn_on_full_buffer=False)

    def listen() -> None:
        while number := os.read(heard, 1):
            if number[0] in signals:
                stop()
                then()

    threading.Thread(target=listen, daemon=True).start()


def _forked(environment: Mapping[str, str], libraries: Sequence[str], log: TextIO) -> ForkedProcess:
    """A worker of the server at hand; of another one where it is to find its modules elsewhere."""
    global _server
    path = environment["PYTHONPATH"]
    with _asking:
        if _stopping:
            raise StepFailed("the run is being stopped")
        if _server is None or _server[0] != path or not _server[1].runs:
            if _server is not None:
                _server[1].close()
            _server = path, ForkServer("tasks.worker", environment)
        worker = _server[1].start(libraries, log)
        _workers.add(worker)
        return worker


def _talk(
    worker: ForkedProcess, specification: Mapping[str, Any], tell: Callable[[float], None]
) -> dict[str, Any]:
    """Send the specification, pass progress on. Returns the worker's last message."""
    last: dict[str, Any] = {}
    if worker.pid is None:
        return last
    with suppress(BrokenPipeError):  # it was killed: its status says so
        worker.stdin.write(json.dumps(specification) + "\n")
        worker.stdin.flush()
    for line in worker.stdout:
        message = json.loads(line)
        if "fraction" in message:
            tell(message["fraction"])
        else:
            last = message
    worker.wait()
    return last
