"""Whether a recording is, in part, one that is known already."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dieseltwin.errors import InputError

Rows = NDArray[np.float64]

MOST_SHARED = 0.01  # of the rows with the reference: readings at rest may repeat


class Hashed(Protocol):
    """A recording that is known by its file and by its rows."""

    @property
    def sha256(self) -> str: ...

    @property
    def rows_sha256(self) -> str: ...


H = TypeVar("H", bound=Hashed)


def distinct(recordings: Sequence[H]) -> tuple[H, ...]:
    """Each recording once, sorted by hash; of copies with the same rows the one whose hash comes first."""
    ordered = sorted(recordings, key=lambda item: item.sha256, reverse=True)
    return tuple(sorted({item.rows_sha256: item for item in ordered}.values(), key=lambda item: item.sha256))


def share_known(rows: Rows, known: Iterable[Rows]) -> float:
    """Share of rows (n, C) that stand, to the bit, among others of the same C columns, 0-1."""
    seen = {row.tobytes() for others in known for row in others}
    return sum(row.tobytes() in seen for row in rows) / max(len(rows), 1)


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
