"""Ranking of every form at every point by its linear response, with an extended BIC; pairs and products by beam."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dieseltwin.discovery.laws.grammar import (
    OPERATOR_AMPLITUDE,
    TIMES,
    Factor,
    Form,
    arguments,
    bumps,
    describe,
    factors,
    map_arguments,
    operators,
    unit_of,
)
from dieseltwin.discovery.laws.responses import PointResponse, Responses
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Point, Twin, law_scope_of

_BEAM = (24, 10)  # forms of one and of two factors that are multiplied by every further one
_KEPT = 24  # forms of a point that compete over all, and for pairs
_FIRST_TERMS = 6  # of a point's best forms, to which every further one is added as a second term
_OF_PAIRS = 4
_SIMPLER = 4  # candidates at the best one's point that are refitted as well
_OF_ONE_POINT = 4  # refits at least
_NEAR = 18.0  # of the best score: candidates whose simplicity counts; twice what a refit can't tell apart
_ALIKE = 0.9995  # correlation in the metric above which the simpler of two forms stands for both
_OPERATOR_CHOICE = 2.0 * float(np.log(10.0))  # charge for the choice of one of some ten operators
_NO_RESPONSE = 1e-10  # of a feature's own square sum: a response below it is rounding
_AT_ONCE = 400  # products scored together, which bounds the memory


@dataclass(frozen=True)
class Ranked:
    """One candidate law with its linear estimate.

    Attributes:
        index: of the point.
        site: its word.
        placed: one or two terms with first coefficients.
        gain: decrease of -2 log likelihood of the linear estimate.
        charge: what the extended BIC takes off.
    """

    index: int
    site: str
    placed: tuple[Placed, ...]
    gain: float
    charge: float

    @property
    def score(self) -> float:
        """Gain less charge."""
        return self.gain - self.charge

    @property
    def complexity(self) -> int:
        """Terms, and what their forms hold."""
        return sum(1 + p.form.complexity for p in self.placed)

    @property
    def key(self) -> tuple[Any, ...]:
        """Of the forms."""
        return tuple(sorted(p.form.key for p in self.placed))


@dataclass(frozen=True)
class _Scored:
    form: Form
    coefficient: float
    gain: float
    charge: float
    at_knots: Array

    @property
    def score(self) -> float:
        return self.gain - self.charge


def rank(
    twin: Twin, responses: Responses, variables: Mapping[str, Array], points: Sequence[str] | None = None,
    screened: Sequence[str] | None = None, since_s: float | None = None,
) -> list[Ranked]:  # fmt: skip
    """Candidate laws of all points, best first.

    Args:
        twin: gives points and ports.
        responses: at the current fit.
        variables: name -> (n,) along its trajectory, with `time_s`.
        points: names of the points to try; None for all.
        screened: names of those among the points that are ranked at all; laws pay for the choice from all of them.
        since_s: from when on all of them act [s]; None: always.
    """
    scope = law_scope_of(twin)
    chosen = [i for i, point in enumerate(twin.points) if points is None or point.name in points]
    field = _Field(
        twin, {name: np.asarray(values) for name, values in variables.items()},
        {**scope.units, **dict.fromkeys(TIMES, "s")}, None if scope.kinds is None else frozenset(scope.kinds),
        float(np.log(responses.at.whitening.present.sum())), len(chosen), since_s,
        twin.rows if isinstance(twin, OverRecordings) else (),
    )  # fmt: skip
    admitted = variables.keys() if scope.variables is None else variables.keys() & set(scope.variables)
    out: list[Ranked] = []
    for index in chosen:
        if screened is None or twin.points[index].name in screened:
            out += _AtPoint(field, index, responses.point(index), admitted).ranked()
    return sorted(out, key=lambda item: -item.score)


@dataclass(frozen=True)
class _Field:
    """What the ranking has in common at all points.

    Attributes:
        twin: gives the points.
        variables: name -> (n,).
        units: of variables.
        kinds: of factors that are tried; None for all.
        log_readings: logarithm of the number of readings, the extended BIC's price of a coefficient.
        points: number of points among which a law is chosen.
        since_s: from when on it acts [s]; None: always.
        recordings: samples of each of several; none for a single one.
    """

    twin: Twin
    variables: Mapping[str, Array]
    units: Mapping[str, str]
    kinds: frozenset[str] | None
    log_readings: float
    points: int
    since_s: float | None = None
    recordings: Sequence[slice] = ()

    def tries(self, kind: str) -> bool:
        """Whether factors of a kind are tried."""
        return self.kinds is None or kind in self.kinds


class _AtPoint:
    """Ranking of the forms of one point: single factors, products by beam, operators, and sums of two terms."""

    def __init__(self, field: _Field, index: int, response: PointResponse, admitted: Collection[str]) -> None:
        self.field, self.index, self.response = field, index, response
        self.point = point = field.twin.points[index]
        known = {
            name: describe(name, field.variables[name], unit_of(name, field.units), field.recordings)
            for name in arguments(point) if name in admitted and np.isfinite(field.variables[name]).any()
        }  # fmt: skip
        self.pool = [factor for factor in factors(arguments(point), known) if field.tries(factor.kind)]
        # Bumps over a map's arguments are many and alike: in a pool of their own, others don't pay for their number.
        of_map = {name: field.variables[name] for name in map_arguments(point) if name in known}
        self.local = bumps(of_map, field.units) if field.tries("bump") else []

    def ranked(self) -> list[Ranked]:
        """The forms that differ in the metric and sums of two of them."""
        point = self.point
        singles = self._scored([self._form(), *(self._form(f) for f in (*self.pool, *self.local))])
        products = self._products(singles)
        acting = self._scored(self._operators())
        best = sorted([*singles, *products, *acting], key=lambda s: -s.score)[: 3 * _KEPT]
        kept = _distinct(self.response, best)
        ranked = [Ranked(self.index, point.site, (_placed(s),), s.gain, s.charge) for s in kept]
        free = [s for s in kept if s.form.fixed is None]
        firsts = free[:_FIRST_TERMS]
        firsts += [s for s in singles if not s.form.factors and s not in firsts]  # the constant is always one of them
        return ranked + _pairs(self.index, point, self.response, firsts, [*singles, *free])

    def _form(self, *factors: Factor, fixed: float | None = None) -> Form:
        """A product at the point."""
        return Form(self.point.name, factors, fixed, self.field.since_s)

    def _operators(self) -> list[Form]:
        """Forms with a coefficient of 1 that act on what passes the point: lags, delays, plays."""
        point, field = self.point, self.field
        own_unit = unit_of(point.name, field.units) if point.name in field.variables else "-"
        return [self._form(f, fixed=1.0) for f in operators(point, own_unit) if field.tries(f.kind)]

    def _products(self, singles: Sequence[_Scored]) -> list[_Scored]:
        """Products of two and three factors, each round the last round's best by every further factor."""
        everything: list[_Scored] = []
        last, seen = singles, {s.form.key for s in singles}
        for beam in _BEAM:
            best = sorted((s for s in last if s.form.factors), key=lambda s: -s.score)[:beam]
            forms = []
            for form in (s.form for s in best):
                # A bump is multiplied by bumps over the map's other arguments, everything else by everything else.
                for factor in self.local if form.factors[0].kind == "bump" else self.pool:
                    longer = self._form(*form.factors, factor)
                    if _useful(form, factor) and longer.key not in seen:
                        seen.add(longer.key)
                        forms.append(longer)
            last = []
            for first in range(0, len(forms), _AT_ONCE):
                last += _trimmed(self._scored(forms[first : first + _AT_ONCE]))
            everything += last
        return everything

    def _scored(self, forms: Sequence[Form]) -> list[_Scored]:
        """Linear estimates of the forms that are finite along the trajectory and show in the readings at all."""
        if not forms:
            return []
        rows = len(self.field.twin.time_s)
        with np.errstate(all="ignore"):
            features = np.stack([
                np.broadcast_to(np.asarray(f.value(self.field.variables), dtype=float), (rows,)) for f in forms
            ])  # fmt: skip
        finite = np.isfinite(features).all(axis=1)
        features = features[finite]
        if not features.size:
            return []
        at_knots = self.response.at_knots(features)
        norms, gradients = self.response.norms(at_knots), self.response.gradients(at_knots)
        visible = norms > _NO_RESPONSE * np.maximum((features**2).sum(axis=1), 1e-300)
        out = []
        for i, form in zip(np.flatnonzero(visible), (forms[k] for k in np.flatnonzero(finite)[visible]), strict=True):
            coefficient = float(gradients[i] / norms[i])
            if form.fixed is not None:
                coefficient = float(np.clip(coefficient, *OPERATOR_AMPLITUDE))
            gain = float(2.0 * coefficient * gradients[i] - coefficient**2 * norms[i])
            out.append(_Scored(form, coefficient, gain, self._charge(form), at_knots[i]))
        return out

    def _charge(self, form: Form) -> float:
        """What the extended BIC takes off: for a coefficient, and for the choice of the point and of each factor."""
        common = self.field.log_readings + 2.0 * np.log(self.field.points)
        if form.fixed is not None:
            return float(common + _OPERATOR_CHOICE)
        bumped = sum(factor.kind == "bump" for factor in form.factors)
        of_pool, of_local = (2.0 * np.log(max(len(pool), 2)) for pool in (self.pool, self.local))
        return float(common + (of_pool * (len(form.factors) - bumped) + of_local * bumped))


