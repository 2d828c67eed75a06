"""Effects that come and go more than once in a recording: a loose contact, a leak that opens when it is hot.

Windows start from their own readings. So one simulation with an effect of the size so far and one without tell every
window whether it was there, and the likeliest parts of the time are a path through the windows whose edges each have to
pay for themselves. The edges' samples are found together, too: each moves what its own windows leave and nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, simulate_fits
from dieseltwin.discovery.likelihood.score import Scored, best_of_each
from dieseltwin.discovery.search.courses import MOST, Parts, at_times
from dieseltwin.discovery.search.sums import Sums
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Array

_EDGES = 21  # samples that are tried for an edge, twice


def in_parts(at: Linearisation, variant: Variant, fit: Fit, edge_gain: float) -> Variant | None:
    """The same effect in two or more parts of the time, None where one part explains as much.

    Args:
        at: the health-only fit, in whose metric windows are compared.
        variant: the effect, as it was found so far.
        fit: its refit: health, initial states and the effect's size stay.
        edge_gain: what each edge must gain.
    """
    twin = at.twin
    left = left_by(at, fit)
    costs = _costs(at, fit, left, np.stack([np.zeros(twin.time_s.size), np.ones(twin.time_s.size)]))
    parts = Parts.of_groups(twin.starts, likeliest_parts(costs[0] - costs[1], edge_gain))
    if not 2 <= parts.count <= MOST:
        return None
    return at_times(twin, variant, *dated(at, fit, left, parts).times(twin))


def in_the_same_parts(at: Linearisation, scored: Sequence[Scored], like: Variant) -> list[Variant]:
    """All hypotheses in the parts of the time of one variant, strongest first; arguments as of `courses.courses`."""
    sums = Sums(at, best_of_each(scored))
    gains = sums.gains_where(like.schedule > 0.0)
    found = [replace(like, name=item.name, response=like.schedule[:, None] * item.response, gain=float(gain))
             for item, gain in zip(sums.items, gains, strict=True)]  # fmt: skip
    return sorted(found, key=lambda variant: -variant.gain)


def likeliest_parts(gains: Array, edge_gain: float) -> np.ndarray:
    """Whether each window is one in which an effect acts, (W,): the path of the largest sum of gains less its edges'.

    Args:
        gains: (W,) what acting there gains.
        edge_gain: what each edge costs.
    """
    score, came = np.zeros(2), np.zeros((gains.size, 2), dtype=np.int64)
    for w, gain in enumerate(gains):
        turned = score[::-1] - edge_gain
        came[w] = np.where(turned > score, [1, 0], [0, 1])
        score = np.maximum(score, turned) + [0.0, gain]
    path = np.empty(gains.size, dtype=np.int64)
    state = int(np.argmax(score))
    for w in range(gains.size - 1, -1, -1):
        path[w] = state
        state = int(came[w, state])
    return path.astype(bool)


def left_by(at: Linearisation, fit: Fit) -> Array:
    """(n, C) what the simulation of a fit and the most likely errors of maps and sensors leave of the readings."""
    return at.without_nuisances(np.nan_to_num(at.twin.measured - simulate_fits(at.twin, [fit])[0]))


def _costs(at: Linearisation, fit: Fit, left: Array, schedules: Array) -> Array:
    """(B, W) squared whitened residuals of each window with the effect on schedules (B, n) of its own."""
    (name,) = fit.candidate.names
    fits = [fit, *(replace(fit, candidate=Candidate((name,), {name: schedule})) for schedule in schedules)]
    simulated = simulate_fits(at.twin, fits)
    return window_costs(at, left - (simulated[1:] - simulated[0]))


def window_costs(at: Linearisation, left: Array) -> Array:
    """(B, W) squared whitened residuals of readings (B, n, C) without what initial states explain; where a simulation
    ran away, as much as any other. Readings that there aren't have 0."""
    twin = at.twin
    wild = np.array([not np.isfinite(each).all() for each in left])
    rows = at.metric.without_local(np.where(wild[:, None, None], 0.0, left))[:, : twin.measured.size]
    costs = np.add.reduceat(rows**2, twin.starts * twin.measured.shape[1], axis=1)
    costs[wild] = costs.max(axis=0)
    return costs


def dated(at: Linearisation, fit: Fit, left: Array, parts: Parts) -> Parts:
    """The parts with their edges at the samples where they explain most, all at once: coarse, then every sample.

    Args:
        at: the metric's.
        fit: with the effect, whose health, initial states and size stay.
        left: (n, C) what its simulation leaves of the readings.
        parts: as they were found so far, to a window.
    """
    twin, n, edges = at.twin, at.twin.time_s.size, parts.edges
    reach = int(np.diff(np.append(twin.starts, n)).max())
    for _ in range(2 if edges.size else 0):
        gaps = np.diff(np.concatenate([[0], edges, [n]]))
        low = -np.minimum(reach, (gaps[:-1] - 1) // 2)
        high = np.minimum(reach, (gaps[1:] - 1) // 2)
        shares = np.linspace(0.0, 1.0, _EDGES)
        tried = np.rint(edges + low + shares[:, None] * (high - low)).astype(np.int64)  # (T, E)
        costs = _costs(at, fit, left, np.stack([Parts(each, parts.begins).acts(n) for each in tried]))
        bounds = np.searchsorted(twin.starts, np.stack([edges + low, edges + high]), side="right") - 1
        best = [int(np.argmin(costs[:, a : b + 1].sum(axis=1))) for a, b in bounds.T]
        edges = tried[best, np.arange(edges.size)]
        reach = max(2 * reach // (_EDGES - 1), _EDGES // 2)
    return Parts(edges, parts.begins)
