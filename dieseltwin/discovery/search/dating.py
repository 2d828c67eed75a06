"""When an effect began and when it ended, once the explanation is known: within which dates, with all readings.

The search leaves windows out in which errors of maps don't act linearly about the health-only fit. About the right
explanation they do. Where such windows lie at an onset, nothing tells the dates within them apart: of a drift of the
injectors since 250 s, 250 to 288 s gained the same within 1, and 288 was stated.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from dieseltwin.discovery.laws.search import Law
from dieseltwin.discovery.laws.twin import of_base
from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation, simulate_fits
from dieseltwin.discovery.likelihood.learned import LearnedTwin
from dieseltwin.discovery.likelihood.metric import Whitening, covariance_of
from dieseltwin.discovery.likelihood.refit import widen
from dieseltwin.discovery.search.courses import at_times
from dieseltwin.discovery.search.nameless import law_about_itself
from dieseltwin.discovery.search.preparation import recentred
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variants import Variant
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin, rows_of

LeftAt = Callable[[Sequence[float]], Array]
"""What explanations leave (D,) with an edge at each of some times of the twin [s]."""

Ranges = dict[str, tuple[float, float]]

_AS_GOOD = 4.0  # of -2 log likelihood: two standard deviations
_AT_ONCE = 2  # windows to either side that are tried at once, and further ones where the outermost is as good
_RESOLVED_S = 0.25  # of the ends of a range: what is said has whole seconds
_RESOLVED = 0.03  # the same of what is wide, as a share of it
_RASTER_S = 1.0  # of the dates that the search tries: one that is off by less isn't worth a refit


def date_edges(found: Search) -> None:
    """The range of dates of an onset and of an end that a chosen explanation or a law has.

    Where windows near them were left out, an explanation is dated with those. Where another date is better by more than
    the search's raster, it is refitted there. A law has been refitted at other dates already.
    """
    if isinstance(found.twin, OverRecordings):
        return
    clock, within = time.perf_counter(), _AS_GOOD * found.widening
    if found.kind == "law" and found.since_s is not None:
        found.onset_range_s = _range_of_law(found, found.since_s, within)
        found.seconds["dates"] = time.perf_counter() - clock
        return
    variant, best = found.variant, found.best
    if found.kind != "variant" or variant is None or best is None or variant.onset_s is None:
        return
    ranges, dated = _ranges(best, variant, within)
    if _unseen(found, ranges.values()):
        ranges, dated = _dated_with_all_readings(found, best, variant, within)
    coarse = float(np.median(np.diff(found.twin.time_s))) >= _RASTER_S  # a row beside may be another world
    if not _holds(ranges, variant, _RASTER_S) or (coarse and not np.array_equal(dated.schedule, variant.schedule)):
        _explain_at(found, dated)
        variant = dated
    ranges = {name: (min(low, _date_of(variant, name)), max(high, _date_of(variant, name)))
              for name, (low, high) in ranges.items()}  # fmt: skip
    found.onset_range_s, found.until_range_s = ranges.get("onset_s"), ranges.get("until_s")
    found.seconds["dates"] = time.perf_counter() - clock


def without_effect(at: Linearisation) -> Array:
    """What the readings leave without the explanation's effect (rows,), in its metric."""
    alone = replace(at.fit, candidate=Candidate(), magnitudes=np.zeros(0))
    return np.asarray(at.metric.project(np.nan_to_num(at.twin.measured - simulate_fits(at.twin, [alone])))[0])


def objectives(at: Linearisation, variants: Sequence[Variant], without: Array) -> Array:
    """What each of some courses of the explanation's effect leaves (D,), simulated with the health of one fit.

    Parameters, size, initial states and tolerances move linearly from there: a step of a refit, without its rounds.

    Args:
        at: the explanation, linearised about itself.
        variants: its effect with other edges.
        without: as of `without_effect`.
    """
    simulated = simulate_fits(at.twin, [_with_course(at.fit, variant) for variant in variants])
    return _weighed(at, simulated, without, float(at.fit.magnitudes[0]), len(at.twin.parameters))


def _weighed(at: Linearisation, simulated: Array, without: Array, size: float, known: int) -> Array:
    """What is left (D,) of simulations (D, n, C) once what the linearisation has free has moved linearly.

    Args:
        at: about the explanation; without: as of `without_effect`.
        size: of the effect in the simulations [unit], which moves as well.
        known: the first so many of the parameters move: what stands behind them is that size.
    """
    left = at.metric.project(np.nan_to_num(at.twin.measured - simulated))
    acting = (without - left) / size
    rows = left.shape[1]
    prior = np.sqrt(at.precision[:known]) * at.pulled_residual[rows : rows + known]
    information = np.empty((known + 1, known + 1))
    information[:known, :known] = at.projected[:known] @ at.projected[:known].T + np.diag(at.precision[:known])
    found = np.full(len(simulated), np.inf)
    ran = np.array([bool(np.isfinite(each).all()) for each in simulated])
    for k in np.flatnonzero(ran):
        information[known, :known] = information[:known, known] = at.projected[:known] @ acting[k]
        information[known, known] = acting[k] @ acting[k]
        gradient = np.append(at.projected[:known] @ left[k] + prior, acting[k] @ left[k])
        found[k] = left[k] @ left[k] - gradient @ covariance_of(information) @ gradient
    return np.where(np.isfinite(found), found, np.inf)


