"""How a run ends early: a step's failure as one line for the user and whether another try is worth it, Ctrl-C, and the
end of the process that started it."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from types import FrameType

INTERRUPTED = "interrupted: what is finished is kept, the next run goes on from there"
INTERRUPTED_CODE = 130


def interrupted_early(signum: int, frame: FrameType | None) -> None:
    """End the process, in which nothing was begun yet, with the one sentence."""
    print(INTERRUPTED, file=sys.stderr, flush=True)
    os._exit(INTERRUPTED_CODE)


def end_with_parent(exit_code: int) -> None:
    """End this process as soon as its parent has ended, however it ended: standard input, a pipe of it, ends then.

    It is read beside Python's own file: a thread that waits there holds its lock, and for that lock a fork and the
    interpreter's own end would wait for ever.
    """
    threading.Thread(target=_wait_for_end, args=(exit_code,), daemon=True).start()


def _wait_for_end(exit_code: int) -> None:
    while os.read(0, 4096):
        pass
    os._exit(exit_code)


class StepFailed(RuntimeError):
    """A step ended with an error; the message is one line.

    ``exit_code``: 2 where the user's input is wrong; ``kinds``: full names of the error's class and of those above it,
    none where the step's process ended without saying why.
    """

    def __init__(self, message: str, exit_code: int = 1, kinds: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.exit_code, self.kinds = exit_code, tuple(kinds)

    def __reduce__(self) -> tuple[type[StepFailed], tuple[str, int, tuple[str, ...]]]:
        return type(self), (str(self), self.exit_code, self.kinds)


class WorkerKilled(StepFailed):
    """A step's process was killed by a signal that isn't ours (out of memory, a ``kill``): worth another try."""


class InputChanged(StepFailed):
    """A file that a step was given was written to before the step was through: its result would be kept under the
    contents from before."""
