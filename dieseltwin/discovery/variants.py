"""Effects that begin in the middle of a recording or act in a part of the operating range only.

Every beginning and every range of every condition is tried for every effect, by sums over windows and over bins of a
condition: masked responses needn't be projected one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from dieseltwin.discovery.fit import Linearisation
from dieseltwin.discovery.score import Scored, best_of_each
from dieseltwin.discovery.twin import Array, Twin

_BINS = 10  # of a condition, with equal numbers of samples
_LEAST_SHARE = 0.08  # of the samples that a variant must act on, and leave out
_SECOND_CONDITION = 12.0  # gain that a second condition of a region must add

Region = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Variant:
    """A hypothesis that acts at some times only.

    Attributes:
        name: of the effect.
        onset_s: since when [s], or None.
        region: condition -> (low, high) in which it acts, or None.
        schedule: (n,) 1 where it acts, else 0.
        response: (n, C) linear response per unit of magnitude.
        gain: linear gain.
    """

    name: str
    onset_s: float | None
    region: Region | None
    schedule: Array
    response: Array
    gain: float


class _Sums:
    """Information and push of masked responses, by sums over groups of rows."""

    def __init__(self, at: Linearisation, items: Sequence[Scored]) -> None:
        metric = at.metric
        self.at, self.items = at, items
        self.vectors = metric.without_local(np.stack([item.response for item in items]))  # (H, rows)
        self.rows = self.vectors.shape[1]
        self.residual = metric.without_local(np.nan_to_num(at.residual)[None])[0]
        information = at.projected @ at.projected.T + np.diag(at.precision)
        parameters = solve_triangular(cholesky(information, lower=True), at.projected, lower=True)
        bases = [parameters[:, : self.rows]]
        if metric.nuisance_basis is not None:
            bases.append(metric.nuisance_basis[:, : self.rows])
        self.basis = np.vstack(bases)  # (K, rows): tolerances and parameters
        self.known = self.basis @ self.residual
        limits = np.array([at.twin.hypotheses[item.name].limits for item in items])
        self.low, self.high = limits[:, 0], limits[:, 1]

    def of(self, group: np.ndarray, count: int) -> tuple[Array, Array, Array]:
        """Squares (G, H), pushes (G, H) and inner products with the basis (G, K, H) of each group of rows.

        group: (rows,) number of each row's group, -1 for rows that never act.
        """
        shape = (count, len(self.items))
        squares, pushes = np.zeros(shape), np.zeros(shape)
        inner = np.zeros((count, self.basis.shape[0], len(self.items)))
        order = np.argsort(group, kind="stable")
        edges = np.searchsorted(group[order], np.arange(count + 1))
        for g in range(count):
            at = order[edges[g] : edges[g + 1]]
            part = self.vectors[:, at]
            squares[g] = np.einsum("hr,hr->h", part, part)
            pushes[g] = part @ self.residual[at]
            inner[g] = self.basis[:, at] @ part.T
        return squares, pushes, inner

    def gains(self, squares: Array, pushes: Array, inner: Array) -> Array:
        """Gains (..., H) of sums over groups."""
        information = np.maximum(squares - (inner**2).sum(axis=-2), 1e-9 * np.maximum(squares, 1e-300))
        push = pushes - np.einsum("...kh,k->...h", inner, self.known)
        estimate = np.clip(push / information, self.low, self.high)
        gains = estimate * (2.0 * push - estimate * information)
        return np.where(information > 1e-4 * squares, gains, 0.0)

    def per_row(self, of_sample: np.ndarray) -> np.ndarray:
        """(n,) group of each sample -> (rows,) group of each row; rows of priors belong to none."""
        channels = self.at.residual.shape[1]
        group = np.full(self.rows, -1, dtype=np.int64)
        group[: of_sample.size * channels] = np.repeat(of_sample, channels)
        return group


def scan(at: Linearisation, scored: Sequence[Scored], count: int) -> list[Variant]:
    """The strongest variants of all hypotheses, at most two of each effect.

    The response of a part is taken as that part of the response: exact for an onset at a window's start (windows start
    anew), nearly so for a region (pressures follow within a second). Refits simulate it in full.
    """
    items = best_of_each(scored)
    if not items:
        return []
    sums = _Sums(at, items)
    found = [*_onsets(sums), *_regions(sums)]
    found.sort(key=lambda v: -v.gain)
    kept: list[Variant] = []
    for variant in found:
        if sum(v.name == variant.name for v in kept) < 2:
            kept.append(variant)
    return kept[:count]


def _variant(sums: _Sums, h: int, onset: float | None, region: Region | None, acts: np.ndarray, gain: float) -> Variant:
    schedule = acts.astype(np.float64)
    if region is not None:  # conditions cross an edge between two samples
        schedule[:-1] = 0.5 * (schedule[:-1] + schedule[1:])
    item = sums.items[h]
    return Variant(item.name, onset, region, schedule, schedule[:, None] * item.response, float(gain))


def _onsets(sums: _Sums) -> list[Variant]:
    twin = sums.at.twin
    n, W = twin.time_s.size, twin.starts.size
    of_sample = np.searchsorted(twin.starts, np.arange(n), side="right") - 1
    squares, pushes, inner = (np.cumsum(part[::-1], axis=0)[::-1] for part in sums.of(sums.per_row(of_sample), W))
    gains = sums.gains(squares, pushes, inner)
    allowed = (twin.starts > _LEAST_SHARE * n) & (twin.starts < (1.0 - _LEAST_SHARE) * n)
    gains[~allowed] = 0.0
    best = gains.argmax(axis=0)
    return [
        _variant(sums, h, float(twin.time_s[twin.starts[w]]), None, np.arange(n) >= twin.starts[w], gains[w, h])
        for h, w in enumerate(best)
    ]


def _bins(values: Array) -> tuple[np.ndarray, Array]:
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2), edges


def _intervals(sums: _Sums, values: Array, inside: np.ndarray) -> list[tuple[float, int, float, float]]:
    """(gain, hypothesis, low, high) of each hypothesis' best range of one condition within what is inside."""
    of_sample, edges = _bins(values)
    count = len(edges) - 1
    if count < 2:
        return []
    parts = sums.of(sums.per_row(np.where(inside, of_sample, -1)), count)
    totals = [np.concatenate([np.zeros((1, *part.shape[1:])), np.cumsum(part, axis=0)]) for part in parts]
    sizes = np.concatenate([[0], np.cumsum(np.bincount(of_sample[inside], minlength=count))])
    least = _LEAST_SHARE * values.size
    pairs = [
        (a, b)
        for a in range(count)
        for b in range(a + 1, count + 1)
        if (a == 0 or b == count) and least < sizes[b] - sizes[a] < values.size - least
    ]
    if not pairs:
        return []
    low, high = (np.array(side) for side in zip(*pairs, strict=True))
    gains = sums.gains(*(total[high] - total[low] for total in totals))
    best = gains.argmax(axis=0)
    return [
        (float(gains[p, h]), h, float(edges[pairs[p][0]]), float(edges[pairs[p][1]])) for h, p in enumerate(best)
    ]


