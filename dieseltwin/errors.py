"""The project's own exceptions. Every message says what, got, allowed and what to do, on one line."""

from __future__ import annotations


class DieselTwinError(Exception):
    """Base of every error that `dieseltwin` raises on purpose.

    `exit_code` is what the command line returns for it.
    """

    exit_code: int = 1


LONGEST_LINE = 300
"""Characters of a message on the command line; whatever a file holds, one line stays readable."""


def one_line(text: str) -> str:
    """Text without line ends, escape sequences and lone surrogates."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def shortened(text: str, length: int) -> str:
    """The text, or its beginning and end around " ... " where it is longer."""
    if len(text) <= length:
        return text
    end = (length - 5) // 3
    return f"{text[: length - 5 - end]} ... {text[len(text) - end :]}"


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

    def line(self, length: int = LONGEST_LINE) -> str:
        """The message of at most `length` characters: what was got and allowed is cut first, the place last."""
        parts = [one_line(part) for part in (self.what, self.got, self.allowed, self.do)]
        fixed = len("{}: got {}; allowed: {}; {}".format("", "", "", ""))
        # what to do may hold an option to copy, of some hundred characters: that stays whole as long as it can
        for place, least in ((2, 60), (1, 60), (3, 120), (2, 20), (1, 20), (3, 60), (0, 60)):
            excess = fixed + sum(map(len, parts)) - length
            if excess > 0:
                parts[place] = shortened(parts[place], max(len(parts[place]) - excess, least))
        return shortened("{}: got {}; allowed: {}; {}".format(*parts), length)

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        # Exceptions cross process boundaries (workers, Prefect); the default would call __init__ with one argument.
        return type(self), (self.what, self.got, self.allowed, self.do)


class Refused(DieselTwinError):
    """The message of an `InputError` that was kept as text."""

    exit_code = InputError.exit_code


class NotConvergedError(DieselTwinError):
    """An iteration ended without an answer that may be used."""
