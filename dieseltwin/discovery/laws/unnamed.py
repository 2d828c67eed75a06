"""Terms without a name against names on equal terms: refitted by simulation, as names are.

A linear score understates a large effect, by half in the middle of the development cases. So a name that was refitted
always won against the term that fits far better. Here the leading terms are refitted too, in the metric of the
health-only fit, where their gains compare with those of names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.laws.ranking import Ranked
from dieseltwin.discovery.laws.refit import Refit, refit_all_laws
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.discovery.likelihood.fit import Linearisation, fit_fully
from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.twins.interface import Twin

_LEAST_SHARE = 0.35  # of the best linear gain, as for names (`search`)
_OF_A_POINT = 3  # terms of one point that are refitted
MOST = 12
_POLISHED = 2
_NEAR = 60.0  # of the gain needed: terms that get slopes of their own
_ROUNDS = 6


def leading(structure: Sequence[Structure], needed: float = 0.0) -> list[Structure]:
    """The strongest terms inside the machine, a few of each point, of scored ones with the strongest first.

    Args:
        structure: scored terms.
        needed: gain that decides: terms whose linear gain is far from it, by share and by amount, are left out.
    """
    kept: list[Structure] = []
    inside = [item for item in structure if item.feature.form is not None]
    if not inside:
        return kept
    least = max(_LEAST_SHARE * inside[0].gain, min(_LEAST_SHARE * needed, needed - _NEAR))
    for item in inside:
        of_point = sum(other.feature.point == item.feature.point for other in kept)
        if of_point < _OF_A_POINT and item.gain > least:
            kept.append(item)
    return kept[:MOST]


def refit_terms(
    twin: Twin, at: Linearisation, items: Sequence[Structure], since_s: float | None = None
) -> list[Refit]:
    """Refits of terms with all parameters and initial states, best first.

    Args:
        twin: without them.
        at: health-only fit, whose metric is used.
        items: terms with their linear estimates.
        since_s: from when on they act [s]; None: always.

    Returns:
        Refits; gains are decreases of -2 log likelihood over `at`.
    """
    if not items:
        return []
    variables = {**twin.variables(at.fit.lanes()), "time_s": twin.time_s}
    ranked = []
    for item in items:
        form, point = item.feature.form, item.feature.point
        if form is None or point is None:
            continue
        form = replace(form, since_s=since_s)
        value = np.broadcast_to(form.value(variables), twin.time_s.shape)
        # the feature's signal has unit mean square, the form's has a unit
        coefficient = item.coefficient * float(item.feature.signal @ value) / float(value @ value)
        placed = (Placed(form, coefficient if form.fixed is None else form.fixed),)
        ranked.append(Ranked(point, item.feature.site, placed, item.gain, 0.0))
    refits = refit_all_laws(twin, at, at.fit.objective, ranked, variables)
    return sorted(refits, key=lambda refit: -refit.gain)


def leading_refits(
    twin: Twin, whitening: Whitening, at: Linearisation, structure: Sequence[Structure], needed: float,
    since_s: float | None = None,
) -> Iterator[Refit]:  # fmt: skip
    """The best terms without a name, refitted fully where they are near what is needed and short of it.

    Args:
        twin: without them.
        whitening: of its readings.
        at: health-only fit, whose metric is used.
        structure: scored terms, strongest first.
        needed: gain over the health-only fit that decides.
        since_s: from when on the terms act, as they were scored [s]; None: always.
    """
    for refit in refit_terms(twin, at, leading(structure, needed), since_s)[:_POLISHED]:
        if needed - _NEAR < refit.gain <= needed:
            full = fit_fully(refit.twin, whitening, refit.fit, rounds=_ROUNDS, frozen=at,  # type: ignore[arg-type]
                             ahead=at.fit.objective - needed)  # fmt: skip
            gain = at.fit.objective - full.fit.objective
            if gain > refit.gain:
                refit = replace(refit, fit=full.fit, gain=gain)
        yield refit
