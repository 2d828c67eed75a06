"""The project's own exceptions. Every message says what, got, allowed and what to do, on one line."""

from __future__ import annotations


class DieselTwinError(Exception):
    """Base of every error that `dieseltwin` raises on purpose.

    `exit_code` is what the command line returns for it.
    """

    exit_code: int = 1


class InputError(DieselTwinError):
    """Something the user gave cannot be used: a file, a column, a key, a folder.

    Args:
        what: the thing that is wrong, with its place ("drive.csv: column p_im_pa").
        got: what was found there.
        allowed: what would have been accepted.
        do: what to do about it, as an order ("convert to Pa or give --channels").

    The message is one line whatever the arguments hold; the command line exits with 2.
    """

    exit_code = 2

    def __init__(self, what: str, got: object, allowed: object, do: str) -> None:
        self.what, self.got, self.allowed, self.do = str(what), str(got), str(allowed), str(do)
        text = f"{self.what}: got {self.got}; allowed: {self.allowed}; {self.do}"
        super().__init__(" ".join(text.split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        # Exceptions cross process boundaries (workers, Prefect); the default would call __init__ with one argument.
        return type(self), (self.what, self.got, self.allowed, self.do)


class NotConvergedError(DieselTwinError):
    """An iteration ended without an answer that may be used."""
