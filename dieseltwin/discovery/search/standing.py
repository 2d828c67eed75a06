"""A valve that stands still, whatever it is told, for all of the recording or a part of it.

Such a fault is no small change of the machine: most readings are far from what the command asks for, health goes where
it can imitate it, and nothing that is linear about the health-only fit points to it. It is looked for before the
scores, and only where the misfit is many times the noise. Windows start from their own readings, so that one simulation
of each position tells every window whether the valve stood there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import (
    Candidate,
    Fit,
    Linearisation,
    first_fit,
    fit_fully,
    prior_misfit,
    simulate_fits,
)
from dieseltwin.discovery.likelihood.metric import Metric, Whitening
from dieseltwin.discovery.likelihood.noise import noise_of
from dieseltwin.discovery.likelihood.refit import scatter, widen
from dieseltwin.discovery.search.courses import MOST, Parts
from dieseltwin.discovery.search.explanations import look_at_what_is_left
from dieseltwin.discovery.search.pauses import dated, left_by, likeliest_parts, window_costs
from dieseltwin.discovery.search.preparation import prepare, telling_alone
from dieseltwin.discovery.search.state import Search, set_probabilities
from dieseltwin.discovery.search.sums import LEAST_SHARE
from dieseltwin.discovery.search.variants import SECOND_EDGE, Variant
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, WithCourses, rows_of
from dieseltwin.discovery.twins.windows import window_of_rows
from dieseltwin.settings.search import SearchSettings

_POSITIONS = np.array([0.1, 3.0, 10.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0])  # tried first [%]
_TURNS = 4  # of health and span, until the span stays
_ROUNDS = 6
_BELIEF = 10.0  # times the cost of health away from the file's, while nothing else says where the valve stands
_STARTS = 5  # positions from which one is fitted
_EDGE_SHARE = 0.02  # of what one span gains, that another edge must: a first guess of health is wrong in some windows
_END_SHARE = 0.25  # of the recording, at either end, that health is guessed from
_KINKS = 4  # times that windows are given up in a fit
_HOPELESS = 0.8  # of the misfit of health alone: valves that stood still left 0.15 to 0.6 at first, other faults 0.94
_NEAR = 2.0  # times what is enough, that positions in steps of 10 % may leave
_WELL = 1.5  # squared misfit per reading that needs no further try
_VAGUE = 1.0  # standard deviation of a position [%] from which others are weighed, too
_MOVES = 3.0  # standard deviation of a command while its valve stands still [%]: less is as well a shifted position


@dataclass(frozen=True)
class Standing:
    """A valve that stands still.

    Attributes:
        name: of the effect.
        parts: rows in which it stands still.
        fit: position and health.
        cost: squared whitened misfit of all windows with health as it was when the span was found.
    """

    name: str
    parts: Parts
    fit: Fit
    cost: float = np.inf

    @property
    def always(self) -> bool:
        """Whether it stands still all along."""
        return self.parts.begins and not self.parts.edges.size


def names_of(twin: Twin, settings: SearchSettings) -> list[str]:
    """Effects that take the place of a command, where the twin says that its effects may come and go."""
    if not isinstance(twin, WithCourses) or not twin.courses:
        return []
    return [name for name, item in twin.hypotheses.items() if item.in_place_of and name not in settings.withhold]


def worth_trying(found: Search) -> bool:
    """Whether a prepared search leaves so much that a valve may stand still."""
    least = found.settings.standing_from
    if least is None or not names_of(found.twin, found.settings):
        return False
    twin, null = found.twin, found.null
    whitening = Whitening.of(twin.measured, noise_of(twin), twin.starts)  # not what the misfit made it
    metric = Metric(whitening, twin.starts, null.local_response, twin.state_scales)
    rows = metric.without_local(np.nan_to_num(null.residual)[None])[0]
    return bool(rows @ rows > least * whitening.present.sum())


def standing_valve(twin: Twin, settings: SearchSettings) -> Standing | None:
    """The valve whose standing still explains nearly all, None where none does.

    Args:
        twin: as it was bound to its recording; nothing of it is changed.
        settings: `standing_share`, `withhold`.
    """
    names = names_of(twin, settings)
    whitening = Whitening.of(twin.measured, noise_of(twin), twin.starts)
    readings = float(whitening.present.sum())
    first = first_fit(twin)
    at = Linearisation(twin, whitening, first)
    null = fit_fully(twin, whitening, first, rounds=_ROUNDS)
    looks = [_best_span(at, names, start) for start in (null.fit, first)]
    if min((item.cost for item in looks if item is not None), default=np.inf) > _HOPELESS * null.fit.objective:
        return None
    best = None
    for start in _starts(at, null.fit):
        item = _settled(at, names, start)
        if item is not None and (best is None or item.cost < best.cost):
            best = item
        if best is not None and best.cost < _WELL * readings:
            break
    share = settings.standing_share
    enough = (1.0 - share) * null.fit.objective + share * readings
    if best is None or best.cost > _NEAR * enough:
        return None
    item = _positioned(at, _dated(at, best))
    if item.fit.objective >= enough:
        return None
    again = _dated(at, item)  # edges of a position in steps of 10 % lie where the command passes it
    if np.array_equal(again.parts.edges, item.parts.edges):
        return item
    return min(item, replace(again, fit=_whole(at, again.fit)), key=lambda each: each.fit.objective)


def _starts(at: Linearisation, null: Fit) -> Iterator[Fit]:
    """First guesses of health: believed, of everything, and of either end, where the valve may move."""
    n = at.twin.time_s.size
    yield at.fit
    yield null
    for part in (slice(0, int(_END_SHARE * n)), slice(int((1.0 - _END_SHARE) * n), n)):
        outside = np.ones(n, dtype=bool)
        outside[part] = False
        yield _fit(at, outside, at.fit)


def _fit(at: Linearisation, out: np.ndarray, start: Fit) -> Fit:
    """A fit without some rows (n,), and without windows that alone tell a parameter; its start where none is found."""
    twin, noise = at.twin, noise_of(at.twin)
    for _ in range(_KINKS):
        whitening = Whitening.of(np.where(out[:, None], np.nan, twin.measured), noise, twin.starts)
        try:
            fitted = fit_fully(twin, whitening, start, rounds=_ROUNDS)
        except (np.linalg.LinAlgError, ValueError):  # the machine runs away there: numbers without an end
            return start
        alone = telling_alone(fitted)
        if not alone.any():
            break
        out = out | rows_of(twin, alone)
    return fitted.fit


def _settled(at: Linearisation, names: Sequence[str], start: Fit) -> Standing | None:
    """The best span and position, and health of the driving outside it, in turns from a first guess of health on.

    The windows at either edge are left out: half of such a window goes by the command, and would bend all the rest.
    """
    twin, best = at.twin, None
    for _ in range(_TURNS):
        item = _best_span(at, names, start)
        if item is None or (best is not None and item.cost >= best.cost):
            break
        same = best is not None and item.name == best.name and _same(item.parts, best.parts)
        best = item
        if same:
            break
        inside = item.fit.candidate.schedules[item.name] > 0.0
        near = _beside_edges(twin, inside)
        if (inside | near).mean() < 1.0 - LEAST_SHARE:
            health = replace(item.fit, candidate=Candidate(), magnitudes=np.zeros(0))
            start = _fit(at, inside | near, health)
        else:
            start = _whole(at, item.fit, near)
    return best


def _same(first: Parts, second: Parts) -> bool:
    return first.begins == second.begins and np.array_equal(first.edges, second.edges)


def _beside_edges(twin: Twin, inside: np.ndarray) -> np.ndarray:
    """(n,) rows of the windows at either side of an edge of a span."""
    of_row = window_of_rows(twin.starts, inside.size)
    edges = np.flatnonzero(np.diff(inside.astype(np.int64))) + 1
    return np.isin(of_row, [of_row[edge] + k for edge in edges for k in (-1, 0, 1)])


def _best_span(at: Linearisation, names: Sequence[str], start: Fit) -> Standing | None:
    """The valve, position and windows in a row whose readings are explained best beside what the command says."""
    twin = at.twin
    plain = Fit(Candidate(), start.parameters, np.zeros(0), twin.first_local(), np.inf, False)
    tried = [(name, float(position)) for name in names for position in _POSITIONS]
    costs = _costs(at, simulate_fits(twin, [plain, *(_standing_fit(*one, None, plain) for one in tried)]))
    most, best = 0.0, None
    for (name, position), gains in zip(tried, costs[0] - costs[1:], strict=True):
        stands = likeliest_parts(gains, max(SECOND_EDGE, _EDGE_SHARE * _largest_sum(gains)))
        parts, gain = Parts.of_groups(twin.starts, stands), float(gains[stands].sum())
        if gain > most and parts.count <= MOST and _moves(twin, name, parts):
            most, best = gain, _standing(twin, name, position, parts, plain)
    return None if best is None else replace(best, cost=float(costs[0].sum() - most))


def _moves(twin: Twin, name: str, parts: Parts) -> bool:
    """Whether the command moves while its valve stands still, long enough to be a state of the machine."""
    command = twin.conditions[twin.hypotheses[name].in_place_of]
    stands = parts.acts(command.size) > 0.0
    return bool(stands.mean() > LEAST_SHARE and np.std(command[stands]) >= _MOVES)


def _standing(twin: Twin, name: str, position: float, parts: Parts, health: Fit) -> Standing:
    return Standing(name, parts, _standing_fit(name, position, parts.acts(twin.time_s.size), health))


def _standing_fit(name: str, position: float, acts: Array | None, health: Fit) -> Fit:
    schedules = {} if acts is None else {name: acts}
    return replace(health, candidate=Candidate((name,), schedules), magnitudes=np.array([position]), covariance=None)


def _costs(at: Linearisation, simulated: Array) -> Array:
    """(B, W) squared whitened residuals of each window, simulated (B, n, C)."""
    measured = at.twin.measured
    return window_costs(at, np.where(np.isfinite(measured), measured - simulated, 0.0))


def _largest_sum(values: Array) -> float:
    """The largest sum of neighbours (Kadane)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return float(np.max(sums - np.minimum.accumulate(sums)))