def _trimmed(items: list[_Scored]) -> list[_Scored]:
    return sorted(items, key=lambda s: -s.score)[: 2 * _KEPT]


def _placed(s: _Scored) -> Placed:
    if s.form.fixed is not None:
        return Placed(s.form, s.form.fixed, free_shape=s.form.factors[0].has_free_shape)
    return Placed(s.form, s.coefficient or 1e-12)


def _useful(form: Form, factor: Factor) -> bool:
    """Products of two factors of one kind and variable say nothing new."""
    thresholds = sum(f.kind in ("excess", "shortage") for f in (*form.factors, factor))
    if thresholds > 1:
        return False
    return not any(own.variables == factor.variables and own.kind == factor.kind for own in form.factors)


def _distinct(response: PointResponse, items: Sequence[_Scored]) -> list[_Scored]:
    """Forms that differ in the metric: of those alike the best (simplest) stays."""
    if not items:
        return []
    stack = np.stack([s.at_knots for s in items])
    products = response.products(stack, stack)
    norms = np.sqrt(np.maximum(np.diag(products), 1e-300))
    correlation = np.abs(products / norms[:, None] / norms[None, :])
    kept: list[int] = []
    for i in range(len(items)):
        if all(correlation[i, j] < _ALIKE for j in kept):
            kept.append(i)
        if len(kept) == _KEPT:
            break
    return [items[i] for i in kept]


