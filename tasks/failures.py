"""How a step fails: one line for the user, and whether another try is worth it."""

from __future__ import annotations


class StepFailed(RuntimeError):
    """A step ended with an error; the message is one line. ``exit_code``: 2 where the user's input is wrong."""

    def __init__(self, message: str, exit_code: int = 1) -> None:
        super().__init__(message)
        self.exit_code = exit_code

    def __reduce__(self) -> tuple[type[StepFailed], tuple[str, int]]:
        return type(self), (str(self), self.exit_code)


class WorkerKilled(StepFailed):
    """A step's process was killed by a signal that isn't ours (out of memory, a ``kill``): worth another try."""
