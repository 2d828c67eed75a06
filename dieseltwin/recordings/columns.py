"""Columns that nobody changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray


class Columns(Mapping[str, NDArray[np.float64]]):
    """Columns by name, read-only. Unlike a `MappingProxyType` they can be pickled and copied, as whoever judges many
    recordings on several cores needs it."""

    __slots__ = ("_held",)

    def __init__(self, held: Mapping[str, NDArray[np.float64]]) -> None:
        self._held = dict(held)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self._held[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._held)

    def __len__(self) -> int:
        return len(self._held)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._held!r})"
