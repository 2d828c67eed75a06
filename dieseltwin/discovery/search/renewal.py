"""What was learned of the maps, linearised about the leading explanation where that is more than one constant effect.

Single effects are compared with the likelihood about the strongest of them. Where two act, or one at times, that is a
wrong explanation: the maps were bent to what it leaves, and from there the right one pays for bending them back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dieseltwin.discovery.likelihood.fit import Fit, fit_fully
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.search.alarms import score_terms
from dieseltwin.discovery.search.explanations import leading_kind
from dieseltwin.discovery.search.preparation import prepared_about
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.search.variant_fits import in_order, scan_all, try_variants

BENDS = 60.0
"""Gain from which what was learned of the maps is linearised about the explanation."""

_RENEWALS = 3
_ROUNDS = 6
_FITTED_ANEW = 3  # of each kind; the others keep their share of the leading one's gain, and so do those that gain
_IN_REACH = 0.5  # less than this share of the leading one's gain
_OVERTAKING = 60.0  # more than any freedom costs: a fit that can't come so near to the leading one isn't followed
_SETTLED = 1.0  # standard deviations of a size


def about_the_leader(found: Search) -> bool:
    """Renew the likelihood about the leading explanation until that stays as it is; whether it was renewed.

    Where another one leads after the last renewal, both are noted as `unsettled`: neither name is given alone.
    """
    if belief_of(found.twin) is None:
        return False
    renewed = False
    for renewal in range(_RENEWALS):
        _, kind, lead, _ = leading_kind(found)
        if kind == "single" or found.gain(lead) < BENDS:
            break
        renewed = True
        _renew(found, kind, lead)
        after = leading_kind(found)[2]
        same = after.candidate.names == lead.candidate.names
        if same and _alike(lead, after, len(found.twin.parameters)):
            break
        if not same and renewal == _RENEWALS - 1:
            found.unsettled = [*found.unsettled, lead.candidate.names, after.candidate.names]
    if renewed:
        score_terms(found, found.null)
    return renewed


def _alike(one: Fit, other: Fit, parameters: int) -> bool:
    away = np.abs(other.magnitudes - one.magnitudes)
    return bool(np.all(away < _SETTLED * np.nan_to_num(other.std[parameters:])))


def _renew(found: Search, kind: str, lead: Fit) -> None:
    """Everything that was compared, in the metric of a health-only fit with the maps about one explanation."""
    fresh = prepared_about(found, lead)
    bar = found.null.fit.objective - _IN_REACH * found.gain(lead)
    first = fresh.refitted(lead, _ROUNDS)
    move = partial(_moved, found, fresh, first=(lead, first), bar=bar)
    fresh.singles = _by_objective(move(found.singles))
    fresh.pairs = _by_objective(move(found.pairs))
    moved = move([fit for _, fit in found.variants])
    timed = [(variant, fit) for (variant, _), fit in zip(found.variants, moved, strict=True)]
    fresh.variants = in_order(fresh, timed)
    if kind == "variant":  # where and when it acts was read off bent maps
        fresh.scanned = scan_all(fresh.null, fresh.scored, found.settings.least_share)
        try_variants(fresh)
    found.twin, found.null, found.nuisances, found.about = fresh.twin, fresh.null, fresh.nuisances, fresh.about
    found.scored, found.chance = fresh.scored, fresh.chance
    found.singles, found.pairs, found.variants = fresh.singles, fresh.pairs, fresh.variants
    found.simulated_errors = fresh.simulated_errors


def _moved(found: Search, fresh: Search, fits: Sequence[Fit], first: tuple[Fit, Fit], bar: float) -> list[Fit]:
    """Fits in the new metric: those that lead from where they were, the others with their share of the leading gain.

    With the gain that they had, they were ahead of all that was fitted anew, wherever health alone is less bad there.

    Args:
        found, fresh: before, and in the new metric.
        first: the leading explanation in both.
        bar: objective of those that are fitted anew, in the old metric.
    """
    moved = []
    share = max(fresh.gain(first[1]), 0.0) / max(found.gain(first[0]), 1e-9)
    for k, fit in enumerate(fits):
        if fit is first[0]:
            moved.append(first[1])
        elif k < _FITTED_ANEW and fit.objective < bar:
            ahead = first[1].objective + _OVERTAKING
            moved.append(fit_fully(fresh.twin, fresh.whitening, fit, None, _ROUNDS, fresh.null, ahead=ahead).fit)
        else:
            moved.append(replace(fit, objective=fresh.null.fit.objective - share * found.gain(fit)))
    return moved


def _by_objective(fits: Sequence[Fit]) -> list[Fit]:
    return sorted(fits, key=lambda fit: fit.objective)
