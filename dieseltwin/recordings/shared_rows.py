"""Whether a recording is, in part, one that is known already."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float64]


def share_known(rows: Rows, known: Iterable[Rows]) -> float:
    """Share of rows (n, C) that stand, to the bit, among others of the same C columns, 0-1."""
    seen = {row.tobytes() for others in known for row in others}
    return sum(row.tobytes() in seen for row in rows) / max(len(rows), 1)
