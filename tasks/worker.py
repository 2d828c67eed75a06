"""Runs one step's function in a process that :mod:`tasks.fork_server` forks, the specification as JSON on stdin.

Why a process: two trainings use two cores without sharing an interpreter lock, every step starts from the same state
(one thread of linear algebra, fresh seeds), and Prefect needn't be imported beside torch. Progress goes back as JSON
lines; what the library prints goes to the step's log. When the parent dies, however it dies, stdin ends and so does
the worker: no orphan computes on.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any, TextIO

from tasks.failures import end_with_parent
from tasks.fork_server import serve
from tasks.run_context import Progress, find_step

# A progress message at most this often [s]: a callback in an inner loop must not cost.
_MESSAGE_INTERVAL_S = 0.2


def main() -> int:
    """Read the specification, run the function, report. Returns the exit status."""
    channel = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    told = sys.stdin.readline()
    if not told:  # the run was stopped while this process was forked
        return 1
    specification: dict[str, Any] = json.loads(told)
    end_with_parent(1)
    os.environ.clear()
    os.environ.update(specification["environment"])
    os.chdir(specification["folder"])
    try:
        function = find_step(specification["step"]).function
        inputs = {name: Path(path) for name, path in specification["inputs"].items()}
        function(Path(specification["out"]), _reporter(channel), **inputs, **specification["parameters"])
    except Exception as error:
        traceback.print_exc()
        _send(channel, {"error": str(error) or repr(error), "kind": _kinds(error)})
        return 1
    _send(channel, {"cpu_s": time.process_time()})
    return 0


def _kinds(error: Exception) -> list[str]:
    return [f"{kind.__module__}.{kind.__qualname__}" for kind in type(error).__mro__]


def _reporter(channel: TextIO) -> Progress:
    last = [-_MESSAGE_INTERVAL_S]

    def report(done: float, total: float) -> None:
        now = time.monotonic()
        if total > 0 and (now - last[0] >= _MESSAGE_INTERVAL_S or done >= total):
            last[0] = now
            _send(channel, {"fraction": min(1.0, done / total)})

    return report


def _send(channel: TextIO, message: dict[str, Any]) -> None:
    print(json.dumps(message), file=channel)


if __name__ == "__main__":
    sys.exit(serve(int(sys.argv[1]), main))
