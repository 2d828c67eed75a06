"""Effects that come and go again, or that grow evenly from a moment on, where the twin says that its effects may.

A second edge has to pay for itself as that of a region does; an effect that grows has as many freedoms as one that
begins. An edge is exact to a window, a response in part of the time is that part of the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.score import Scored, best_of_each, ways_of_each
from dieseltwin.discovery.search.sums import Sums
from dieseltwin.discovery.search.variants import SECOND_EDGE, Variant
from dieseltwin.discovery.twins.interface import Array, Twin, WithCourses
from dieseltwin.discovery.twins.windows import window_of_rows
from dieseltwin.engine.courses import Spans, course

_EDGES = 48  # that both ends of a span are looked for among; refits move them
_GROWING_SHARE = 0.25  # of the recording that an effect must grow over: what grows faster is a step
_COUNT = 4  # of the strongest are refitted
_CHANGES = 12  # of the parts of an effect that comes and goes, from its best span on
MOST = 12  # spans: what comes and goes oftener follows the driving, and a region or a law says so better


@dataclass(frozen=True)
class Parts:
    """Parts of a recording's rows.

    Attributes:
        edges: (E,) rows at which one begins or ends, in order.
        begins: whether the first begins with the recording.
    """

    edges: np.ndarray
    begins: bool

    @classmethod
    def of_groups(cls, firsts: np.ndarray, acts: np.ndarray) -> Parts:
        """Of groups of rows that begin at `firsts` (G,) or end there (G + 1,), by whether each (G,) belongs to them."""
        return cls(firsts[1 : acts.size][acts[1:] != acts[:-1]], bool(acts[0]))

    @property
    def count(self) -> int:
        """How many they are."""
        return (self.edges.size + 1 + self.begins) // 2

    def acts(self, n: int) -> Array:
        """(n,) 1 in them, else 0."""
        return np.asarray((np.searchsorted(self.edges, np.arange(n), side="right") + self.begins) % 2, dtype=np.float64)

    def times(self, twin: Twin) -> tuple[float, float | None, bool, Spans]:
        """Onset, end, that nothing grows, and the spans in between in which nothing acts, as `courses.at_times`."""
        times = [float(t) for t in twin.time_s[self.edges]]
        if self.begins:
            times.insert(0, float(twin.time_s[0]))
        until = None if len(times) % 2 else times[-1]
        inner = times[1:] if until is None else times[1:-1]
        return times[0], until, False, tuple(zip(inner[::2], inner[1::2], strict=True))


def courses(at: Linearisation, scored: Sequence[Scored], least_share: float) -> list[Variant]:
    """The strongest effects that come and go or that grow, none where the twin's effects don't.

    Args:
        at: the health-only fit.
        scored: effects with their responses.
        least_share: of the samples that a span must act on, and leave out.
    """
    items = ways_of_each(scored)
    if not items or not _has_courses(at.twin):
        return []
    sums = Sums(at, items, least_share)
    return sorted([*_spans(sums), *_growing(sums)], key=lambda v: -v.gain)[:_COUNT]


def coming_and_going(at: Linearisation, scored: Sequence[Scored], least_share: float) -> list[Variant]:
    """The strongest effects in two or more spans, where the twin's may have them; arguments as of `courses`."""
    items = best_of_each(scored)
    if not items or not has_parts(at.twin):
        return []
    return sorted(_in_spans(Sums(at, items, least_share)), key=lambda v: -v.gain)[:_COUNT]


def _has_courses(twin: Twin) -> bool:
    return isinstance(twin, WithCourses) and twin.courses


def has_parts(twin: Twin) -> bool:
    """Whether the twin's effects may come and go more than once.

    Balances without states have two faults since two times as one that does, and name a third for both.
    """
    return _has_courses(twin) and bool(twin.states)


def schedule_of(twin: Twin, onset_s: float, until_s: float | None, grows: bool, gone: Spans = ()) -> Array:
    """(n,) factor of an effect's size; what grows does so through gaps too, and has its whole size at the end."""
    if not grows:
        return course(twin.time_s, onset_s, until_s, gone_s=gone)
    time_s = twin.recording_time_s
    return course(time_s, float(time_s[np.searchsorted(twin.time_s, onset_s)]), None, float(time_s[-1]))


