"""What an effect that goes unseen would be taken for: how far it moves health at its smallest visible size."""

from __future__ import annotations

from collections.abc import Mapping

from dieseltwin.discovery.likelihood.score import taken_for
from dieseltwin.discovery.search.state import Search

HealthBias = Mapping[str, Mapping[str, float]]
"""Effect -> health parameter -> relative change [-] of the fit that leaves out the smallest visible size of it."""

_LEAST, _MOST = 1e-3, 1.0  # a relative change of health below is none, and of one beyond a straight line says nothing


def health_bias(found: Search, places: Mapping[str, tuple[int, float]]) -> dict[str, dict[str, float]]:
    """What would be said of health beside each effect, unseen; effects that move nothing are left out.

    Args:
        found: a search, its health-only fit made.
        places: health parameter -> its place among the fit's parameters, and what a change there is relative to.
    """
    moved = taken_for(found.null, found.scored, found.settings.alarm_gain)
    changes = {
        effect: {name: float(change[place]) / size for name, (place, size) in places.items()}
        for effect, change in moved.items()
    }
    kept = {effect: {n: v for n, v in own.items() if _LEAST <= abs(v) < _MOST} for effect, own in changes.items()}
    return {effect: own for effect, own in kept.items() if own}


def most_first(bias: HealthBias, effect: str) -> list[tuple[str, float]]:
    """Health parameters that an effect, unseen, would move, and by how much [-]; none where it moves none."""
    return sorted(bias.get(effect, {}).items(), key=lambda item: -abs(item[1]))
