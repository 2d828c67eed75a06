"""What engines of one type say of the next one: their maps' errors are the type's and each engine's own.

The error of engine i over the basis of `engine.map_corrections` is t + o_i, with t common to the type and o_i its own,
both Gaussian and smooth alike; t has a declared share of the variance. What engine i was learned from is a
Gaussian factor over t + o_i (its posterior divided by its prior, with health and sensors integrated out). Integrating
o_i out leaves a factor over t; the factors multiply, so that the order of the engines doesn't matter (Gelman et al.,
Bayesian Data Analysis, 3rd edition, section 5.4, with vectors in place of scalars).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dieseltwin.engine import EngineParameters
from dieseltwin.learning.belief import MAPS_AT, NOTHING_FURTHER, Array, Belief, Further, prior_belief
from dieseltwin.least_squares import without_negative

_LEAST_SHARE = 1e-12  # where nothing is the type's


def belief_from_siblings(
    siblings: Sequence[tuple[Belief, Belief]], engine: EngineParameters, map_rms: float, type_share: float,
    further: Further = NOTHING_FURTHER,
) -> Belief:  # fmt: skip
    """What is believed of a new engine of a type of which some engines were learned.

    Args:
        siblings: of each, what was believed before anything was learned of it, and what is believed now.
        engine: base of the new one, with the same published maps.
        map_rms: size of the maps' smooth relative errors [-].
        type_share: of their variance that is the type's, 0-1 [-].
        further: errors of the maps of the type beyond the usual ones.
    """
    prior = prior_belief(engine, map_rms, further)
    believed = prior.covariance[MAPS_AT, MAPS_AT]
    own = (1.0 - type_share) * believed
    count = len(believed)
    information, vector = np.linalg.inv(believed) / max(type_share, _LEAST_SHARE), np.zeros(count)
    for before, after in siblings:
        seen, pushed = _factor(before, after)
        kept = np.linalg.inv(np.eye(count) + seen @ own)
        some = kept @ seen
        information += 0.5 * (some + some.T)
        vector += kept @ pushed
    of_type = np.linalg.inv(information)
    mean, covariance = prior.mean.copy(), prior.covariance.copy()
    mean[MAPS_AT] = of_type @ vector
    covariance[MAPS_AT, MAPS_AT] = 0.5 * (of_type + of_type.T) + own
    return Belief(mean, covariance)


def _factor(before: Belief, after: Belief) -> tuple[Array, Array]:
    """Information (K, K) and its vector (K,) of what was learned about the maps, health and sensors integrated out."""
    precisions = [np.linalg.inv(belief.covariance[MAPS_AT, MAPS_AT]) for belief in (before, after)]
    seen = without_negative(precisions[1] - precisions[0])
    return seen, precisions[1] @ after.coefficients - precisions[0] @ before.coefficients