def at_times(
    twin: Twin, variant: Variant, onset_s: float, until_s: float | None, grows: bool, gone: Spans = ()
) -> Variant:
    """A variant with another course. Its response stays that of before."""
    return replace(variant, onset_s=onset_s, until_s=until_s, grows=grows, gone=gone, edges=_edges(until_s, gone),
                   schedule=schedule_of(twin, onset_s, until_s, grows, gone))  # fmt: skip


def _edges(until_s: float | None, gone: Spans) -> int:
    """How many edges a course pays for: an onset by itself pays as such."""
    return (0 if until_s is None else 2) + 2 * len(gone)


def moved(twin: Twin, variant: Variant, onsets: Sequence[float], ends: Sequence[float]) -> list[Variant]:
    """A variant with other edges, one moved at a time; what is there from the first sample on stays so.

    Args:
        twin: of it.
        variant: with an onset.
        onsets, ends: candidates of either edge [s].
    """
    onset, until, grows = float(variant.onset_s or 0.0), variant.until_s, variant.grows
    first, last = (variant.gone[0][0], variant.gone[-1][1]) if variant.gone else (until, onset)
    later = [t for t in onsets if (first is None or t < first) and onset > twin.time_s[0]]
    found = [at_times(twin, variant, t, until, grows, variant.gone) for t in later]
    return [*found, *(at_times(twin, variant, onset, t, grows, variant.gone) for t in ends if t > last)]


def first_of_each_course(variants: Sequence[Variant]) -> list[Variant]:
    """The first of those that begin, of those that go again, that grow and that come and go: a large effect that begins
    two seconds off may be behind one that grows, until its edge is exact."""
    found: dict[tuple[bool, bool, bool], Variant] = {}
    for variant in variants:
        if variant.onset_s is not None:
            found.setdefault((variant.until_s is not None, variant.grows, bool(variant.gone)), variant)
    return list(found.values())


def _variant(
    sums: Sums, h: int, gain: float, onset_s: float, until_s: float | None, grows: bool, gone: Spans = ()
) -> Variant:
    item, twin = sums.items[h], sums.at.twin
    schedule, edges = schedule_of(twin, onset_s, until_s, grows, gone), _edges(until_s, gone)
    response = schedule[:, None] * item.response
    return Variant(item.name, onset_s, None, schedule, response, gain, edges, None, until_s, grows, gone)


def _grouped(sums: Sums) -> tuple[tuple[Array, Array, Array], np.ndarray]:
    """Sums over groups of windows as of `Sums.of`, and the rows at which those begin and the last one ends (G + 1,)."""
    twin = sums.at.twin
    n, windows = twin.time_s.size, twin.starts.size
    edges = np.unique(np.linspace(0, windows, min(windows, _EDGES) + 1).astype(np.int64))
    firsts = np.append(twin.starts, n)[edges]
    of_sample = np.searchsorted(firsts, np.arange(n), side="right") - 1
    return sums.of(sums.per_row(of_sample), len(edges) - 1), firsts


def _best_spans(sums: Sums, parts: Sequence[Array], firsts: np.ndarray) -> dict[int, tuple[float, int, int]]:
    """Each effect's place -> gain, first group and the one behind the last of its best span that ends within the
    recording; arguments as `_grouped` gives them."""
    n = sums.at.twin.time_s.size
    totals = [np.concatenate([np.zeros((1, *part.shape[1:])), np.cumsum(part, axis=0)]) for part in parts]
    best: dict[int, tuple[float, int, int]] = {}
    for a in range(len(firsts) - 2):
        ends = np.arange(a + 1, len(firsts) - 1)
        sizes = firsts[ends] - firsts[a]
        ends = ends[(sizes > sums.least_share * n) & (sizes < (1.0 - sums.least_share) * n)]
        if not ends.size:
            continue
        gains = sums.gains(*(total[ends] - total[a] for total in totals)) - SECOND_EDGE
        for h, k in enumerate(gains.argmax(axis=0)):
            if h not in best or gains[k, h] > best[h][0]:
                best[h] = (float(gains[k, h]), a, int(ends[k]))
    return best


def _spans(sums: Sums) -> list[Variant]:
    """The best span of each effect that ends within the recording."""
    parts, firsts = _grouped(sums)
    times = sums.at.twin.time_s
    return [_variant(sums, h, gain, float(times[firsts[a]]), float(times[firsts[b]]), False)
            for h, (gain, a, b) in _best_spans(sums, parts, firsts).items()]


