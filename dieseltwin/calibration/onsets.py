"""Since which point something is there: settled points in the order of the file are a sequence.

A hose comes off in the middle of a day on the test bed. Over all points such a leak has half its size, and the errors
of maps take it up; as a step between two points nothing else has its shape, unless the points were measured in an
order of their own (a map speed by speed): then a step is an error of a map as well, and none is looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, fit_fully
from dieseltwin.discovery.likelihood.refit import refit_all
from dieseltwin.discovery.likelihood.score import Scored, best_of_each, spread, without_parameters
from dieseltwin.discovery.search.explanations import leading_kind
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.sums import Sums

FEWEST = 5  # points before an onset, and behind it
MOST_BY_INPUTS = 0.5  # of the variance of before and after, that the inputs may explain (R^2)
_TRIED = 4  # of the leading effects are refitted
_WORTH = 0.5  # of the bar, or of the best effect's gain, that the linear gain must reach
_NEAR = (-4, -2, -1, 1, 2, 4)  # points about the best onset so far that are tried, too
_ROUNDS = 3  # of a refit


@dataclass(frozen=True)
class Onset:
    """An effect that begins at a point.

    Attributes:
        fit: its refit; others: those of other effects, each with its own onset, weaker ones.
        acts: (N,) 1 where it acts, in the order of the calibration's points.
        row: data row of the first point that has it.
        points: how many judged points come before.
    """

    fit: Fit
    others: tuple[Fit, ...]
    acts: Array
    row: int
    before: int

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.fit.candidate.names[0]


def onset_of(found: Search, twin: SteadyTwin, share: float) -> Onset | None:
    """The effect that begins at a point, where that explains more than what is there in all points.

    What an onset costs is that of recordings: points times effects are thousands of trials.

    Args:
        found: the search without onsets.
        twin: of it.
        share: of the judged points that lie before an onset, and behind it [-].
    """
    items = best_of_each(found.scored)
    rank = twin.file_rank
    judged = np.flatnonzero(rank >= 0)
    allowed = may_begin(twin.data.inputs()[judged[np.argsort(rank[judged])]], share)
    if not items or not allowed.any():
        return None
    sums = Sums(found.null, items)
    parts = sums.of(sums.per_row(rank), int(rank.max()) + 1)
    gains = sums.gains(*(np.cumsum(part[::-1], axis=0)[::-1] for part in parts))
    gains = np.where(allowed[:, None], gains, 0.0)
    settings = found.settings
    always = max([leading_kind(found)[0], *(item.gain for item in found.nameless()[:1])])
    bar = max(settings.hidden_gain, always + settings.variant_gain)
    best = gains.max(axis=0)
    leading = [h for h in np.argsort(-best)[:_TRIED] if best[h] > _WORTH * max(bar, float(best.max()))]
    if not leading:
        return None
    fits = _refitted(found, [items[h] for h in leading], [int(gains[:, h].argmax()) for h in leading], rank)
    at, fit = _moved(found, fits, items, allowed, rank)
    if found.gain(fit) <= bar or not _stands(found, fit):
        return None
    others = tuple(other for _, other in fits if other.candidate.names != fit.candidate.names)
    acts = np.zeros(rank.size)
    acts[twin.order] = rank >= at
    row = int(twin.data.row[np.flatnonzero(rank == at)[0]])
    return Onset(fit, others, acts, row, at)


def _stands(found: Search, fit: Fit) -> bool:
    """Whether its size is of interest and sure, and doesn't hang on one point."""
    sure = abs(fit.magnitudes[0]) > found.settings.second_size_std * fit.std[-1]
    item = next(item for item in found.scored if item.name == fit.candidate.names[0])
    response = fit.candidate.schedules[item.name][:, None] * item.response
    direction = without_parameters(found.null, found.null.metric.project(response[None]))[0]
    return bool(sure and found.of_interest(fit) and spread(found.null, direction) >= found.settings.least_spread)


def _refitted(
    found: Search, items: Sequence[Scored], onsets: Sequence[int], rank: NDArray[np.int64]
) -> list[tuple[int, Fit]]:
    """Onsets with the fits of effects from there on, best first."""
    schedules = [(rank >= at).astype(np.float64) for at in onsets]
    candidates = [Candidate((item.name,), {item.name: acts}) for item, acts in zip(items, schedules, strict=True)]
    first = refit_all(found.null, candidates, [acts[None, :, None] * item.response
                                               for item, acts in zip(items, schedules, strict=True)])  # fmt: skip
    fits = [fit_fully(found.twin, found.whitening, fit, rounds=_ROUNDS, frozen=found.null).fit for fit in first]
    return sorted(zip(onsets, fits, strict=True), key=lambda pair: pair[1].objective)


def _moved(
    found: Search, fits: Sequence[tuple[int, Fit]], items: Sequence[Scored], allowed: NDArray[np.bool_],
    rank: NDArray[np.int64],
) -> tuple[int, Fit]:  # fmt: skip
    """The leading onset and its fit with the edge at the point where it explains most."""
    at, fit = fits[0]
    item = next(item for item in items if item.name == fit.candidate.names[0])
    near = [at + step for step in _NEAR if 0 <= at + step < allowed.size and allowed[at + step]]
    if not near:
        return at, fit
    candidates = [replace(fit, candidate=Candidate((item.name,), {item.name: (rank >= k).astype(np.float64)}))
                  for k in near]  # fmt: skip
    tried = [fit_fully(found.twin, found.whitening, other, rounds=1, frozen=found.null).fit for other in candidates]
    return min([(at, fit), *zip(near, tried, strict=True)], key=lambda pair: pair[1].objective)


def may_begin(inputs: Array, share: float) -> NDArray[np.bool_]:
    """(J,) whether something may begin at each point: far enough from both ends, and where the operating points before
    and behind aren't told apart by their inputs.

    Args:
        inputs: (J, 4) in the order of the file.
        share: of the points that lie before an onset, and behind it [-].
    """
    count = len(inputs)
    least, place = max(FEWEST, int(np.ceil(share * count))), np.arange(count)
    basis = np.linalg.qr(inputs - inputs.mean(axis=0))[0]
    behind = (place[:, None] >= place).astype(np.float64)  # (J, J), a column for every onset
    centred = behind - behind.mean(axis=0)
    explained = ((basis.T @ centred) ** 2).sum(axis=0)
    by_inputs = explained > MOST_BY_INPUTS * (centred**2).sum(axis=0)
    return np.asarray((place >= least) & (place <= count - least) & ~by_inputs)
