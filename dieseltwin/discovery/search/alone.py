"""What each of several recordings leaves unexplained when it is judged by itself.

Together, recordings of two engines bend the maps that they share until next to nothing is left, and the difference goes
by the name of some fault that began between two of them. Alone, a recording of another engine asks of maps and sensors
more than is open of them, and no fault takes its place. A fault, or health that has moved, is explained there.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit
from dieseltwin.discovery.likelihood.learned import LearnedTwin
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.likelihood.score import best_of_each
from dieseltwin.discovery.search.preparation import prepare, recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.settings.search import SearchSettings

_REFITTED = 8  # effects, the best by their linear gains


def left_alone(found: Search, enough: float) -> Array:
    """-2 log likelihood a reading of every recording by itself, beside what explains it best [-].

    Noise leaves 1. By what maps and sensors would have to be off counts as well, over what is believed of them.

    Args:
        found: a finished search, each recording in the circumstances that were found.
        enough: what may be left; where the best effect leaves more, all is linearised about it once more.

    Returns:
        (R,); none on one recording.
    """
    if not isinstance(found.twin, OverRecordings):
        return np.zeros(0)
    return np.array([_left(_as_believed(part), found.settings, enough) for part in found.twin.parts])


def _as_believed(part: Twin) -> Twin:
    """A recording's twin about the belief's mean, without what was given up of it together with the others."""
    if isinstance(part, LearnedTwin) and part.belief is not None:
        return part.deviating(np.zeros_like(part.deviation), np.zeros_like(part.moved))
    return with_own_readings(part)


def with_own_readings(part: Twin) -> Twin:
    """A recording's twin with readings of its own: a search moves them, and those of `part` belong to another one."""
    apart = copy(part)
    apart.measured = part.measured.copy()
    return apart


def refits_alone(twin: Twin, settings: SearchSettings) -> tuple[Search, list[Fit]]:
    """A recording's own search as it begins, and the refits of the effects that lead there."""
    own = prepare(twin, settings)
    kept = best_of_each(own.scored)[:_REFITTED]
    return own, refit_all(own.null, [Candidate((s.name,)) for s in kept], [s.response[None] for s in kept])


def _left(twin: Twin, settings: SearchSettings, enough: float) -> float:
    own, fits = refits_alone(twin, settings)
    readings = float(own.whitening.present.sum())
    least = min((own.null.fit, *fits), key=lambda fit: fit.objective)
    if least.objective <= enough * readings:
        return least.objective / readings
    # beside a large fault maps and initial states answer otherwise than without it
    return min(least.objective, recentred(own, least).fit.objective) / readings