def _in_spans(sums: Sums) -> list[Variant]:
    """Two or more spans of each effect: from its best one on, the interval whose change from there to gone, or back,
    gains most, again and again. What is left between two spans of an effect health has taken up in part, so that no
    span alone shows it."""
    parts, firsts = _grouped(sums)
    groups = len(firsts) - 1
    acts = np.zeros((groups, len(sums.items)), dtype=bool)
    reached = np.zeros(len(sums.items))
    for h, (gain, a, b) in _best_spans(sums, parts, firsts).items():
        acts[a:b, h], reached[h] = True, gain
    low, high = np.array([(a, b) for a in range(groups) for b in range(a + 1, groups + 1)]).T
    inner = np.array([0.0, *np.ones(groups - 1), 0.0])[:, None]  # the recording's ends are no edges
    for _ in range(_CHANGES):
        there, changed = zip(*(_there_and_changed(part, acts) for part in parts), strict=True)
        gains = sums.gains(*(whole + turn[high] - turn[low] for whole, turn in zip(there, changed, strict=True)))
        edge = np.pad(acts[1:] != acts[:-1], ((1, 1), (0, 0)))
        turned = inner * np.where(edge, -1.0, 1.0)  # edges more where an interval begins or ends
        gains -= SECOND_EDGE * np.maximum(edge.sum(axis=0) + turned[low] + turned[high] - 1.0, 0.0)
        choice = gains.argmax(axis=0)
        better = gains[choice, np.arange(choice.size)] > reached + 1.0
        if not better.any():
            break
        for h in map(int, np.flatnonzero(better)):
            acts[low[choice[h]] : high[choice[h]], h] ^= True
            reached[h] = gains[choice[h], h]
    spans = [Parts.of_groups(firsts, acts[:, h]) for h in range(acts.shape[1])]
    return [_variant(sums, h, float(reached[h]), *each.times(sums.at.twin))
            for h, each in enumerate(spans) if 2 <= each.count <= MOST]


def _there_and_changed(part: Array, acts: np.ndarray) -> tuple[Array, Array]:
    """The sum (..., H) of what acts, and by how much it changes with all groups before each edge turned, (G + 1, ...).

    Args:
        part: (G, ..., H) of `Sums.of`.
        acts: (G, H) whether each effect acts in each group.
    """
    acts = acts.reshape(acts.shape[0], *(1,) * (part.ndim - 2), acts.shape[1])
    changed = np.cumsum(np.where(acts, -part, part), axis=0)
    return np.where(acts, part, 0.0).sum(axis=0), np.concatenate([np.zeros((1, *part.shape[1:])), changed])


def _growing(sums: Sums) -> list[Variant]:
    """The best beginning of each effect that grows: of t - t0 after t0, by sums over 1, t and t squared.

    Sums of squares with a weight of t are those of responses times its root.
    """
    twin = sums.at.twin
    n, windows = twin.time_s.size, twin.starts.size
    group = sums.per_row(window_of_rows(twin.starts, n))
    time_s = twin.recording_time_s - twin.recording_time_s[0]
    of_row = np.zeros(sums.rows)
    channels = sums.at.residual.shape[1]
    of_row[: n * channels] = np.repeat(time_s, channels)
    plain, half, whole = (_since_each(sums, of_row**power, group, windows) for power in (0.0, 0.5, 1.0))
    since = time_s[twin.starts]
    t, t3 = since[:, None], since[:, None, None]
    squares = whole[0] - 2.0 * t * half[0] + t**2 * plain[0]
    pushes = whole[1] - t * plain[1]
    inner = whole[2] - t3 * plain[2]
    span = np.maximum(time_s[-1] - since, 1.0)  # the size is that at the end
    gains = sums.gains(squares / span[:, None] ** 2, pushes / span[:, None], inner / span[:, None, None])
    gains[span < _GROWING_SHARE * time_s[-1]] = 0.0
    best = gains.argmax(axis=0)
    return [_variant(sums, h, float(gains[w, h]), float(twin.time_s[twin.starts[w]]), None, True)
            for h, w in enumerate(best)]


def _since_each(sums: Sums, weight: Array, group: np.ndarray, windows: int) -> list[Array]:
    """Squares, pushes and inner products of weighted responses (rows,), over all rows since each window's start."""
    weighted = copy(sums)
    weighted.vectors = sums.vectors * weight
    return [np.cumsum(part[::-1], axis=0)[::-1] for part in weighted.of(group, windows)]
