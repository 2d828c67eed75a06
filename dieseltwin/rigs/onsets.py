"""When something is missing in a rig's file, where it isn't so from the first row of a recording to its last.

It may begin, be there in a span, or grow. A span's response is what began at its beginning less what began at its end.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.score import Scored, effect_responses, score, secant_sizes
from dieseltwin.discovery.search.variants import SECOND_EDGE
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.rigs.twin import TIMES, RigTwin, When
from dieseltwin.settings.search import RigSettings

_GROWING_SHARE = 0.25  # of the recording that an effect must grow over: what grows faster is a step
_LEADERS = 4  # effects whose edges are moved: which is right is seen only then
_FIRST_STEPS = 12  # of the span: shorter ones may not lead out of a window
_ROUNDS = 3  # of a fit at one of them


def first_course(at: Linearisation, settings: RigSettings, withhold: Collection[str]) -> Linearisation | None:
    """The effect that explains most where it isn't always there, and when; None where none gains what chance doesn't.

    The fit is in the size of the misfit that one like it leaves.

    Args:
        at: the rig fitted without any effect.
        settings: of the search.
        withhold: effects to do without.
    """
    twin = cast(RigTwin, at.twin)
    names = [name for name in twin.hypotheses if name not in withhold]
    wanted = secant_sizes(twin, names)
    rows = allowed_rows(twin, settings)
    if not wanted or len(rows) < 2:
        return None
    best: dict[tuple[str, int], tuple[float, Scored, When]] = {}
    for when, responses in _tried(at, wanted, rows):
        for item in score(at, wanted, responses):
            kind = item.name, _edges(when) + (when.grown_s is not None)
            gain = item.gain - _cost(when, item.gain, settings)
            if np.isfinite(gain) and (kind not in best or gain > best[kind][0]):
                best[kind] = gain, item, when
    leaders = sorted(best.values(), key=lambda found: -found[0])[:_LEADERS]
    # Where the misfit is large and slow, few of its readings are independent, and no gain is: then the share tells.
    if not leaders or leaders[0][0] < min(settings.variant_gain, settings.least_explained * at.fit.objective):
        return None
    fits = []
    for _, item, when in leaders:
        fit = replace(at.fit, candidate=Candidate((item.name,)), magnitudes=np.array([item.magnitude]))
        with suppress(np.linalg.LinAlgError):  # the machine runs away with it
            fits.append(dated(twin.acting(when), twin.whitening(), fit, settings))
    if not fits:
        return None

    def whole(found: Linearisation) -> float:
        gain = at.fit.objective - found.fit.objective
        return found.fit.objective + _cost(cast(When, cast(RigTwin, found.twin).when), gain, settings)

    midway = min(fits, key=whole)
    # once more in the size of the misfit that it leaves
    twin = cast(RigTwin, midway.twin).about(midway.residual)
    return dated(twin, twin.whitening(), midway.fit, settings)


def _tried(at: Linearisation, wanted: Sequence[tuple[str, float]], rows: np.ndarray) -> Iterator[tuple[When, Array]]:
    """Courses of effects of some sizes with their responses (K, n, C)."""
    twin = cast(RigTwin, at.twin)
    times = times_tried(twin, rows)
    first, last = float(twin.time_s[0]), float(twin.time_s[-1])
    since = {t: effect_responses(twin.acting(When(t)), at, wanted) for t in (first, *times)}
    for t in times:
        yield When(t), since[t]
    for t in (first, *times[::2]):
        if last - t > _GROWING_SHARE * (last - first):
            grows = When(t, grown_s=last)
            yield grows, effect_responses(twin.acting(grows), at, wanted)
    for k, begin in enumerate((first, *times)):
        for end in times[k:]:
            if begin < end:
                yield When(begin, end), since[begin] - since[end]


def _edges(when: When) -> int:
    return 2 if when.until_s is not None else 0


def _cost(when: When, gain: float, settings: RigSettings) -> float:
    """What an end must pay for beside the beginning [units of gain]: a large effect is never met exactly."""
    return 0.0 if when.until_s is None else SECOND_EDGE + settings.missing_share * max(gain, 0.0)


def dated(twin: RigTwin, whitening: Whitening, fit: Fit, settings: RigSettings) -> Linearisation:
    """The fit of effects with the edges that are best for them, which its twin has.

    They move by ever smaller steps, from sample to sample in the end; at each everything is fitted anew.
    """
    rows = allowed_rows(twin, settings)
    first = 0 if cast(When, twin.when).grown_s is not None else rows[0]

    def fitted(when: When) -> Linearisation:
        return fit_fully(twin.acting(when), whitening, best.fit, rounds=_ROUNDS)

    best = fit_fully(twin, whitening, fit, rounds=2 * _ROUNDS)
    here, step = cast(When, twin.when), max(len(rows) // _FIRST_STEPS, 1)
    while step:
        others = {when: fitted(when) for when in _moved(twin, here, step, (first, rows[-1]))}
        when = min(others, key=lambda when: others[when].fit.objective, default=here)
        if when != here and others[when].fit.objective < best.fit.objective:
            here, best = when, others[when]
        else:
            step //= 2
    return best


def _moved(twin: RigTwin, when: When, step: int, allowed: tuple[int, int]) -> Iterator[When]:
    """A course with either edge so many samples earlier or later; one at the recording's ends stays there."""
    time_s = twin.time_s

    def near(edge_s: float) -> Iterator[float]:
        row = int(np.searchsorted(time_s, edge_s))
        yield from (float(time_s[r]) for r in (row - step, row + step) if allowed[0] <= r <= allowed[1])

    if when.onset_s > time_s[0] or when.grown_s is not None:
        yield from (replace(when, onset_s=t) for t in near(when.onset_s) if when.until_s is None or t < when.until_s)
    if when.until_s is not None:
        yield from (replace(when, until_s=t) for t in near(when.until_s) if t > when.onset_s)


def times_tried(twin: RigTwin, rows: np.ndarray) -> list[float]:
    """Times at which something is let begin [s], among the samples `rows`."""
    return [float(t) for t in twin.time_s[np.unique(np.linspace(rows[0], rows[-1], TIMES).round().astype(int))]]


def allowed_rows(twin: RigTwin, settings: RigSettings) -> np.ndarray:
    """Samples at which an effect may begin: what it acts on, and what it doesn't, is more than a moment."""
    n = len(twin.time_s)
    least = max(int(settings.onset_share * n), 1)
    return np.arange(least, n - least)
