"""Since when something is missing in a rig's file, where it isn't so from the recording's first row on."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.score import Scored, effect_responses, score, secant_sizes
from dieseltwin.rigs.twin import RigTwin
from dieseltwin.settings.search import RigSettings

_TIMES = 24  # at which every effect is let begin; between them the best one's onset is moved
_LEADERS = 4  # effects whose onsets are moved: which is right is seen only then
_FIRST_STEPS = 12  # of the span: shorter ones may not lead out of a window
_ROUNDS = 3  # of a fit at one of them


def first_onset(at: Linearisation, settings: RigSettings, withhold: Collection[str]) -> Linearisation | None:
    """The effect that explains most where it begins in the middle, and when; None where none gains what chance doesn't.

    The fit is in the size of the misfit that one like it leaves.

    Args:
        at: the rig fitted without any effect.
        settings: of the search.
        withhold: effects to do without.
    """
    twin = cast(RigTwin, at.twin)
    names = [name for name in twin.hypotheses if name not in withhold]
    wanted = secant_sizes(twin, names)
    rows = _allowed(twin, settings)
    if not wanted or len(rows) < 2:
        return None
    best: dict[str, tuple[Scored, float]] = {}
    for time in map(float, twin.time_s[np.unique(np.linspace(rows[0], rows[-1], _TIMES).round().astype(int))]):
        for item in score(at, wanted, effect_responses(twin.since(time), at, wanted)):
            if np.isfinite(item.gain) and (item.name not in best or item.gain > best[item.name][0].gain):
                best[item.name] = item, time
    leaders = sorted(best.values(), key=lambda found: -found[0].gain)[:_LEADERS]
    # Where the misfit is large and slow, few of its readings are independent, and no gain is: then the share tells.
    if not leaders or leaders[0][0].gain < min(settings.variant_gain, settings.least_explained * at.fit.objective):
        return None
    fits = []
    for item, time in leaders:
        fit = replace(at.fit, candidate=Candidate((item.name,)), magnitudes=np.array([item.magnitude]))
        with suppress(np.linalg.LinAlgError):  # the machine runs away with it
            fits.append(dated(twin.since(time), twin.whitening(), fit, settings))
    if not fits:
        return None
    midway = min(fits, key=lambda found: found.fit.objective)
    # once more in the size of the misfit that it leaves
    twin = cast(RigTwin, midway.twin).about(midway.residual)
    return dated(twin, twin.whitening(), midway.fit, settings)


def dated(twin: RigTwin, whitening: Whitening, fit: Fit, settings: RigSettings) -> Linearisation:
    """The fit of effects with the onset that is best for them, which its twin has.

    The onset moves by ever smaller steps, from sample to sample in the end; at each everything is fitted anew.
    """
    rows = _allowed(twin, settings)

    def fitted(row: int) -> Linearisation:
        return fit_fully(twin.since(float(twin.time_s[row])), whitening, best.fit, rounds=_ROUNDS)

    best = fit_fully(twin, whitening, fit, rounds=2 * _ROUNDS)
    here = int(np.clip(np.searchsorted(twin.time_s, cast(float, twin.since_s)), rows[0], rows[-1]))
    step = max(len(rows) // _FIRST_STEPS, 1)
    while step:
        others = {row: fitted(row) for row in (here - step, here + step) if rows[0] <= row <= rows[-1]}
        row = min(others, key=lambda row: others[row].fit.objective, default=here)
        if row != here and others[row].fit.objective < best.fit.objective:
            here, best = row, others[row]
        else:
            step //= 2
    return best


def _allowed(twin: RigTwin, settings: RigSettings) -> np.ndarray:
    """Samples at which an effect may begin: what it acts on, and what it doesn't, is more than a moment."""
    n = len(twin.time_s)
    least = max(int(settings.onset_share * n), 1)
    return np.arange(least, n - least)
