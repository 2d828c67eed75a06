"""How rough the maps of an engine are: which correlation length its reference asks for.

Maps are believed smooth. An engine whose maps are rougher leaves residuals that no smooth correction takes up; learned
as smooth it has an alarm later, for what it always was. The variance of errors of half the correlation length is the
one under which the readings of the reference are most probable (Rasmussen & Williams, 2006, section 5.4.1).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import Belief, rougher

_TRIED = (0.1, 0.3, 1.0, 3.0)  # over the variance of the smooth errors
_AHEAD = 10.0  # of log evidence by which rougher maps must be more probable: odds of 20000


def roughness_of(prior: Belief, map_rms: float, information: Array, vector: Array) -> float:
    """Roughness of the maps (`learning.belief.prior_belief`) that the readings ask for, 0 where they don't [-].

    Args:
        prior: what is believed of smooth maps.
        map_rms: size of their errors [-].
        information, vector: (D, D) and (D,) of all coordinates, about the prior's mean, in their inverse units.
    """
    smooth = log_evidence(prior.covariance, information, vector)
    found = [(log_evidence(rougher(prior, map_rms, r).covariance, information, vector), r) for r in _TRIED]
    best, roughness = max(found)
    return roughness if best > smooth + _AHEAD else 0.0


def log_evidence(covariance: Array, information: Array, vector: Array) -> float:
    """Logarithm of the probability of readings, up to a constant, where coordinates have a covariance (D, D) before.

    Args:
        covariance: about the point from which `vector` counts.
        information: (D, D) of the readings; vector: (D,) information times the distance that they ask for.
    """
    scale = np.sqrt(np.diag(covariance))
    lower = cholesky(covariance / np.outer(scale, scale), lower=True)
    turned = lower.T @ (information * np.outer(scale, scale)) @ lower
    factor = cho_factor(np.eye(scale.size) + turned, lower=True)
    push = lower.T @ (scale * vector)
    return float(0.5 * push @ cho_solve(factor, push) - np.log(np.diag(factor[0])).sum())
