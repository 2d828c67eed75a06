"""When a mismatch acts, in words and as marks on an axis of time."""

from __future__ import annotations

from dieseltwin.discovery.verdict.document import Location


def clock(seconds: float) -> str:
    """A time of the recording, `312 s`, with minutes beyond ten of them."""
    return f"{seconds:.0f} s" + (f" ({seconds / 60:.1f} min)" if abs(seconds) >= 600.0 else "")


def _span(first_s: float, last_s: float) -> str:
    """Two times of the recording, `from 300 to 420 s`, both with minutes beyond ten of them."""
    minutes = f" ({first_s / 60:.1f} to {last_s / 60:.1f} min)" if abs(last_s) >= 600.0 else ""
    return f"from {first_s:.0f} to {last_s:.0f} s{minutes}"


def when_words(where: Location) -> str:
    """Since when, until when, and whether it grows, on one recording."""
    onset, until = where.onset_s, where.until_s
    if where.grows:
        return f"at the end, grown evenly from nothing since {'the start' if onset is None else clock(onset)}"
    if until is not None:
        span = f"until {clock(until)}" if onset is None else _span(onset, until)
        return f"{span}, and gone since then"
    return "from the start" if onset is None else f"since {clock(onset)}"


def moments(where: Location | None) -> tuple[tuple[str, float], ...]:
    """Onset and end by their names [s], those that there are within one recording."""
    if where is None or where.onset_date is not None:
        return ()
    return tuple((name, at) for name, at in (("onset", where.onset_s), ("end", where.until_s)) if at is not None)
