"""Health now over health when the reference was recorded: what errors of the maps do to both cancels."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.learned import belief_of
from dieseltwin.discovery.twins.interface import Array, Twin
from dieseltwin.learning.belief import HEALTH_AT


def since_reference(at: Linearisation, twin: Twin, apart: Array) -> tuple[Array, Array] | None:
    """Quotients (P,) of the health parameters to the reference's and their standard deviations; None without one.

    Of several recordings each has its own health parameters, one recording's behind the other's.

    Args:
        at: the chosen explanation, linearised with what is still open of the engine as its nuisances.
        twin: without the explanation's own parameters, of which P are health.
        apart: (P,) by how much explanations that can't be told apart disagree [unit].
    """
    belief = belief_of(twin)
    if belief is None or at.loadings is None or at.nuisance_response is None:
        return None
    known, count = len(at.jacobian), len(twin.parameters)
    covariance = np.linalg.inv(at.joint()[1])
    seen = at.loadings[:, HEALTH_AT]
    unseen = np.diag(belief.covariance[HEALTH_AT, HEALTH_AT] - seen.T @ seen)  # directions that no reading here tells
    then = belief.health + at.metric.nuisance_estimate(np.nan_to_num(at.residual)) @ seen
    times = count // then.size
    seen, unseen, then = np.tile(seen, times), np.tile(unseen, times), np.tile(then, times)
    now = at.fit.parameters[:count]
    quotient, std = now / then, np.empty(count)
    for j in range(count):
        row = np.zeros(len(covariance))
        row[j] = 1.0 / then[j]
        row[known:] = -quotient[j] / then[j] * seen[:, j]
        rest = max(float(unseen[j]), 0.0) * (quotient[j] / then[j]) ** 2 + (apart[j] / then[j]) ** 2
        std[j] = np.sqrt(float(row @ covariance @ row) + rest)
    return quotient, std


def no_better_than_then(covariance: Array, parameters: Array, then: Array | None) -> Array:
    """The covariance (P, P) of the health parameters (P,), none known better than when the reference was recorded.

    A health parameter and the level of a map are one product, now as then, and a later recording can't tell them apart.

    Args:
        covariance, parameters: of the explanation, of one recording or one behind the other's.
        then: (4,) relative standard deviations when the reference was recorded [-], None without one.
    """
    if then is None:
        return covariance
    least = (np.tile(then, parameters.size // then.size) * parameters) ** 2
    return np.asarray(covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0)))