def _regions(sums: _Sums) -> list[Variant]:
    """Best region of each hypothesis over one condition, or over two where the second adds enough."""
    conditions: Mapping[str, Array] = sums.at.twin.conditions
    everywhere = np.ones(sums.at.twin.time_s.size, dtype=bool)
    best: dict[int, tuple[float, Region, np.ndarray]] = {}
    for name, values in conditions.items():
        for gain, h, low, high in _intervals(sums, values, everywhere):
            if h not in best or gain > best[h][0]:
                best[h] = (gain, {name: (low, high)}, (values >= low) & (values <= high))
    leading = sorted(best, key=lambda h: -best[h][0])[:4]
    for h in leading:
        first_gain, region, acts = best[h]
        for name, values in conditions.items():
            if name in region:
                continue
            for gain, other, low, high in _intervals(sums, values, acts):
                if other == h and gain > best[h][0] and gain > first_gain + _SECOND_CONDITION:
                    best[h] = (gain, {**region, name: (low, high)}, acts & (values >= low) & (values <= high))
    return [_variant(sums, h, None, region, acts, gain) for h, (gain, region, acts) in best.items()]


def onset_candidates(twin: Twin, around_s: float, reach_s: float, count: int) -> list[float]:
    """Times about a first estimate, at samples, `count` of them [s]."""
    times = np.linspace(around_s - reach_s, around_s + reach_s, count)
    inner = times[(times > twin.time_s[2]) & (times < twin.time_s[-3])]
    return sorted({float(twin.time_s[np.searchsorted(twin.time_s, t)]) for t in inner})
