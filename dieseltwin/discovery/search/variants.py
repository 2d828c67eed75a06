"""Effects that begin in the middle of a recording, act in a part of the operating range only, or differ by recording.

Every beginning, every range of every condition and every profile over recordings is tried for every effect, by sums
over windows, over bins of a condition and over recordings: masked responses needn't be projected one by one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, simulate_fits
from dieseltwin.discovery.likelihood.score import (
    Scored,
    best_of_each,
    effect_responses,
    score,
    ways_of_each,
    without_parameters,
)
from dieseltwin.discovery.search.sums import LEAST_SHARE, Sums, gain_of, gains_since
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.engine.courses import Spans

_BINS = 20  # of a condition, with equal numbers of samples
SECOND_EDGE = 8.0  # gain that a second edge along one condition must add
_SECOND_CONDITION = 12.0  # gain that a second condition of a region must add
_REFINED = 6  # of the leading effects have their regions' edges found in turn, until none moves
_TURNS = 3
_COARSE = (0.0, 0.04, 0.12, 0.3, 0.5, 0.7, 0.88, 0.96, 1.0)  # shares of the samples between slabs that are simulated

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
        edges: of the region, inside the range driven, or in time.
        profile: way in which its size differs between recordings, or None.
        until_s: before when [s], or None for to the end; see `courses`.
        grows: evenly, from nothing at the onset to its whole size at the end.
        gone: spans in between in which it is gone [s]; see `pauses`.
    """

    name: str
    onset_s: float | None
    region: Region | None
    schedule: Array
    response: Array
    gain: float
    edges: int = 0
    profile: str | None = None
    until_s: float | None = None
    grows: bool = False
    gone: Spans = ()


def scan(
    at: Linearisation, scored: Sequence[Scored], count: int, least_share: float = LEAST_SHARE
) -> list[Variant]:
    """The strongest variants of all hypotheses, at most two of each effect; each acts on `least_share` of the samples.
    And half as many that differ between recordings, where there are several.

    The response of a part is taken as that part of the response: exact for an onset at a window's start (windows start
    anew), nearly so for a region (pressures follow within a second). Refits simulate it in full.
    """
    items = ways_of_each(scored)
    if not items:
        return []
    sums = Sums(at, items, least_share)
    found = [*_onsets(sums), *_regions(sums)]
    found.sort(key=lambda v: -v.gain)
    kept: list[Variant] = []
    for variant in found:
        if sum(v.name == variant.name for v in kept) < 2:
            kept.append(variant)
    by_recording = sorted(_profiled(sums), key=lambda v: -v.gain)
    return sorted([*kept[:count], *by_recording[: count // 2]], key=lambda v: -v.gain)


def _variant(
    twin: Twin, item: Scored, onset: float | None, region: Region | None, acts: np.ndarray, gain: float
) -> Variant:
    schedule = acts.astype(np.float64) if region is None else _schedule(acts)
    edges = _inner_edges(twin, region or {})
    return Variant(item.name, onset, region, schedule, schedule[:, None] * item.response, float(gain), edges)


def _inner_edges(twin: Twin, region: Region) -> int:
    """Edges of a region that lie inside the range driven."""
    ranges = ((twin.conditions[name], low, high) for name, (low, high) in region.items())
    return sum(int(low > values.min()) + int(high < values.max()) for values, low, high in ranges)


def _schedule(acts: np.ndarray) -> Array:
    """Factor over the interval behind each sample: half where conditions cross an edge between two samples."""
    schedule = acts.astype(np.float64)
    schedule[:-1] = 0.5 * (schedule[:-1] + schedule[1:])
    return schedule


def _onsets(sums: Sums) -> list[Variant]:
    twin, gains = sums.at.twin, gains_since(sums)
    best = gains.argmax(axis=0)
    found = []
    for h, w in enumerate(best):
        since, acts = float(twin.time_s[twin.starts[w]]), np.arange(twin.time_s.size) >= twin.starts[w]
        found.append(_variant(twin, sums.items[h], since, None, acts, gains[w, h]))
    return found


def _bins(values: Array) -> tuple[np.ndarray, Array]:
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)))
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2), edges


