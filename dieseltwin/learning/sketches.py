"""Sketches of recordings: a small sample of their rows, by which a history notices driving that it holds already."""

from __future__ import annotations

import base64
import hashlib

import numpy as np

from dieseltwin.engine import MEASURED
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording

_SKETCHED = 1024  # rows of a sketch: a tenth of what a history holds of a recording otherwise
_LEAST_SHARED = 4  # of two sketches: one row may repeat by chance
_LAST = b"\xff" * 8  # no hash is beyond


def sketch(recording: Recording) -> str:
    """The `_SKETCHED` smallest hashes of a recording's different rows, inputs and readings without the time: a random
    sample of them that any two recordings draw alike."""
    names = sorted({*INPUTS, *MEASURED} & set(recording.columns))
    rows = np.column_stack([recording.columns[name] for name in names])
    salt = hashlib.blake2b(" ".join(names).encode(), digest_size=16).digest()
    hashes = {hashlib.blake2b(row.tobytes(), digest_size=8, salt=salt).digest() for row in rows}
    return base64.b64encode(b"".join(sorted(hashes)[:_SKETCHED])).decode()


def shared(one: str, other: str) -> float:
    """About which share of the rows of the shorter of two sketched recordings is in the other, 0-1; 0 where too few
    are compared to tell."""
    first, second = _hashes(one), _hashes(other)
    if not first or not second:
        return 0.0
    reach = min(max(hashes) if len(hashes) >= _SKETCHED else _LAST for hashes in (first, second))
    first, second = ({value for value in hashes if value <= reach} for hashes in (first, second))
    both = len(first & second)
    return both / min(len(first), len(second)) if both >= _LEAST_SHARED else 0.0


def _hashes(text: str) -> set[bytes]:
    raw = base64.b64decode(text)
    return {raw[k : k + 8] for k in range(0, len(raw), 8)}
