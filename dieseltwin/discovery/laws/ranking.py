"""Ranking of every form at every point by its linear response, with an extended BIC; pairs and products by beam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dieseltwin.discovery.laws.grammar import (
    TIMES,
    Factor,
    Form,
    Variable,
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
from dieseltwin.discovery.likelihood.worth import Worth
from dieseltwin.discovery.twins.interface import Array, Point, Twin, law_scope_of

_BEAM = (24, 10)  # forms of one and of two factors that are multiplied by every further one
_KEPT = 24  # forms of a point that compete over all, and for pairs
_FIRST_TERMS = 6  # of a point's best forms, to which every further one is added as a second term
_OF_PAIRS = 4
_NEAR = 18.0  # of the best score: candidates whose simplicity counts; twice what a refit can't tell apart
_ALIKE = 0.9995  # correlation in the metric above which the simpler of two forms stands for both
_OPERATOR_AMPLITUDE = (0.2, 3.0)  # an operator's coefficient is 1; its size isn't known yet


@dataclass(frozen=True)
class Ranked:
    """One candidate law with its linear estimate.

    Attributes:
        index: of the point.
        site: its word.
        placed: one or two terms with first coefficients.
        gain: decrease of -2 log likelihood of the linear estimate.
        charge: what the extended BIC takes off.
        worth: what the gain counts for.
    """

    index: int
    site: str
    placed: tuple[Placed, ...]
    gain: float
    charge: float
    worth: float

    @property
    def score(self) -> float:
        """Worth less charge."""
        return self.worth - self.charge

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
    worth: float
    at_knots: Array

    @property
    def score(self) -> float:
        return self.worth - self.charge


def rank(
    twin: Twin, responses: Responses, variables: Mapping[str, Array], points: Sequence[str] | None = None,
    readings: float | None = None, kinds: Sequence[str] | None = None, screened: Sequence[str] | None = None,
) -> tuple[list[Ranked], int]:  # fmt: skip
    """Candidate laws of all points, best first, and how many forms were tried.

    Args:
        twin: gives points and ports.
        responses: at the current fit.
        variables: name -> (n,) along its trajectory, with `time_s`.
        points: names of the points to try; None for all.
        readings: independent ones where the size of the misfit counts as unknown (`worth`), else None.
        kinds: of factors; None for those of the twin's `LawScope`, else all.
        screened: names of those among the points that are ranked at all; laws pay for the choice from all of them.
    """
    scope = law_scope_of(twin)
    kinds, admitted = kinds or scope.kinds, scope.variables
    units = {**scope.units, **dict.fromkeys(TIMES, "s")}
    worth = Worth(responses.explained(), readings)
    log_readings = float(np.log(readings or responses.at.whitening.present.sum()))
    out: list[Ranked] = []
    tried = 0
    chosen = [i for i, point in enumerate(twin.points) if points is None or point.name in points]
    for index in chosen:
        point = twin.points[index]
        if screened is not None and point.name not in screened:
            continue
        known = {
            name: describe(name, np.asarray(variables[name]), unit_of(name, units))
            for name in arguments(point)
            if name in variables and np.isfinite(variables[name]).any() and (admitted is None or name in admitted)
        }
        found, count = _of_point(
            twin, index, point, known, responses.point(index), variables, units, worth, log_readings, len(chosen), kinds
        )
        tried += count
        out += found
    return sorted(out, key=lambda item: -item.score), tried


def _of_point(
    twin: Twin, index: int, point: Point, known: Mapping[str, Variable], response: PointResponse,
    variables: Mapping[str, Array], units: Mapping[str, str], worth: Worth, log_readings: float, points: int,
    kinds: Sequence[str] | None,
) -> tuple[list[Ranked], int]:  # fmt: skip
    pool = [f for f in factors(arguments(point), known) if kinds is None or f.kind in kinds]
    # Bumps over a map's arguments are many and alike: a pool of their own, so that others don't pay for their number.
    of_map = {name: np.asarray(variables[name]) for name in map_arguments(point) if name in known}
    local = bumps(of_map, units) if kinds is None or "bump" in kinds else []
    each = 2.0 * np.log(max(len(pool), 2))
    each_local = 2.0 * np.log(max(len(local), 2))
    common = log_readings + 2.0 * np.log(points)
    n = len(twin.time_s)
    at = {**variables}

    def scored(forms: Sequence[Form]) -> list[_Scored]:
        if not forms:
            return []
        with np.errstate(all="ignore"):
            features = np.stack([np.broadcast_to(np.asarray(f.value(at), dtype=float), (n,)) for f in forms])
        fine = np.all(np.isfinite(features), axis=1)
        forms = [f for f, ok in zip(forms, fine, strict=True) if ok]
        features = features[fine]
        if not forms:
            return []
        at_knots = response.at_knots(features)
        norms, gradients = response.norms(at_knots), response.gradients(at_knots)
        floor = 1e-10 * np.maximum((features**2).sum(1), 1e-300)
        out = []
        for form, norm, gradient, own, smallest in zip(forms, norms, gradients, at_knots, floor, strict=True):
            if norm <= smallest:
                continue
            amplitude = gradient / norm
            if form.fixed is not None:
                amplitude = float(np.clip(amplitude, *_OPERATOR_AMPLITUDE))
            gain = 2.0 * amplitude * gradient - amplitude**2 * norm
            bumped = sum(factor.kind == "bump" for factor in form.factors)
            chosen = each * (len(form.factors) - bumped) + each_local * bumped
            charge = common + (chosen if form.fixed is None else 2.0 * np.log(10.0))
            out.append(_Scored(form, float(amplitude), float(gain), float(charge), worth(float(gain)), own))
        return out

    singles = scored([Form(point.name), *(Form(point.name, (f,)) for f in (*pool, *local))])
    products, everything, seen = singles, list(singles), {s.form.key for s in singles}
    count = len(singles)
    for beam in _BEAM:
        best = sorted((s for s in products if s.form.factors), key=lambda s: -s.score)[:beam]
        forms = []
        for s in best:
            for factor in local if s.form.factors[0].kind == "bump" else pool:
                if not _useful(s.form, factor):
                    continue
                form = Form(point.name, (*s.form.factors, factor))
                if form.key not in seen:
                    seen.add(form.key)
                    forms.append(form)
        products = []
        for first in range(0, len(forms), 400):
            products += _trimmed(scored(forms[first : first + 400]))
        everything += products
        count += len(forms)
    own_unit = unit_of(point.name, units) if point.name in variables else "-"
    everything += scored([Form(point.name, (f,), 1.0) for f in operators(point, own_unit)
        if kinds is None or f.kind in kinds])
    kept = _distinct(response, sorted(everything, key=lambda s: -s.score)[: 3 * _KEPT])
    ranked = [Ranked(index, point.site, (_placed(s),), s.gain, s.charge, s.worth) for s in kept]
    free = [s for s in kept if s.form.fixed is None]
    firsts = [*free[:_FIRST_TERMS], *(s for s in singles if not s.form.factors and s not in free[:_FIRST_TERMS])]
    ranked += _pairs(index, point, response, firsts, [*singles, *free], worth)
    return ranked, count


def _trimmed(items: list[_Scored]) -> list[_Scored]:
    return sorted(items, key=lambda s: -s.score)[: 2 * _KEPT]


def _placed(s: _Scored) -> Placed:
    if s.form.fixed is not None:
        return Placed(s.form, s.form.fixed, free_shape=s.form.factors[0].has_free_shape)
    return Placed(s.form, s.coefficient or 1e-12)


def _useful(form: Form, factor: Factor) -> bool:
    """Products of two powers of one variable, or of the same factor, say nothing new."""
    thresholds = sum(f.kind in ("excess", "shortage") for f in (*form.factors, factor))
    if thresholds > 1:
        return False
    for own in form.factors:
        if own.variables == factor.variables and own.kind == factor.kind:
            return False
        if {own.kind, factor.kind} <= {"power", "signed_power"} and own.variables == factor.variables:
            return False
    return True


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
    index: int, point: Point, response: PointResponse, firsts: Sequence[_Scored], seconds: Sequence[_Scored],
    worth: Worth,
) -> list[Ranked]:  # fmt: skip
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
            value = worth(float(gains[j])) if np.isfinite(gains[j]) else -np.inf
            if value - charge > max(first.score, seconds[j].score):
                placed = (Placed(first.form, float(x[j])), Placed(seconds[j].form, float(y[j])))
                item = Ranked(index, point.site, placed, float(gains[j]), charge, value)
                out.setdefault(item.key, item)
    best = sorted(out.values(), key=lambda item: -item.score)
    return [*best[:_OF_PAIRS], *simplest(best[_OF_PAIRS:], best[0].score - _NEAR, _OF_PAIRS)] if best else []


def simplest(items: Sequence[Ranked], score: float, count: int) -> list[Ranked]:
    """The simplest few of those that reach a score."""
    return sorted((i for i in items if i.score > score), key=lambda i: (i.complexity, -i.score))[:count]


def simpler(ranked: Sequence[Ranked], than: Ranked, count: int = 4) -> list[Ranked]:
    """Candidates at the same point, simpler than one and near the best there by their linear scores."""
    there = [item for item in ranked if item.index == than.index]
    fewer = [item for item in there if item.complexity < than.complexity]
    return simplest(fewer, max((item.score for item in there), default=0.0) - _NEAR, count)


def shortlist(ranked: Sequence[Ranked], count: int, of_one_point: int = 4) -> list[Ranked]:
    """The best few: first the best of each point, as a refit may choose another site, then the best of all."""
    fair = [item for item in ranked if item.score > 0.0]
    first: dict[int, Ranked] = {}
    for item in fair:
        first.setdefault(item.index, item)
    out = list(first.values())[: count // 2]
    of_one_point = max(of_one_point, count // max(len(first), 1))
    used = {item.index: 1 for item in out}
    for item in fair:
        if len(out) == count:
            break
        if item not in out and used.get(item.index, 0) < of_one_point:
            out.append(item)
            used[item.index] = used.get(item.index, 0) + 1
    return out


__all__ = ["Ranked", "rank", "shortlist", "simpler"]
