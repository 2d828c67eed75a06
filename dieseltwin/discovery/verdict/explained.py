"""The chosen explanation as one linearisation, and what those that can't be told from it say of health instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.likelihood.circumstances import open_circumstances
from dieseltwin.discovery.likelihood.fit import Fit, Linearisation, simulate_fits
from dieseltwin.discovery.likelihood.refit import scatter
from dieseltwin.discovery.search.nameless import law_about_itself
from dieseltwin.discovery.search.state import Search, occam
from dieseltwin.discovery.twins.interface import Array

_AS_STRONG = 0.5  # of the gain of the strongest term that is left


def explained_at(found: Search) -> Linearisation:
    """The chosen explanation, linearised about itself; a law's parameters stand behind those of the twin.

    Without a law the health-only fit speaks where no name fits: it is biased by what it leaves out.
    """
    if found.kind == "law" and found.law is not None:
        return law_about_itself(found, found.law)
    return found.best if found.best is not None and found.kind != "law" else found.null


def disagreement(found: Search, at: Linearisation) -> Array:
    """Standard deviation (P,) by which explanations that can't be told apart disagree about the parameters [unit].

    Beside it counts what the strongest terms that the explanation leaves would change.

    Args:
        at: the chosen explanation, as `explained_at`.
    """
    count = len(found.twin.parameters)
    if found.kind == "law" and found.law is not None:
        among = np.zeros(count) if found.law.disagreement is None else found.law.disagreement
    else:
        among = _among_explanations(found, lambda fits: np.array([fit.parameters[:count] for fit in fits]))
    moved = [step[:count] for _, step in _terms_beyond(found, at)]
    return np.hypot(among, _mean_size(moved, count))


def disagreement_of_circumstances(found: Search, at: Linearisation) -> Array:
    """The same (K,) of the circumstances that are open, in standard deviations of their priors.

    An effect that is missing in an explanation is met by weather: beside a p_em that read wrongly, its name withheld,
    ambient pressure was 5 kPa from the truth, and 0.4 was stated.
    """
    items = open_circumstances(found.twin)
    if not items or found.null.nuisance_response is None:
        return np.zeros(len(items))
    if found.kind == "law" and found.law is not None:
        among = np.zeros(len(items))
    else:
        among = _among_explanations(found, lambda fits: _circumstances_beside(found, fits))
    terms = [] if at.nuisance_response is None else _terms_beyond(found, at)
    left = (term.coefficient * term.response + np.tensordot(step, at.jacobian, 1) for term, step in terms)
    taken_up = [at.metric.nuisance_estimate(each)[-len(items) :] for each in left]
    return np.hypot(among, _mean_size(taken_up, len(items)))


def _circumstances_beside(found: Search, fits: Sequence[Fit]) -> Array:
    """Open circumstances (F, K) as fits leave them, in standard deviations of their priors."""
    count = len(open_circumstances(found.twin))
    left = np.nan_to_num(found.twin.measured - simulate_fits(found.twin, fits))
    return np.array([found.null.metric.nuisance_estimate(each)[-count:] for each in left])


def _among_explanations(found: Search, values: Callable[[Sequence[Fit]], Array]) -> Array:
    """Scatter of values (F, N) of fits, each explanation counted by its likelihood. Where something has neither name
    nor law, it is the most that a name changes which explains half as much as the best."""
    if found.kind == "healthy":
        return _beside_what_goes_unseen(found, values)
    if found.kind == "law":
        most = 0.5 * max((found.gain(fit) for fit in found.singles), default=0.0)
        said = values([found.null.fit, *(fit for fit in found.singles if found.gain(fit) >= most)])
        return np.asarray(np.abs(said - said[0]).max(axis=0))
    pool = found.fits_of(found.kind)
    fits = sorted((fit for fit in pool if fit.candidate.names in found.equivalent), key=lambda fit: fit.objective)
    if len(fits) < 2:  # one doesn't disagree with itself
        return np.zeros(1)
    said = values(fits)
    return scatter(said, said[0], np.array([fit.objective - fits[0].objective for fit in fits]))


def _beside_what_goes_unseen(found: Search, values: Callable[[Sequence[Fit]], Array]) -> Array:
    """Scatter of values (F, N) of fits where nothing raises an alarm, for an effect may be there all the same.

    Whoever asks has a reason: an engine is taken to be as likely faulty as not, by any of its effects. Each counts by
    its evidence, far below an alarm too: settled points with an injector that drifted by 6 % explained less than is
    asked, and eta_sc, which took it up, was ten of its deviations from the truth.
    """
    said = values([found.null.fit, *found.singles])
    each = -np.log(len(found.twin.hypotheses))
    evidence = np.array([0.0, *(occam(found, fit) + each for fit in found.singles)])
    return scatter(said, said[0], 2.0 * (evidence.max() - evidence))


def _terms_beyond(found: Search, at: Linearisation) -> list[tuple[Structure, Array]]:
    """The strongest terms beyond the explanation, which say the same with other words, and how each of them moves what
    the explanation has free (P,); none where nothing is found."""
    if found.kind == "healthy":
        return []
    left = sorted((*found.left, *found.left_local), key=lambda item: -item.held)
    kept = [item for item in left if item.held > max(found.settings.chance_leaves, _AS_STRONG * left[0].held)]
    if not kept:
        return []
    rows = at.metric.project(np.array([item.response for item in kept]))
    moved = -(rows @ at.projected.T) @ at.covariance
    return [(item, item.coefficient * step) for item, step in zip(kept, moved, strict=True)]


def _mean_size(changes: Sequence[Array], count: int) -> Array:
    """Root mean square (N,) over changes (N,), of which one is made; 0 for none."""
    return np.sqrt(np.mean(np.square(changes), axis=0)) if changes else np.zeros(count)
