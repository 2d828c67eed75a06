"""What a recording leaves in the history of its engine: health, and an estimate of the size of every effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.likelihood.score import Scored
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.verdict.over_recordings import health_places
from dieseltwin.learning.alarm import Score
from dieseltwin.learning.belief import Belief


@dataclass(frozen=True)
class Observed:
    """One recording in the coordinates of what was learned of its engine.

    Attributes:
        health, health_covariance: (4,) and (4, 4) of the chosen explanation.
        since, since_std: (4,) health over that of the reference [-].
        scores: of every effect, at the fit of health alone.
    """

    health: Array
    health_covariance: Array
    since: Array
    since_std: Array
    scores: tuple[Score, ...]


def observed(
    found: Search, after: tuple[Array, Array | None], since: tuple[Array, Array] | None
) -> Observed | None:
    """What a search on one recording leaves; None where nothing was learned of the engine before.

    Args:
        found: the search; after: free parameters of its explanation and their covariance.
        since: what became of them since the reference, and standard deviations.
    """
    belief = belief_of(found.twin)
    if belief is None or since is None or after[1] is None:
        return None
    at = health_places(found.twin)
    return Observed(after[0][at], after[1][np.ix_(at, at)], since[0][at], since[1][at], scores_of(found, belief))


def scores_of(found: Search, belief: Belief) -> tuple[Score, ...]:
    """Linear estimate of every effect where all were scored, and what it owes to noise and to maps and sensors.

    The estimate is a product of the readings with a vector that no health parameter, initial state or open direction
    of maps and sensors moves beyond its prior; what is left of a direction is that vector's row of the prior.
    """
    at = found.scored_at
    if at.loadings is None:
        return ()
    scale = np.sqrt(np.diag(belief.covariance))
    values, vectors = np.linalg.eigh(belief.covariance / np.outer(scale, scale))
    kept = values > 1e-12 * values[-1]
    turned = (vectors[:, kept] / np.sqrt(values[kept])).T @ (at.loadings / scale).T  # in the belief's own directions
    out: dict[str, Score] = {}
    for item in found.scored:
        if item.name not in out and (score := _score(found, at, item, turned)) is not None:
            out[item.name] = score
    return tuple(out.values())


def _score(found: Search, at: Linearisation, item: Scored, turned: Array) -> Score | None:
    information = float(item.projected @ item.projected)
    if not np.isfinite(item.std) or information <= 0.0:
        return None
    shared = turned @ (-item.projected[at.metric.rows :][: turned.shape[1]] / information)
    variance = max(1.0 / information - float(shared @ shared), 0.0)
    hypothesis = found.twin.hypotheses[item.name]
    estimate = float(item.projected @ at.pulled_residual) / information
    return Score(
        item.name, hypothesis.site, hypothesis.unit, hypothesis.tolerance, hypothesis.sign > 0.0, estimate,
        float(np.sqrt(variance)), shared,
    )  # fmt: skip