def _with_course(fit: Fit, variant: Variant) -> Fit:
    return replace(fit, candidate=Candidate((variant.name,), {variant.name: variant.schedule}))


def _ranges(at: Linearisation, variant: Variant, within: float) -> tuple[Ranges, Variant]:
    """The range of each edge that there is, the other one held, and the variant with the best of them."""
    first_s = float(at.twin.time_s[0])
    onset, until, without = float(variant.onset_s or 0.0), variant.until_s, without_effect(at)
    found: Ranges = {}
    last = variant.gone[-1][1] if variant.gone else onset

    def left_at(times: Sequence[float], dated: Callable[[float], Variant]) -> Array:
        return objectives(at, [dated(time_s) for time_s in times], without)

    if onset > first_s:
        end = variant.gone[0][0] if variant.gone else until
        begins = partial(at_times, at.twin, variant, until_s=until, grows=variant.grows, gone=variant.gone)
        edge = _Edge(at.twin, partial(left_at, dated=begins), first_s, end)
        found["onset_s"] = edge.range_about(onset, within)
        onset = edge.best
    if until is not None:
        ends = partial(at_times, at.twin, variant, onset, grows=False, gone=variant.gone)
        edge = _Edge(at.twin, partial(left_at, dated=ends), max(last, onset), None)
        found["until_s"] = edge.range_about(until, within)
        until = edge.best
    return found, at_times(at.twin, variant, onset, until, variant.grows, variant.gone)


def _range_of_law(found: Search, since_s: float, within: float) -> tuple[float, float]:
    """Between which dates a law began.

    Windows that were left out tell nothing: where one lies at an end of the range, the law may have begun within it.
    """
    law, twin = cast(Law, found.law), found.twin
    at, known = law_about_itself(found, law), len(twin.parameters)
    fit = at.fit
    without = at.metric.project(np.nan_to_num(twin.measured - twin.simulate(of_base(fit.lanes(), twin))))[0]

    def left_at(times: Sequence[float]) -> Array:
        simulated = [law.since(date).on(twin)[0].simulate(fit.lanes())[0] for date in times]
        return _weighed(at, np.stack(simulated), without, 1.0, known)

    low, high = _Edge(twin, left_at, float(twin.time_s[0]), None).range_about(since_s, within)
    low, high = min(low, since_s), max(high, since_s)
    while len(hidden := _hidden_at(found, [(low, high)])):
        begins, ends = hidden[:, 0].min(), hidden[:, 1].max()
        if begins >= low and ends <= high:
            break
        low, high = min(low, begins), max(high, ends)
    return float(low), float(high)