def _intervals(sums: Sums, values: Array, inside: np.ndarray) -> list[tuple[float, float, float]]:
    """(gain, low, high) of each hypothesis' best range of one condition within what is inside.

    A range with two edges pays for the second.
    """
    of_sample, edges = _bins(values)
    count = len(edges) - 1
    if count < 2:
        return []
    parts = sums.of(sums.per_row(np.where(inside, of_sample, -1)), count)
    totals = [np.concatenate([np.zeros((1, *part.shape[1:])), np.cumsum(part, axis=0)]) for part in parts]
    sizes = np.concatenate([[0], np.cumsum(np.bincount(of_sample[inside], minlength=count))])
    least = sums.least_share * values.size
    pairs = [
        (a, b)
        for a in range(count)
        for b in range(a + 1, count + 1)
        if b - a < count and least < sizes[b] - sizes[a] < values.size - least
    ]
    if not pairs:
        return []
    low, high = (np.array(side) for side in zip(*pairs, strict=True))
    gains = sums.gains(*(total[high] - total[low] for total in totals))
    gains -= SECOND_EDGE * ((low > 0) & (high < count))[:, None]
    best = gains.argmax(axis=0)
    return [(float(gains[p, h]), *_open_ended(edges, low[p], high[p])) for h, p in enumerate(best)]


def inside_region(conditions: Mapping[str, Array], region: Region) -> np.ndarray:
    """(n,) whether each sample lies in a region."""
    acts = np.ones(len(next(iter(conditions.values()))), dtype=bool)
    for name, (low, high) in region.items():
        acts &= (conditions[name] >= low) & (conditions[name] <= high)
    return acts


def _regions(sums: Sums) -> list[Variant]:
    """Best region of each hypothesis over one condition, or over two where the second adds enough."""
    conditions: Mapping[str, Array] = sums.at.twin.conditions
    everywhere = np.ones(sums.at.twin.time_s.size, dtype=bool)
    best: dict[int, tuple[float, Region]] = {}
    for name, values in conditions.items():
        for h, (gain, low, high) in enumerate(_intervals(sums, values, everywhere)):
            if h not in best or gain > best[h][0]:
                best[h] = (gain, {name: (low, high)})
    for h in sorted(best, key=lambda h: -best[h][0])[:_REFINED]:
        best[h] = _refined(sums, h, *best[h])
    return [
        _variant(sums.at.twin, sums.items[h], None, region, inside_region(conditions, region), gain)
        for h, (gain, region) in best.items()
    ]


def _refined(sums: Sums, h: int, gain: float, region: Region) -> tuple[float, Region]:
    """Every condition's range anew given the other's, and a second condition where it adds enough."""
    conditions = sums.at.twin.conditions
    alone = sums.only(h)
    for _ in range(_TURNS):
        before = gain
        for name in region if len(region) > 1 else ():
            rest = {other: box for other, box in region.items() if other != name}
            for found, low, high in _intervals(alone, conditions[name], inside_region(conditions, rest)):
                if found > gain:
                    gain, region = found, {**region, name: (low, high)}
        if len(region) == 1:
            first, acts = region, inside_region(conditions, region)
            needed = gain + _SECOND_CONDITION
            for name, values in conditions.items():
                for found, low, high in _intervals(alone, values, acts) if name not in first else ():
                    if found > max(needed, gain):
                        gain, region = found, {**first, name: (low, high)}
        if gain < before + 1.0:
            break
    return gain, region


def _profiled(sums: Sums) -> list[Variant]:
    """Best profile over recordings of each hypothesis; none on one recording."""
    twin = sums.at.twin
    if not isinstance(twin, OverRecordings) or not twin.profiles:
        return []
    names = list(twin.profiles)
    levels, of_sample = np.unique(np.stack([twin.profiles[name] for name in names]), axis=1, return_inverse=True)
    squares, pushes, inner = sums.of(sums.per_row(of_sample.reshape(-1)), levels.shape[1])
    gains = sums.gains(levels**2 @ squares, levels @ pushes, np.einsum("pg,gkh->pkh", levels, inner))
    found = []
    for h, best in enumerate(gains.argmax(axis=0)):
        item, schedule = sums.items[h], twin.profiles[names[best]]
        response = schedule[:, None] * item.response
        found.append(Variant(item.name, None, None, schedule, response, float(gains[best, h]), 0, names[best]))
    return found


