"""How a step fails: one line for the user, and whether another try is worth it."""

from __future__ import annotations

from collections.abc import Sequence


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