class _Edge:
    """Objectives of an explanation over the date of one of its edges.

    Args:
        twin: whose rows and windows the dates are.
        left_at: what is left with the edge at some times.
        after_s, before_s: limits of the edge; None: the recording's end.
    """

    def __init__(self, twin: Twin, left_at: LeftAt, after_s: float, before_s: float | None) -> None:
        self.twin, self.left_at = twin, left_at
        time_s = twin.time_s
        last = float(time_s[-1]) if before_s is None else before_s
        inside = np.flatnonzero((time_s > after_s) & (time_s < last))
        self.rows = inside[2:-2]  # an effect of a row or two isn't any
        self.known: dict[int, float] = {}

    def range_about(self, time_s: float, within: float) -> tuple[float, float]:
        """Between which dates lie all whose objective is within so much of the best."""
        times = self.twin.time_s
        start = int(np.searchsorted(times, time_s))
        if self.rows.size < 2:
            return time_s, time_s
        self._try([start])
        grid = np.array([row for row in self.twin.starts if self.rows[0] <= row <= self.rows[-1]])
        below, above = grid[grid < start][::-1], grid[grid > start]
        if not np.isfinite(self.known[start]):  # the machine runs away without what is dated
            return time_s, time_s
        while below.size or above.size:
            self._try([*below[:_AT_ONCE], *above[:_AT_ONCE]])
            limit = min(self.known.values()) + within
            below = below[_AT_ONCE:] if self._as_good(below[:_AT_ONCE], limit) else below[:0]
            above = above[_AT_ONCE:] if self._as_good(above[:_AT_ONCE], limit) else above[:0]
        while True:
            tried = sorted(self.known)
            limit = min(self.known.values()) + within
            good = [k for k, row in enumerate(tried) if self.known[row] <= limit]
            best = tried.index(self.best_row)
            ends = max(good[0] - 1, 0), min(good[-1] + 1, len(tried) - 1)
            between = [(k - 1, k) for k in (good[0], good[-1] + 1, best, best + 1) if 0 < k < len(tried)]
            gaps = {(tried[a], tried[b]) for a, b in between}
            least = max(_RESOLVED_S, _RESOLVED * float(times[tried[good[-1]]] - times[tried[good[0]]]))
            middles = {(a + b) // 2 for a, b in gaps if b - a > 1 and times[b] - times[a] > least}
            if not middles:
                return float(times[tried[ends[0]]]), float(times[tried[ends[1]]])
            self._try(sorted(middles))

    @property
    def best(self) -> float:
        """The best date that was tried [s]."""
        return float(self.twin.time_s[self.best_row])

    @property
    def best_row(self) -> int:
        """Its row."""
        return min(self.known, key=lambda row: self.known[row])

    def _as_good(self, rows: np.ndarray, limit: float) -> bool:
        return bool(rows.size) and min(self.known[int(row)] for row in rows[-2:]) <= limit

    def _try(self, rows: Sequence[int]) -> None:
        times = self.twin.time_s
        values = self.left_at([float(times[row]) for row in rows])
        self.known.update({int(row): float(value) for row, value in zip(rows, values, strict=True)})


def _unseen(found: Search, ranges: Iterable[tuple[float, float]]) -> bool:
    """Whether a window that was left out lies in a range or next to it."""
    return found.hidden is not None and len(_hidden_at(found, ranges)) > 0


def _hidden_at(found: Search, ranges: Iterable[tuple[float, float]]) -> Array:
    """Begin and end (N, 2) of the windows that were left out and lie in a range or next to it [s]."""
    if not found.left_out.any():
        return np.zeros((0, 2))
    times = found.twin.time_s
    begins = times[found.twin.starts]
    spans = np.column_stack([begins, np.append(begins[1:], times[-1])])[found.left_out]
    step = float(np.median(np.diff(times)))
    near = [(spans[:, 0] <= high + step) & (spans[:, 1] >= low - step) for low, high in ranges]
    return np.asarray(spans[np.logical_or.reduce(near)] if near else spans[:0])


def _with_all_readings(found: Search, but: np.ndarray) -> Search:
    """The search with the readings that were left out, but for those of some windows (W,)."""
    twin, moved = copy(found.twin), found.twin.moved if isinstance(found.twin, LearnedTwin) else 0.0
    back = rows_of(twin, found.left_out & ~but)[:, None]
    twin.measured = np.where(back, cast(Array, found.hidden) + moved, twin.measured)
    whitening = Whitening.of(twin.measured, found.noise, twin.starts, found.scatter)
    return replace(found, twin=twin, whitening=whitening)


def _dated_with_all_readings(
    found: Search, best: Linearisation, variant: Variant, within: float
) -> tuple[Ranges, Variant]:
    """The ranges of the edges with the readings that were left out, and the variant with the best ones.

    Windows that are met worse there than any other stay out: there errors of maps act as they did before.
    """
    here = _with_all_readings(found, np.zeros_like(found.left_out))
    at = Linearisation(here.twin, here.whitening, best.fit, None, best.nuisance_response, best.loadings)
    ranges, dated = _ranges(at, variant, within)
    moves = not _holds(ranges, variant)
    if moves:
        at = recentred(here, _with_course(best.fit, dated))
    worse = _worse_than_any(at, found.left_out)
    if worse.any():
        at = recentred(_with_all_readings(found, worse), _with_course(best.fit, dated))
    if worse.any() or moves:
        ranges, dated = _ranges(at, dated, within)
    return ranges, dated


def _worse_than_any(at: Linearisation, windows: np.ndarray) -> np.ndarray:
    """Which of some windows (W,) leave more per reading than any other does."""
    channels = at.residual.shape[1]
    left = np.add.reduceat(at.projected_residual[: at.residual.size] ** 2, at.twin.starts * channels)
    left /= np.maximum(np.add.reduceat(at.whitening.present.sum(axis=1), at.twin.starts), 1)
    return np.asarray(windows & (left > left[~windows].max(initial=0.0)))


def _holds(ranges: Ranges, variant: Variant, beyond_s: float = 0.0) -> bool:
    """Whether a variant's edges lie within ranges that may reach so much further [s]."""
    return all(low - beyond_s <= _date_of(variant, name) <= high + beyond_s for name, (low, high) in ranges.items())


def _date_of(variant: Variant, name: str) -> float:
    return float((variant.onset_s if name == "onset_s" else variant.until_s) or 0.0)


def _explain_at(found: Search, variant: Variant) -> None:
    """The chosen explanation with other edges, fitted to the readings that the search compares."""
    best, (_, before) = cast(Linearisation, found.best), found.variants[0]
    found.best = recentred(found, _with_course(best.fit, variant))
    objective = before.objective + found.best.fit.objective - best.fit.objective
    widen(found.best, found.widening)
    found.variant = variant
    found.variants[0] = (variant, replace(found.best.fit, objective=objective))
