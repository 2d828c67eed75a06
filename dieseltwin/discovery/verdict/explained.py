"""The chosen explanation as one linearisation, and what those that can't be told from it say of health instead."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Candidate, Fit, Linearisation
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array


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


def disagreement(found: Search) -> Array:
    """Standard deviation (P,) by which explanations that can't be told apart disagree about the parameters [unit].

    Each counts by its likelihood. Where something has neither name nor law, it is what the
    best name changes.
    """
    count = len(found.twin.parameters)
    if found.kind == "healthy" or (found.kind == "law" and found.law is not None):
        return np.zeros(count)
    if found.kind == "law":
        away = [fit.parameters[:count] - found.null.fit.parameters[:count] for fit in found.singles[:1]]
        return np.abs(away[0]) if away else np.zeros(count)
    pool = {"pair": found.pairs, "variant": [fit for _, fit in found.variants]}.get(found.kind, found.singles)
    fits = sorted((fit for fit in pool if fit.candidate.names in found.equivalent), key=lambda fit: fit.objective)
    if len(fits) < 2:
        return np.zeros(count)
    weights = np.exp(-0.5 * np.array([fit.objective - fits[0].objective for fit in fits]))
    apart = np.array([fit.parameters[:count] - fits[0].parameters[:count] for fit in fits])
    return np.asarray(np.sqrt((weights[:, None] * apart**2).sum(axis=0) / weights.sum()))
