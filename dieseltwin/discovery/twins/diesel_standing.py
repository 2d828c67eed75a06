"""The diesel engine as a twin of settled points: one window a point, at whose end the engine rests."""

from __future__ import annotations

from typing import Any

import numpy as np

from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.twins.windows import ends_of
from dieseltwin.recordings.standing import HOLD_S

_KNOWN_START = 1.0  # rad/s; where a point begins says nothing of where it rests


class StandingTwin(LoggedTwin):
    """`LoggedTwin` of a recording of `recordings.standing`; each point's readings count once, in its last row."""

    window_s = HOLD_S

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.state_scales = np.array([_KNOWN_START])

    def _begin(self) -> None:
        super()._begin()
        before = np.ones(self.time_s.size, dtype=bool)
        before[ends_of(self.starts, before.size) - 1] = False
        self.measured[before] = np.nan

    def split(self, windows: np.ndarray, parts: int, local: Array) -> Array:
        """A point has no parts: the initial states stay."""
        return local