def _pairs(
    index: int, point: Point, response: PointResponse, firsts: Sequence[_Scored], seconds: Sequence[_Scored]
) -> list[Ranked]:
    """Sums of two terms at one point: to each of its best forms and a constant every single factor and good product.

    The best few, and the simplest of those near the best.
    """
    if not firsts or len(seconds) < 2:
        return []
    left, right = np.stack([s.at_knots for s in firsts]), np.stack([s.at_knots for s in seconds])
    across, own = response.products(left, right), (response.norms(left), response.norms(right))
    push = response.gradients(left), response.gradients(right)
    out: dict[tuple[Any, ...], Ranked] = {}
    for i, first in enumerate(firsts):
        a, b, c = own[0][i], own[1], across[i]
        determinant = a * b - c**2
        apart = determinant > 1e-3 * a * b
        safe = np.where(apart, determinant, 1.0)
        x, y = (b * push[0][i] - c * push[1]) / safe, (a * push[1] - c * push[0][i]) / safe
        gains = np.where(apart, x * push[0][i] + y * push[1], -np.inf)
        for j in np.argsort(-gains)[: (2 if first.form.factors else 8) * _OF_PAIRS]:
            charge = first.charge + seconds[j].charge - 2.0 * np.log(2.0)
            if gains[j] - charge > max(first.score, seconds[j].score):
                placed = (Placed(first.form, float(x[j])), Placed(seconds[j].form, float(y[j])))
                item = Ranked(index, point.site, placed, float(gains[j]), charge)
                out.setdefault(item.key, item)
    best = sorted(out.values(), key=lambda item: -item.score)
    return [*best[:_OF_PAIRS], *simplest(best[_OF_PAIRS:], best[0].score - _NEAR, _OF_PAIRS)] if best else []


def simplest(items: Sequence[Ranked], score: float, count: int) -> list[Ranked]:
    """The simplest few of those that reach a score."""
    return sorted((i for i in items if i.score > score), key=lambda i: (i.complexity, -i.score))[:count]


def simpler(ranked: Sequence[Ranked], than: Ranked) -> list[Ranked]:
    """Candidates at the same point, simpler than one and near the best there by their linear scores."""
    there = [item for item in ranked if item.index == than.index]
    fewer = [item for item in there if item.complexity < than.complexity]
    return simplest(fewer, max((item.score for item in there), default=0.0) - _NEAR, _SIMPLER)


def shortlist(ranked: Sequence[Ranked], count: int) -> list[Ranked]:
    """The best few: first the best of each point, as a refit may choose another site, then the best of all."""
    fair = [item for item in ranked if item.score > 0.0]
    first: dict[int, Ranked] = {}
    for item in fair:
        first.setdefault(item.index, item)
    out = list(first.values())[: count // 2]
    of_one_point = max(_OF_ONE_POINT, count // max(len(first), 1))
    used = {item.index: 1 for item in out}
    for item in fair:
        if len(out) == count:
            break
        if item not in out and used.get(item.index, 0) < of_one_point:
            out.append(item)
            used[item.index] = used.get(item.index, 0) + 1
    return out


__all__ = ["Ranked", "rank", "shortlist", "simpler"]
