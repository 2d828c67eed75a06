"""Whether a recording is, in part, one that is known already."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine import MEASURED
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording

Rows = NDArray[np.float64]

MOST_SHARED = 0.01  # of the rows with the reference: readings at rest may repeat
_DIGITS = 4  # significant; converters write five or more


class Hashed(Protocol):
    """A recording that is known by its file and by its rows."""

    @property
    def sha256(self) -> str: ...

    @property
    def rows_sha256(self) -> str: ...


class Located(Protocol):
    """A recording that says which file it is of, if it is of one."""

    @property
    def path(self) -> str | Path | None: ...


H = TypeVar("H", bound=Hashed)
R = TypeVar("R", bound=Located)


def distinct(recordings: Sequence[H]) -> tuple[H, ...]:
    """Each recording once, sorted by hash; of copies with the same rows the one whose hash comes first."""
    ordered = sorted(recordings, key=lambda item: item.sha256, reverse=True)
    return tuple(sorted({item.rows_sha256: item for item in ordered}.values(), key=lambda item: item.sha256))


def share_known(rows: Rows, known: Iterable[Rows]) -> float:
    """Share of rows (n, C) that stand, to four digits, among others of the same C columns, 0-1.

    To the bit a recording that was exported once more, with fewer digits or in other units, would be another one.
    Rows that are alike count once: an engine that stands gives the same row over and over.
    """
    own = {row.tobytes() for row in _to_digits(rows)}
    return len(own & {row.tobytes() for others in known for row in _to_digits(others)}) / max(len(own), 1)


def _to_digits(rows: Rows) -> Rows:
    """Values to `_DIGITS` significant digits, one kind of zero and of missing."""
    size = np.floor(np.log10(np.maximum(np.abs(rows), 1e-300)))  # NaN stays NaN
    step = 10.0 ** (size - (_DIGITS - 1))
    return np.ascontiguousarray(np.where(np.isnan(rows), np.nan, np.round(rows / step) * step + 0.0))


def refuse_overlapping(recordings: Sequence[R], share: Callable[[Sequence[R], R], float], first: int = 0) -> None:
    """Refuse recordings one of which is, in part, driving of another: its rows would count twice.

    Args:
        recordings: no two alike.
        share: of the rows of a recording that are in others, 0-1.
        first: of those that are asked about; the ones before it are known not to overlap.

    Raises:
        InputError: more than a little of one is in those before it.
    """
    for k in range(max(first, 1), len(recordings)):  # the first has none before it
        part = share(recordings[:k], recordings[k])
        if part > MOST_SHARED:
            raise InputError(
                str(recordings[k].path or "recording"), f"{100 * part:.0f} % of its rows in another of the recordings",
                "recordings that share no driving", "leave one of them out",
            )  # fmt: skip


def refuse_shared(where: str, share: float) -> None:
    """Refuse a recording of which more than a little is driving that its engine was learned from.

    Raises:
        InputError: it is.
    """
    if share > MOST_SHARED:
        raise InputError(
            where, f"{100 * share:.0f} % of its rows are in the reference",
            "driving that the engine wasn't learned from", "judge another recording, or learn without this one",
        )  # fmt: skip


def overlap(recordings: Sequence[Recording], other: Recording) -> float:
    """Share of another recording's rows that are also in some recordings, 0-1: alike in all inputs and in the readings
    that both have, of which one sensor's at least."""
    alike: dict[tuple[str, ...], list[Recording]] = {}
    for item in recordings:
        names = {*INPUTS, *MEASURED} & set(other.columns) & set(item.columns)
        if not names.isdisjoint(MEASURED):
            alike.setdefault(tuple(sorted(names)), []).append(item)
    shares = (share_known(_rows(other, n), (_rows(item, n) for item in some)) for n, some in alike.items())
    return max(shares, default=0.0)


def _rows(item: Recording, names: Sequence[str]) -> np.ndarray:
    return np.stack([item.columns[name] for name in names], axis=1)
