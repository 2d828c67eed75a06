"""Engines of one type that were learned before: which they are, and what they say of the next one."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import astuple
from pathlib import Path

import numpy as np

from dieseltwin.engine import HEALTH, EngineParameters, we2011
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import Belief, Further
from dieseltwin.learning.files import LearnedEngine, learned_engine_of
from dieseltwin.learning.siblings import Sibling, belief_from_siblings
from dieseltwin.learning.weather import OfType
from dieseltwin.settings.defaults import default_learn, default_search


def siblings_of(
    siblings: Sequence[str | Path], base: EngineParameters, map_rms: float, own: AbstractSet[str]
) -> dict[str, LearnedEngine]:
    """File -> engine of the type, each engine once, in an order of its own.

    Args:
        siblings: files; base, map_rms: of the new engine.
        own: hashes of the new engine's recordings, on which no sibling may rest.

    Raises:
        InputError: no learned engine, one of another base or size of errors, or the new engine itself.
    """
    found: dict[str, tuple[str, LearnedEngine]] = {}
    for name in siblings:
        one = learned_engine_of(name)
        if one is None:
            raise InputError(f"--siblings {name}", "no learned engine", "a file of `dieseltwin learn`",
                             "learn it first")
        if one.map_rms != map_rms:
            raise InputError(f"--siblings {name}", f"learned with a map error of {one.map_rms:g}", f"{map_rms:g}, as "
                             "of the new engine", "name the same --map-error")
        if own & {item.sha256 for item in one.recordings}:
            raise InputError(f"--siblings {name}", "learned from a recording of the new engine itself",
                             "another engine of the type", "leave it out")
        if _maps_of(one.base) != _maps_of(base):
            raise InputError(f"--siblings {name}", "learned from another base engine", "the base of the new engine",
                             "name the same --engine")
        found["".join(item.sha256 for item in one.recordings)] = str(name), one
    return dict(found[key] for key in sorted(found))


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
