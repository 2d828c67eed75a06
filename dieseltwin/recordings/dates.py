"""When a recording was made, and how that is known."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from dieseltwin.errors import InputError
from dieseltwin.recordings.reader import Recording

STAMP, NAME, MODIFIED, ORDER = "time stamp", "file name", "file's modification time", "order given"
_IN_NAME = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[-_T ]?([01]\d|2[0-3])[-_:.]?([0-5]\d)(?:[-_:.]?[0-5]\d)?)?(?!\d)"
)
_FIRST_EPOCH_S = 946684800.0  # 2000-01-01 in seconds since 1970: no time since a logger's start is that large
_START = datetime(1970, 1, 1, tzinfo=UTC)  # of recordings without a date, a day apart


@dataclass(frozen=True)
class Dated:
    """A recording with its date.

    Attributes:
        recording: what was recorded.
        date: of its first row, in UTC.
        date_from: how that is known, in words.
    """

    recording: Recording
    date: datetime
    date_from: str

    @property
    def day(self) -> str:
        """The date for people: YYYY-MM-DD, or which recording it is where no date is known."""
        if self.date_from == ORDER:
            return f"recording {self.date.toordinal() - _START.toordinal() + 1}"
        return self.date.strftime("%Y-%m-%d")


def dated(recording: Recording) -> Dated | None:
    """The recording with its own date: by its time stamps, by its file's name, else by its file; None without a file.

    A time column counts as stamps where it holds seconds since 1970. A date in a name looks like 2026-03-14 or
    20260314T0815.
    """
    stamp = float(recording.time_s[0])
    if stamp >= _FIRST_EPOCH_S:
        return Dated(recording, datetime.fromtimestamp(stamp, UTC), STAMP)
    if recording.began is not None:
        return Dated(recording, recording.began, STAMP)
    if recording.path is None:
        return None
    named = date_in(recording.path.name)
    if named is not None:
        return Dated(recording, named, NAME)
    if not recording.path.is_file():
        return None
    return Dated(recording, datetime.fromtimestamp(recording.path.stat().st_mtime, UTC), MODIFIED)


def date_in(name: str) -> datetime | None:
    """The date that a file's name says, in UTC; None where it says none."""
    found = _IN_NAME.search(name)
    if found is None:
        return None
    year, month, day, hour, minute = (int(part or 0) for part in found.groups())
    try:
        return datetime(year, month, day, hour, minute, tzinfo=UTC)
    except ValueError:  # 30 February
        return None


def in_time_order(recordings: Sequence[Recording]) -> tuple[Dated, ...]:
    """Recordings with their dates, the earliest first; where one has none, a day apart in the order given.

    Of one date, as names without a time of day are, each follows the one before in the order given.

    Raises:
        InputError: the same recording twice.
    """
    hashes = [item.sha256 for item in recordings]
    for item in recordings:
        if hashes.count(item.sha256) > 1:
            raise InputError(str(item.path or "recording"), "the same recording twice", "each once", "name it once")
    known = [dated(item) for item in recordings]
    found = sorted((item for item in known if item is not None), key=lambda item: item.date)
    unsure = any(a.date == b.date and MODIFIED in (a.date_from, b.date_from) for a, b in pairwise(found))
    if len(found) < len(known) or unsure:  # files that were copied together have the same date of change
        return tuple(Dated(item, _START + timedelta(days=k), ORDER) for k, item in enumerate(recordings))
    in_order: list[Dated] = []
    for one in found:
        last = in_order[-1] if in_order else None
        if last is not None and one.date <= last.date:
            one = replace(one, date=last.date + timedelta(seconds=last.recording.duration_s))
        in_order.append(one)
    return tuple(in_order)
