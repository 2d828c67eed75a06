"""Errors of an engine's maps beyond those that are believed of every engine, as its reference asks for them.

Maps are believed smooth, and the turbine's efficiency to be off by a function of speed and pressure ratio. An engine
whose maps are rougher, or whose turbine's efficiency is off by a function of its blade speed ratio and so changes with
the exhaust's temperature, leaves residuals that no usual correction takes up; learned without them it is distorted
into what comes nearest (more fuel, where the temperature is missing), and has an alarm later for what it always was.
The variances are those under which the readings of the reference are most probable (Rasmussen & Williams, 2006,
section 5.4.1).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import Belief, Further, with_further

_ROUGH = (0.0, 0.1, 0.3, 1.0, 3.0)  # over the variance of the usual errors
_OF_RATIO = (0.0, 0.3, 1.0)
_AHEAD = 10.0  # of log evidence by which maps must be more probable with a further kind of error: odds of 20000


def further_errors(prior: Belief, map_rms: float, information: Array, vector: Array) -> Further:
    """Errors of the maps beyond the usual ones that the readings ask for.

    Args:
        prior: what is believed of the usual ones.
        map_rms: size of their errors [-].
        information, vector: (D, D) and (D,) of all coordinates, about the prior's mean, in their inverse units.
    """
    tried = [Further(rough, of_ratio) for of_ratio in _OF_RATIO for rough in _ROUGH]

    def ahead(further: Further) -> float:
        kinds = (further.rough > 0.0) + (further.of_ratio > 0.0)
        return log_evidence(with_further(prior, map_rms, further).covariance, information, vector) - _AHEAD * kinds

    return max(tried, key=ahead)


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
