"""The chosen explanation as one linearisation, and what those that can't be told from it say of health instead."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.likelihood.refit import scatter
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array

_AS_STRONG = 0.5  # of the gain of the strongest term that is left


def explained_at(found: Search) -> Linearisation:
    """The chosen explanation, linearised about itself; a law's parameters stand behind those of the twin.

    Without a law the health-only fit speaks where no name fits: it is biased by what it leaves out.
    """
    null = found.null
    if found.kind == "law" and found.law is not None:
        twin, values = found.law.on(found.twin)
        fit = Fit(Candidate(), values, np.zeros(0), found.law.local, np.inf, True)
        try:
            return Linearisation(twin, null.whitening, fit, None, null.nuisance_response, null.loadings)
        except np.linalg.LinAlgError:  # the machine runs away with some tolerance there
            return Linearisation(twin, null.whitening, fit, null)
    return found.best if found.best is not None and found.kind != "law" else null


def disagreement(found: Search, at: Linearisation) -> Array:
    """Standard deviation (P,) by which explanations that can't be told apart disagree about the parameters [unit].

    Beside it counts what the strongest terms that the explanation leaves would change.

    Args:
        at: the chosen explanation, as `explained_at`.
    """
    if found.kind == "healthy":
        return np.zeros(len(found.twin.parameters))
    return np.hypot(_among_explanations(found), _beyond_explanation(found, at))


def _among_explanations(found: Search) -> Array:
    """Each explanation counts by its likelihood. Where something has neither name nor law, it is what the best name
    changes."""
    count = len(found.twin.parameters)
    if found.kind == "law":
        if found.law is not None:
            return np.zeros(count) if found.law.disagreement is None else found.law.disagreement
        away = [fit.parameters[:count] - found.null.fit.parameters[:count] for fit in found.singles[:1]]
        return np.abs(away[0]) if away else np.zeros(count)
    pool = {"pair": found.pairs, "variant": [fit for _, fit in found.variants]}.get(found.kind, found.singles)
    fits = sorted((fit for fit in pool if fit.candidate.names in found.equivalent), key=lambda fit: fit.objective)
    if not fits:
        return np.zeros(count)
    values = np.array([fit.parameters[:count] for fit in fits])
    return scatter(values, values[0], np.array([fit.objective - fits[0].objective for fit in fits]))


def _beyond_explanation(found: Search, at: Linearisation) -> Array:
    """What the strongest terms beyond the explanation change: they say the same with other words, so one of them."""
    count = len(found.twin.parameters)
    left = sorted((*found.left, *found.left_local), key=lambda item: -item.held)
    kept = [item for item in left if item.held > max(found.settings.chance_leaves, _AS_STRONG * left[0].held)]
    if not kept:
        return np.zeros(count)
    rows = at.metric.project(np.array([item.response for item in kept]))
    moved = -(rows @ at.projected.T) @ at.covariance
    apart = moved[:, :count] * np.array([item.coefficient for item in kept])[:, None]
    return np.asarray(np.sqrt(np.mean(apart**2, axis=0)))
