"""Times about a first estimate of an onset, at which what begins is let begin, too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from dieseltwin.discovery.twins.interface import Twin
from dieseltwin.discovery.twins.offers import Offer

ONSET_REACHES_S = (8.0, 2.0)
"""How far about the best onset so far others are tried, in turn [s]: windows are some ten seconds long."""


@runtime_checkable
class WithOnsetReaches(Offer, Protocol):
    """A twin whose windows are of another length, or none: its own reaches for laws, in place of `ONSET_REACHES_S`."""

    onset_reaches_s: Sequence[float]


def onset_reaches(twin: Twin) -> Sequence[float]:
    """How far about the best onset so far others are tried, in turn [s]."""
    return twin.onset_reaches_s if isinstance(twin, WithOnsetReaches) else ONSET_REACHES_S


def times_about(twin: Twin, around_s: float, reach_s: float) -> list[float]:
    """Five times about a first estimate of an edge in time, at samples [s]."""
    times = np.linspace(around_s - reach_s, around_s + reach_s, 5)
    inner = times[(times > twin.time_s[2]) & (times < twin.time_s[-3])]
    return sorted({float(twin.time_s[np.searchsorted(twin.time_s, t)]) for t in inner})