def _dated(at: Linearisation, item: Standing) -> Standing:
    """The same with all edges at the samples where they explain most; position and health stay."""
    parts = dated(at, item.fit, left_by(at, item.fit), item.parts)
    position = float(item.fit.magnitudes[0])
    return replace(_standing(at.twin, item.name, position, parts, item.fit), cost=item.cost)


def _positioned(at: Linearisation, item: Standing) -> Standing:
    """Position and health fitted together: from the position so far on, and from others where that isn't enough.

    A valve that stood all along is as well a larger or smaller one, and its map may be flat (`scattered`).
    """
    best = _whole(at, item.fit)
    if best.objective > _WELL * at.whitening.present.sum() or item.always:
        starts = [replace(item.fit, magnitudes=np.array([position])) for position in _POSITIONS]
        costs = _costs(at, simulate_fits(at.twin, starts)).sum(axis=1)
        others = [_whole(at, starts[k]) for k in np.argsort(costs)[:_STARTS]]
        best = min([best, *others], key=lambda fit: fit.objective)
    return replace(item, fit=best)


def _whole(at: Linearisation, start: Fit, out: np.ndarray | None = None) -> Fit:
    """A fit of all rows but some (n,), its objective by all; windows that alone tell a parameter don't decide on it."""
    try:
        fit = _fit(at, np.zeros(at.twin.time_s.size, dtype=bool) if out is None else out, start)
        return Linearisation(at.twin, at.whitening, fit).fit
    except (np.linalg.LinAlgError, ValueError):  # as in `_fit`
        return replace(start, objective=np.inf)


