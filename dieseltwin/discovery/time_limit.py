"""The time that a search may take: whoever simulates asks whether any is left."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_ENDS: ContextVar[float] = ContextVar("ends", default=float("inf"))


class OutOfTimeError(Exception):
    """The time of the search is over; the search itself catches it and answers with the best so far."""


@contextmanager
def time_limit(seconds: float | None) -> Iterator[None]:
    """Raise `OutOfTimeError` from `check_time` inside, once these seconds are over; None: never."""
    token = _ENDS.set(float("inf") if seconds is None else time.perf_counter() + seconds)
    try:
        yield
    finally:
        _ENDS.reset(token)


def is_limited() -> bool:
    """Whether there is a limit."""
    return _ENDS.get() < float("inf")


def check_time() -> None:
    """Go on, if there is time left.

    Raises:
        OutOfTimeError: there is none.
    """
    if time.perf_counter() > _ENDS.get():
        raise OutOfTimeError
