"""Units that a file states, against those of our names and of the channel map: 't_em_k' in a row of units '°F'."""

from __future__ import annotations

from collections.abc import Mapping

from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import CONVERSIONS, ChannelEntry, ChannelMap, known_columns, unit_of
from dieseltwin.recordings.unit_spellings import Unit, understood

_SAYS_NOTHING = ("unknown", "other", "number")  # dimensions whose spellings may mean anything, as '-' of a position
PER_SECOND = "1/s"  # written for rad/s, too


def against_stated(units: Mapping[str, str | None], mapping: ChannelMap, where: str) -> list[str]:
    """Refuse a column with our name that the file states in another unit; notes where the map says another one.

    Args:
        units: the file's names -> the units that it states.
        where: name of the file, for messages.

    Raises:
        InputError: name and unit contradict each other, and no channel map decides.
    """
    ours = set(known_columns())
    notes = []
    for name, spelling in units.items():
        stated = understood(spelling)
        if stated is None or stated.dimension in _SAYS_NOTHING or stated.ours == PER_SECOND:
            continue
        entry = mapping.entries.get(name)
        if entry is not None:
            if _differs(entry, stated):
                notes.append(f"{name} is in {entry.unit} by the channel map and in {spelling} by the file: "
                             "the map's unit is taken")
        elif name in ours and not _is(unit_of(name), stated):
            raise InputError(f"{where}: column {name}", f"the unit {spelling} in the file",
                             f"{unit_of(name)}, as the name says", "correct the one that is wrong, or give the unit "
                             "in a channel map (--channels); `dieseltwin channels FILE` writes a first one")
    return notes


def _is(ours: str | None, stated: Unit) -> bool:
    if stated.gauge:
        return False
    return ours is None or CONVERSIONS[ours].get(stated.ours) == (1.0, 0.0)


def _differs(entry: ChannelEntry, stated: Unit) -> bool:
    """Whether the map names a unit of the same kind that is another one; a scale of one's own is no slip."""
    told = understood(entry.unit)
    if told is None or (entry.scale, entry.offset) != (1.0, 0.0):
        return False
    return told.dimension == stated.dimension and told.ours != stated.ours