def redated(at: Linearisation, name: str, size: float, least_share: float) -> Variant:
    """The best onset of an effect by its response at a size that a refit found [unit]; windows start anew, so exact."""
    wanted = [(name, size)]
    return _onsets(Sums(at, score(at, wanted, effect_responses(at.twin, at, wanted)), least_share))[0]


def same_region(at: Linearisation, scored: Sequence[Scored], like: Variant) -> list[Variant]:
    """All hypotheses in the region, or with the profile over recordings, of one variant, strongest first."""
    if like.profile is not None:
        return sorted(
            (v for v in _profiled(Sums(at, best_of_each(scored))) if v.profile == like.profile), key=lambda v: -v.gain
        )
    if like.region is None:
        return []
    sums = Sums(at, best_of_each(scored))
    acts = inside_region(at.twin.conditions, like.region)
    gains = sums.gains_where(acts)
    found = [_variant(at.twin, sums.items[h], None, like.region, acts, gain) for h, gain in enumerate(gains)]
    return sorted(found, key=lambda v: -v.gain)


def rescan(null: Linearisation, variant: Variant, fit: Fit, fine: float) -> Variant:
    """The best ranges of a variant's region about its own refit, each condition given the other.

    What acts on the turbo's speed acts for seconds, so its response to a region isn't that part of its response to
    everywhere, and `scan` blurs the edges. Here every slab of a condition is simulated by itself. `fine`: share of the
    samples to either side of an edge that is known already.
    """
    twin = null.twin
    magnitude = float(fit.magnitudes[0])
    if variant.region is None or magnitude == 0.0:
        return variant
    region, gain = dict(variant.region), variant.gain
    at = Linearisation(twin, null.whitening, replace(fit, candidate=Candidate(), magnitudes=np.zeros(0)), null)
    for name in variant.region:
        rest = inside_region(twin.conditions, {other: box for other, box in region.items() if other != name})
        values = twin.conditions[name]
        edges = _slab_edges(values, region[name], fine)
        of_sample = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        slabs = [(of_sample == g) & rest for g in range(len(edges) - 1)]
        trials = [replace(fit, candidate=Candidate((variant.name,), {variant.name: _schedule(acts)})) for acts in slabs]
        responses = (simulate_fits(twin, trials) - at.simulated) / magnitude
        vectors = without_parameters(at, at.metric.project(responses))
        gram, push = vectors @ vectors.T, vectors @ at.pulled_residual
        low, high = twin.hypotheses[variant.name].limits
        best = -np.inf
        for a in range(len(slabs)):
            for b in range(a + 1, len(slabs) + 1):
                information = float(gram[a:b, a:b].sum())
                if information <= 0.0:
                    continue
                pushed = float(push[a:b].sum())
                value = float(gain_of(pushed, information, low, high)) - SECOND_EDGE * ((a > 0) + (b < len(slabs)))
                if value > best:
                    best, region[name] = value, _open_ended(edges, a, b)
        gain = best
    acts = inside_region(twin.conditions, region)
    # its response stays that of the region before: refits near a fit take the fit's own
    return replace(variant, region=region, schedule=_schedule(acts), gain=gain, edges=_inner_edges(twin, region))


def _slab_edges(values: Array, box: tuple[float, float], fine: float) -> Array:
    """Edges of slabs of a condition: coarse ones, and fine ones about the range known so far."""
    ordered = np.sort(values)
    shares = [*_COARSE]
    for edge in box:
        place = float(np.searchsorted(ordered, edge)) / values.size
        if 0.0 < place < 1.0:
            shares = [s for s in shares if abs(s - place) > 1.5 * fine or s in (0.0, 1.0)]
            shares += [place - fine, place, place + fine]
    return np.unique(np.quantile(values, np.clip(np.sort(shares), 0.0, 1.0)))


def _open_ended(edges: Array, a: int, b: int) -> tuple[float, float]:
    """A range from edge `a` to edge `b`. An end of the range driven is no edge: such a range goes on far beyond."""
    span = edges[-1] - edges[0]
    low = edges[0] - span if a == 0 else edges[a]
    high = edges[-1] + span if b == len(edges) - 1 else edges[b]
    return float(low), float(high)


def edge_cost(variant: Variant) -> float:
    """What the edges of a region or in time cost, beyond the first [units of gain]."""
    return SECOND_EDGE * max(variant.edges - 1, 0)
