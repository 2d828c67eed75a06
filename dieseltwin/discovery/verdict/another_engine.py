"""Which of several recordings doesn't look like the same engine as the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.discovery.search.alone import left_alone
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.verdict.document import LEFT_OVER
from dieseltwin.notes import Note, listing
from dieseltwin.recordings.dates import Dated


def of_another_engine(found: Search, days: Sequence[Dated]) -> list[Note]:
    """A note on recordings that nothing explains by themselves, where others are explained; none where all are alike.

    Args:
        found: the search over all; days: the recordings, in time order.
    """
    left = left_alone(found, LEFT_OVER)
    strange = left > LEFT_OVER
    if not strange.any() or strange.all():
        return []
    named = [f"{_name(days[r])} ({left[r]:.2f} of chi-square per sample)" for r in np.flatnonzero(strange).tolist()]
    one = len(named) == 1
    return [Note(f"{listing(named)} {'does' if one else 'do'} not look like the same engine: judged alone, neither "
                 f"health nor any one effect explains {'it' if one else 'them'}, as the others are "
                 f"({left[~strange].max():.2f} at most, where noise leaves 1); either {'it is' if one else 'they are'} "
                 "of another engine or sensors, or several things have changed: judge the others without "
                 f"{'it' if one else 'them'}", "wrong_engine")]  # fmt: skip


def _name(day: Dated) -> str:
    return day.day if day.recording.path is None else day.recording.path.name
