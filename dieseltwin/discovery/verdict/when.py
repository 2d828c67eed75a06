"""When and in which driving a mismatch acts, in words and as marks on an axis of time."""

from __future__ import annotations

from collections.abc import Mapping

from dieseltwin.discovery.verdict.document import Location
from dieseltwin.notes import listing

CONDITIONS: Mapping[str, tuple[str, str]] = {
    "n_e_rpm": ("n_e", "rpm"), "u_delta_mg": ("u_delta", "mg/cycle"), "u_egr_pct": ("u_egr", "%"),
    "u_vgt_pct": ("u_vgt", "%"),
}  # fmt: skip
"""Column of an operating condition -> its symbol and unit."""

_LISTED = 4  # spans; more are counted
_PLAIN_S = 2.0  # a date that is known to this is said by itself


def clock(seconds: float) -> str:
    """A time of the recording, `312 s`, with minutes beyond ten of them."""
    return f"{seconds:.0f} s" + (f" ({seconds / 60:.1f} min)" if abs(seconds) >= 600.0 else "")


def _span(first_s: float, last_s: float) -> str:
    """Two times of the recording, `from 300 to 420 s`, both with minutes beyond ten of them."""
    minutes = f" ({first_s / 60:.1f} to {last_s / 60:.1f} min)" if abs(last_s) >= 600.0 else ""
    return f"from {first_s:.0f} to {last_s:.0f} s{minutes}"


def _range(dates: tuple[float, float] | None) -> str:
    """Between which dates, `250 to 290 s`; empty where they are as good as one."""
    return "" if dates is None or dates[1] - dates[0] <= _PLAIN_S else f"{dates[0]:.0f} to {dates[1]:.0f} s"


def _dated(seconds: float, dates: tuple[float, float] | None) -> str:
    """A date with those that explain as much, `288 s (250 to 290 s)`."""
    date, others = clock(seconds), _range(dates)
    if not others:
        return date
    return f"{date[:-1]}; {others})" if date.endswith(")") else f"{date} ({others})"


def _ends(where: Location) -> str:
    """Between which dates a span with two edges began and ended, in brackets."""
    dates = (("begun at", _range(where.onset_range_s)), ("gone at", _range(where.until_range_s)))
    said = [f"{word} {others}" for word, others in dates if others]
    return f" ({', '.join(said)})" if said else ""


def when_words(where: Location) -> str:
    """Since when, until when, and whether it grows, on one recording; or the driving in which alone it acts."""
    onset, until = where.onset_s, where.until_s
    if where.only_in:
        return only_in_words(where)
    if where.gone_s:
        return _in_parts(where)
    if where.grows:
        begun = "the start" if onset is None else _dated(onset, where.onset_range_s)
        return f"at the end, grown evenly from nothing since {begun}"
    if until is not None:
        alone = f"until {_dated(until, where.until_range_s)}"
        span = alone if onset is None else f"{_span(onset, until)}{_ends(where)}"
        return f"{span}, and gone since then"
    return "from the start" if onset is None else f"since {_dated(onset, where.onset_range_s)}"


def only_in_words(where: Location) -> str:
    """The driving in which alone it acts ("only at n_e 947 to 1720 rpm and u_delta up to 146 mg/cycle")."""
    order = [*(name for name in CONDITIONS if name in where.only_in), *sorted(set(where.only_in) - set(CONDITIONS))]
    return f"only at {listing([_range_words(name, *where.only_in[name]) for name in order])}"


def _range_words(column: str, low: float | None, high: float | None) -> str:
    symbol, unit = CONDITIONS.get(column, (column, ""))
    first, last = (None if edge is None else f"{float(f'{edge:.3g}'):g}".replace("-", "−") for edge in (low, high))
    if first is not None and last is not None:
        span = f"{first} to {last} {unit}"
    else:
        span = f"up to {last} {unit}" if first is None else f"from {first} {unit} on"
    return f"{symbol} {span}"


def _in_parts(where: Location) -> str:
    """The spans in which it is there, each where they are few."""
    begins = [where.onset_s, *(again for _, again in where.gone_s)]
    ends = [*(gone for gone, _ in where.gone_s), where.until_s]
    if len(begins) > _LISTED:
        last = "the end" if ends[-1] is None else clock(ends[-1])
        first = "the start" if begins[0] is None else clock(begins[0])
        return f"coming and going: in {len(begins)} spans between {first} and {last}"
    spans = [_part(*span) for span in zip(begins, ends, strict=True)]
    return f"coming and going: {', '.join(spans[:-1])} and {spans[-1]}"


def _part(begin: float | None, end: float | None) -> str:
    if end is None:
        return f"since {clock(begin or 0.0)}"
    return f"until {clock(end)}" if begin is None else _span(begin, end)


def moments(where: Location | None) -> tuple[tuple[str, float], ...]:
    """Onset and end by their names [s], those that there are within one recording."""
    if where is None or where.onset_date is not None:
        return ()
    inner = ((name, at) for span in where.gone_s for name, at in zip(("gone", "there again"), span, strict=True))
    times = (("onset", where.onset_s), *inner, ("end", where.until_s))
    return tuple((name, at) for name, at in times if at is not None)
