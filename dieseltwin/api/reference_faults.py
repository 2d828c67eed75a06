"""Words for the faults that a reference may have had: which one it looks like, and which it could hide."""

from __future__ import annotations

from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.files import LearnedEngine
from dieseltwin.notes import listing
from dieseltwin.report.discovery_words import magnitude_words

_ALIKE = 0.25  # of what errors of maps gain, from which on a fault is named beside them
_NAMED = 3


def alike_line(known: LearnedEngine, least: float) -> list[str]:
    """That a fault in the reference would look as these errors of the maps do, and which fit best.

    Args:
        known: with errors of its maps beyond the usual ones; least: gain from which on an effect is said.
    """
    close = [item for item in known.faults if item.rival > 0.0 and item.gain > max(least, _ALIKE * item.rival)]
    if not any(item.rival > 0.0 for item in known.faults):
        return []
    if not close:
        return ["  a fault in the reference would look alike, but none of the main ones fits nearly as well: "
                + ", ".join(item.name for item in known.faults)]  # fmt: skip
    words = [f"{_sized(item)} ({100.0 * min(item.gain / item.rival, 9.99):.0f} % of what they gain)"
             for item in close[:_NAMED]]  # fmt: skip
    return [f"  a fault in the reference would look alike; in their place fits best {listing(words)}"]


def hidden_line(known: LearnedEngine, least: float) -> list[str]:
    """The sizes of the main faults that the reference could have without its being said."""
    if not known.faults:
        return []
    sizes = [f"{item.name} {magnitude_words(item.name, item.hidden(least), None, item.unit, extra=False, digits=2)}"
             for item in sorted(known.faults, key=lambda item: item.name)]  # fmt: skip
    return [f"  faults that the reference could have had unsaid, up to about: {', '.join(sizes)}"]


def suspected_faults(known: LearnedEngine, least: float, said: bool) -> list[str]:
    """That the reference looks like one of the main faults.

    Args:
        known: what was learned; least: gain from which on an effect is said; said: some effect is said already.
    """
    first = next(iter(known.faults), None)
    if said or first is None or not first.told(least):
        return []
    in_place = (", and more than the errors of maps beyond the usual ones that are believed in its place"
                if first.rival > 0.0 else "")  # fmt: skip
    return [
        f"the reference itself looks like {first.name} of {_sized(first, named=False)}: fitted beside it, maps have to "
        f"be off by less ({first.gain**0.5:.1f} standard deviations{in_place}); it is now part of what counts as "
        "healthy, and its end would look like a fault"
    ]


def _sized(item: FaultBeside, named: bool = True) -> str:
    size = magnitude_words(item.name, item.size, item.std, item.unit, extra=False, digits=2)
    return f"{item.name} of {size}" if named else size
