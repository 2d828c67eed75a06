"""When what was found is looked for again with seconds weighed beside it, and when that has come to rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.discovery.likelihood.fit import Fit
from dieseltwin.discovery.search.alarms import raises_alarm
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.petrol.twin import PetrolTwin

NEARLY = 0.3  # standard deviations by which a size may still change


def leading(found: Search) -> Fit | None:
    """The explanation about which seconds are to be weighed anew: the one chosen, or the best name where it isn't
    enough, as it isn't where it weighs itself down."""
    if found.best is not None:
        return found.best.fit
    return found.singles[0] if found.kind == "law" and raises_alarm(found, found.singles[0]) else None


def over_time(twin: PetrolTwin, fit: Fit) -> list[Mapping[str, Array]]:
    """Effects with their sizes over time (n,), as they were found and were they there all along."""
    ones = np.ones(len(twin.time_s))
    always = {name: size * ones for name, size in zip(fit.candidate.names, fit.magnitudes, strict=True)}
    return [{name: size * fit.candidate.schedules.get(name, ones) for name, size in always.items()}, always]


def alike(before: Search, found: Search) -> bool:
    """Whether two searches end with the same names since the same time, of nearly the same size."""
    one, other = leading(before), leading(found)
    if one is None or other is None or before.kind != found.kind or _course(before) != _course(found):
        return one is other
    if one.candidate.names != other.candidate.names:
        return False
    std = other.std[len(other.parameters) :]
    return bool(np.all(np.abs(one.magnitudes - other.magnitudes) < NEARLY * std))


def _course(found: Search) -> tuple[object, ...]:
    """Since when and until when what was found acts, and whether it grows."""
    variant = found.variant
    return () if variant is None else (variant.onset_s, variant.until_s, variant.grows)
