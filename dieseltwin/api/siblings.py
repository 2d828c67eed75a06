"""Engines of one type that were learned before: which they are, and what they say of the next one."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from dieseltwin.engine import HEALTH, EngineParameters, we2011
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import Belief, Further
from dieseltwin.learning.files import LearnedEngine, learned_engine_of
from dieseltwin.learning.siblings import Sibling, belief_from_siblings
from dieseltwin.learning.weather import OfType
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.defaults import default_learn, default_search


def siblings_of(
    siblings: Sequence[str | Path], base: EngineParameters, map_rms: float, own: Iterable[Recording]
) -> dict[str, LearnedEngine]:
    """File -> engine of the type, each engine once, in an order of its own.

    Args:
        siblings: files; base, map_rms: of the new engine.
        own: the new engine's recordings, on which no sibling may rest.

    Raises:
        InputError: no learned engine, one of another base or size of errors, the new engine itself, or one engine as
            it was learned from some recordings and from others: those that both rest on would count twice.
    """
    found: dict[str, tuple[str, LearnedEngine]] = {}
    of_own, known = _hashes(own), dict[str, str]()
    for name in siblings:
        one = learned_engine_of(name)
        if one is None:
            raise InputError(f"--siblings {name}", "no learned engine", "a file of `dieseltwin learn`",
                             "learn it first")
        if one.map_rms != map_rms:
            raise InputError(f"--siblings {name}", f"learned with a map error of {one.map_rms:g}", f"{map_rms:g}, as "
                             "of the new engine", "name the same --map-error")
        rests_on = _hashes(one.recordings)
        if of_own & rests_on:
            raise InputError(f"--siblings {name}", "learned from a recording of the new engine itself",
                             "another engine of the type", "leave it out")
        if _maps_of(one.base) != _maps_of(base):
            raise InputError(f"--siblings {name}", "learned from another base engine", "the base of the new engine",
                             "name the same --engine")
        key = "".join(item.sha256 for item in one.recordings)
        if key in found and np.array_equal(found[key][1].belief.mean, one.belief.mean):
            continue  # a copy of its file
        if shared := sorted(known[item] for item in rests_on & known.keys()):
            raise InputError(f"--siblings {name}", f"a recording that {shared[0]} was learned from, too",
                             "each engine of the type once", "leave out the one that was learned from less")
        found[key] = str(name), one
        known |= dict.fromkeys(rests_on, str(name))
    return dict(found[key] for key in sorted(found))


def _hashes(recordings: Iterable[Recording]) -> set[str]:
    """Of files and of what is in them: a copy with other line ends is no other recording."""
    return {sha256 for item in recordings for sha256 in (item.sha256, item.rows_sha256)}


def _maps_of(engine: EngineParameters) -> EngineParameters:
    """An engine but for what each of a type has of its own: health and ambient."""
    health = dict(zip(HEALTH, we2011.PARAMETERS.health(), strict=True))
    return engine.replace(**health, p_amb=we2011.PARAMETERS.p_amb, T_amb=we2011.PARAMETERS.T_amb)


def what_they_say(
    siblings: Collection[LearnedEngine], engine: EngineParameters, map_rms: float
) -> tuple[Belief, OfType]:
    """What is believed of a new engine, and of its compressor in other weather.

    Args:
        siblings: one at least; engine: the new one's base, of the weather of its own recordings; map_rms: as theirs.
    """
    type_share, beliefs = default_learn().type_share, default_search().circumstances
    further = Further(*np.mean([astuple(one.further) for one in siblings], axis=0).tolist())
    told = [
        Sibling(one.believed, one.belief, one.in_its_weather(one.base), one.errors, one.exponents,
                {} if one.of_type is None else one.of_type.exponents)
        for one in siblings
    ]  # fmt: skip
    return belief_from_siblings(told, engine, map_rms, type_share, beliefs, further)


__all__ = ["siblings_of", "what_they_say"]
