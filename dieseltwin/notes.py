"""Notes about an answer: text for people, a short stable word for programs, and what it touches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

READING = "reading"
"""Code of a note on what reading did to a file."""

OF_THE_FIT = ("misfit", "residuals")
"""Codes of the notes on how well the twin fits: they stand before the numbers."""

STRICT_CODE = 3
"""Exit code of a command with --strict whose answer carries a note."""


class Note(str):
    """A sentence that also says what kind of doubt it is.

    Attributes:
        code: misfit and residuals (the twin doesn't fit), untested (whether it fits isn't known), more_is_missing,
            not_converged, not_identifiable, out_of_range, extrapolated, left_out, missing_sensor, frozen_channel,
            replayed_channel, clipped_channel, spikes, short, wrong_engine, reading (what was done to the file),
            reference (about what was learned), dates (of several recordings), long (a part was
            judged), out_of_time, false_alarms (of a calibration on pieces without fault),
            circumstances (what a recording doesn't say, found from the recording itself), not_recorded,
            wrong_column (of the weather), long_steps (of a rig's integration), hold (of its inputs between rows),
            terms_left_out (of the engine file), next_effect (what else there may be), health_or_law (which of the two
            changed), rough_maps (found beside maps that are off by percents, without a reference).
        affects: columns, or segments, that it is about; none: the whole answer.
    """

    code: str
    affects: tuple[str, ...]

    def __new__(cls, text: str, code: str, affects: Sequence[str] = ()) -> Note:
        """A note "note: text"."""
        made = super().__new__(cls, f"note: {text}")
        made.code, made.affects = code, tuple(affects)
        return made

    def __getnewargs__(self) -> tuple[str, str, tuple[str, ...]]:  # type: ignore[override]
        """For copies in other processes."""
        return self.removeprefix("note: "), self.code, self.affects


def of_reading(note: str, where: str = "") -> Note:
    """What reading did to a file as a note; one that says what kind of doubt it is keeps that."""
    code, affects = (note.code, note.affects) if isinstance(note, Note) else (READING, ())
    return Note(f"{where}{note.removeprefix('note: ')}", code, affects)


def doubts_among(notes: Iterable[str]) -> list[Note]:
    """Those of some sentences that are notes; the others say what was assumed, always."""
    return [note for note in notes if isinstance(note, Note)]


def warnings_of(notes: Iterable[str]) -> list[dict[str, Any]]:
    """Notes as they stand in a document: code, text, affects."""
    return [{"code": note.code if isinstance(note, Note) else "reference", "text": note.removeprefix("note: "),
             "affects": list(note.affects) if isinstance(note, Note) else []} for note in notes]  # fmt: skip


def counted(number: int, thing: str) -> str:
    """A number with its noun: "1 recording", "3 recordings"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def listing(parts: Sequence[str], last: str = "and") -> str:
    """Words or phrases, one at least: "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"
