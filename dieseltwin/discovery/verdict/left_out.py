"""What of a recording wasn't used: where errors of maps within their tolerance don't act linearly."""

from __future__ import annotations

from pydantic import Field

from dieseltwin.engine.courses import Spans
from dieseltwin.notes import Note, listing
from dieseltwin.settings.strict import FrozenModel

_NOTED = 0.02  # share of a recording, more than one of its sixty windows [-]
_LISTED = 8  # spans; the document has all


class LeftOut(FrozenModel):
    """What wasn't used: its share of the rows [-], and the spans [s from the recording's first row], none of several
    recordings together."""

    share: float = Field(ge=0.0, le=1.0)
    spans_s: Spans = ()


def left_out_words(left_out: LeftOut) -> str:
    """The share and the spans, "8.3 % of the recording (90 to 100 s and 250 to 270 s)"."""
    spans = [f"{first:.0f} to {last:.0f} s" for first, last in left_out.spans_s]
    shown = spans if len(spans) <= _LISTED else [*spans[:_LISTED], f"{len(spans) - _LISTED} more"]
    return f"{100.0 * left_out.share:.2g} % of the recording" + (f" ({listing(shown)})" if shown else "")


def left_out_notes(left_out: LeftOut | None) -> list[Note]:
    """A note where that is much of the recording."""
    if left_out is None or left_out.share <= _NOTED:
        return []
    return [Note(f"{left_out_words(left_out)} was left out: errors of maps don't act in proportion to their size "
                 "there, so that any effect could seem to explain what they do", "left_out")]  # fmt: skip
