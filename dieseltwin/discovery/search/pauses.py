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
from dieseltwin.discovery.search.courses import at_times
from dieseltwin.discovery.search.variants import SECOND_EDGE, Sums, Variant
from dieseltwin.discovery.twins.interface import Array, Twin
from dieseltwin.engine.courses import Spans

_MOST = 12  # spans: what comes and goes oftener follows the driving, and a region or a law says so better
_EDGES = 21  # samples that are tried for an edge, twice


def in_parts(at: Linearisation, variant: Variant, fit: Fit) -> Variant | None:
    """The same effect in two or more parts of the time, None where one part explains as much.

    Args:
        at: the health-only fit, in whose metric windows are compared.
        variant: the effect, as it was found so far.
        fit: its refit: health, initial states and the effect's size stay.
    """
    twin = at.twin
    edges = np.append(twin.starts, twin.time_s.size)
    left = _left(at, fit)
    costs = _costs(at, fit, left, np.stack([np.zeros(twin.time_s.size), np.ones(twin.time_s.size)]))
    acts = likeliest_parts(costs[0] - costs[1], SECOND_EDGE)
    turns = np.flatnonzero(np.diff(acts.astype(np.int64))) + 1
    parts = int(acts[0]) + int((np.diff(acts.astype(np.int64)) == 1).sum())
    if not 2 <= parts <= _MOST:
        return None
    return _at(twin, variant, _dated(at, fit, left, edges[turns], bool(acts[0])), bool(acts[0]))


def in_the_same_parts(at: Linearisation, scored: Sequence[Scored], like: Variant) -> list[Variant]:
    """All hypotheses in the parts of the time of one variant, strongest first; arguments as of `courses.courses`."""
    sums = Sums(at, best_of_each(scored))
    group = sums.per_row(np.where(like.schedule > 0.0, 0, -1))
    gains = sums.gains(*(part[0] for part in sums.of(group, 1)))
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


def _left(at: Linearisation, fit: Fit) -> Array:
    """(n, C) what the simulation of a fit and the most likely errors of maps and sensors leave of the readings."""
    left = np.nan_to_num(at.twin.measured - simulate_fits(at.twin, [fit])[0])
    if at.nuisance_response is not None:
        left = left - np.tensordot(at.metric.nuisance_estimate(left), at.nuisance_response, 1)
    return left


def _costs(at: Linearisation, fit: Fit, left: Array, schedules: Array) -> Array:
    """(B, W) squared whitened residuals of each window with the effect on schedules (B, n) of its own."""
    twin, (name,) = at.twin, fit.candidate.names
    fits = [fit, *(replace(fit, candidate=Candidate((name,), {name: schedule})) for schedule in schedules)]
    simulated = simulate_fits(twin, fits)
    rows = at.metric.without_local(np.nan_to_num(left - (simulated[1:] - simulated[0])))[:, : twin.measured.size]
    return np.add.reduceat(rows**2, twin.starts * twin.measured.shape[1], axis=1)


def _schedule(n: int, edges: np.ndarray, begins: bool) -> Array:
    """(n,) 1 in parts that the edges bound, from the first row on where `begins`."""
    return np.asarray((np.searchsorted(edges, np.arange(n), side="right") + begins) % 2, dtype=np.float64)


def _dated(at: Linearisation, fit: Fit, left: Array, edges: np.ndarray, begins: bool) -> np.ndarray:
    """The edges at the samples where they explain most, all of them at once: coarse, then every sample."""
    twin, n = at.twin, at.twin.time_s.size
    reach = int(np.diff(np.append(twin.starts, n)).max())
    for _ in range(2):
        gaps = np.diff(np.concatenate([[0], edges, [n]]))
        low = -np.minimum(reach, (gaps[:-1] - 1) // 2)
        high = np.minimum(reach, (gaps[1:] - 1) // 2)
        shares = np.linspace(0.0, 1.0, _EDGES)
        tried = np.rint(edges + low + shares[:, None] * (high - low)).astype(np.int64)  # (T, E)
        costs = _costs(at, fit, left, np.stack([_schedule(n, each, begins) for each in tried]))
        bounds = np.searchsorted(twin.starts, np.stack([edges + low, edges + high]), side="right") - 1
        best = [int(np.argmin(costs[:, a : b + 1].sum(axis=1))) for a, b in bounds.T]
        edges = tried[best, np.arange(edges.size)]
        reach = max(2 * reach // (_EDGES - 1), _EDGES // 2)
    return edges


def _at(twin: Twin, variant: Variant, edges: np.ndarray, begins: bool) -> Variant:
    times = [float(t) for t in twin.time_s[edges]]
    if begins:
        times.insert(0, float(twin.time_s[0]))
    onset, until = times[0], times[-1] if len(times) % 2 == 0 else None
    inner = times[1:] if until is None else times[1:-1]
    gone: Spans = tuple(zip(inner[::2], inner[1::2], strict=True))
    return at_times(twin, variant, onset, until, False, gone)
