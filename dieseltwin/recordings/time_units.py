"""Units of time: their size, how files spell them, and the one that rows of a recording make likely."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping

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


def likely_unit(step: float) -> float:
    """Size [s] of the unit of a clock that steps by that number and says no unit."""
    if step < DAYS_BELOW:
        return SECONDS["d"]
    return SECONDS["s" if step < S_BELOW else "ms" if step < MS_BELOW else "us" if step < US_BELOW else "ns"]
