"""Units of time: their size, how files spell them, and the one that a clock's name carries."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping

from dieseltwin.recordings.importers.layout import unit_in_name

SECONDS: Mapping[str, float] = {
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}  # fmt: skip
"""Our spelling -> size [s]."""
SPELLINGS: Mapping[str, str] = {
    "s": "s sec secs second seconds sek sekunde sekunden seconde secondes segundo segundos secondo secondi",
    "ms": "ms msec msecs millis millisecond milliseconds millisekunde millisekunden",
    "us": "us \u03bcs usec usecs micros microsecond microseconds mikrosekunde mikrosekunden",
    "ns": "ns nsec nsecs nanos nanosecond nanoseconds nanosekunde nanosekunden",
    "min": "min mins minute minutes minuten",
    "h": "h hr hrs hour hours std stunde stunden heure heures",
    "d": "d day days tag tage",
}
"""Our spelling -> spellings met in files (lower case)."""
_SIZE = {word: SECONDS[ours] for ours, words in SPELLINGS.items() for word in words.split()}
DAYS_BELOW, S_BELOW, MS_BELOW, US_BELOW = 1e-4, 5.0, 5e3, 5e6
"""Step from row to row below which a number without a unit is a time in that unit: rows are 1 to 100 a second."""


def in_s(spelling: str | None) -> float | None:
    """Size of a unit of time [s]; None where nobody knows the spelling."""
    if spelling is None:
        return None
    return _SIZE.get(unicodedata.normalize("NFKC", spelling).strip().lower().rstrip("."))


def told_unit(name: str, unit: str | None) -> float | None:
    """Size [s] of a clock's unit, by what the file says besides or by its name ('Time [ms]', 't_min'); None without.

    Args:
        name: of a column of times: in another one, 'min' may be the smallest.
        unit: as the file gives it beside the name.
    """
    last = re.split(r"[\s_]+", name.strip())[-1]
    return next((size for text in (unit, unit_in_name(name), last) if (size := in_s(text)) is not None), None)


def likely_unit(step: float) -> float:
    """Size [s] of the unit of a clock that steps by that number and says no unit."""
    if step < DAYS_BELOW:
        return SECONDS["d"]
    return SECONDS["s" if step < S_BELOW else "ms" if step < MS_BELOW else "us" if step < US_BELOW else "ns"]