def prepared_beside(twin: Twin, settings: SearchSettings, item: Standing) -> Search:
    """As `preparation.prepare`, about the valve that stands still: noise, tolerances and what else could be seen.

    Args:
        twin: as it was bound to its recording.
        settings: thresholds.
        item: of `standing_valve`.
    """
    found = prepare(twin, settings, item.fit)
    best = cast(Linearisation, found.best)
    onset, until, _, gone = item.parts.times(twin)
    variant = Variant(item.name, None if item.parts.begins else onset, None, item.fit.candidate.schedules[item.name],
                      best.jacobian[-1], found.gain(best.fit), until_s=until, gone=gone)  # fmt: skip
    found.variants, found.standing = [(variant, best.fit)], True
    if item.always or not best.fit.std[-1] < _VAGUE:
        fits = [best.fit, *_elsewhere(best)]
        if item.always:  # of what explains as much, the position at which health is nearest to what is believed
            nearest = min(fits, key=lambda fit: fit.objective + _BELIEF * prior_misfit(found.twin, fit.parameters))
            found.best = Linearisation(found.twin, best.whitening, replace(nearest, converged=True), best)
            fits = [found.best.fit, *(fit for fit in fits if fit is not nearest)]
        found.variants = [(variant, fit) for fit in fits]
    return found


def _elsewhere(best: Linearisation) -> list[Fit]:
    """Health fitted beside the valve at other positions, in the metric of the best."""
    fit, found = best.fit, []
    (name,) = fit.candidate.names
    alone = replace(fit, candidate=Candidate(), magnitudes=np.zeros(0), covariance=None)
    for position in _POSITIONS:
        size = np.array([position])
        held = cast(Twin, _Held(best.twin, name, size, fit.candidate.schedules[name]))
        try:
            other = fit_fully(held, best.whitening, alone, rounds=_ROUNDS, frozen=best).fit
        except (np.linalg.LinAlgError, ValueError):  # as in `_fit`
            continue
        found.append(replace(other, candidate=fit.candidate, magnitudes=size, covariance=None))
    return found


class _Held:
    """A twin whose valve stands still at one position in every simulation."""

    def __init__(self, twin: Twin, name: str, position: Array, acts: Array) -> None:
        self._twin, self._name, self._position, self._acts = twin, name, position, acts

    def __getattr__(self, name: str) -> object:
        return getattr(self._twin, name)

    def simulate(self, lanes: Lanes) -> Array:
        """As `Twin.simulate`."""
        sizes = {**lanes.magnitudes, self._name: np.repeat(self._position, lanes.size)}
        held = replace(lanes, magnitudes=sizes, schedules={**lanes.schedules, self._name: self._acts})
        return self._twin.simulate(held)


def scattered(found: Search) -> float:
    """Standard deviation of the valve's position over all that explain nearly as much [%]."""
    fits = [fit for _, fit in found.variants]
    sizes = np.array([fit.magnitudes for fit in fits])
    behind = np.array([fit.objective for fit in fits]) - min(fit.objective for fit in fits)
    return float(scatter(sizes, sizes[0], behind)[0])


def explain_standing(found: Search) -> None:
    """The valve is the explanation; what it leaves is looked at, and is for a search with the repaired machine."""
    best = cast(Linearisation, found.best)
    found.kind, found.variant = "variant", found.variants[0][0]
    found.widening = max(1.0, look_at_what_is_left(found, best) / found.settings.chance_leaves)
    widen(best, found.widening)
    set_probabilities(found, found.kind)
