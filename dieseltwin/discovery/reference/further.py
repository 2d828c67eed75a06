"""Errors of an engine's maps beyond those that are believed of every engine, as its reference asks for them.

Maps are believed smooth, and the turbine's efficiency to be off by a function of speed and pressure ratio. An engine
whose maps are rougher, or whose turbine's efficiency is off by a function of its blade speed ratio and so changes with
the exhaust's temperature, leaves residuals that no usual correction takes up; learned without them it is distorted
into what comes nearest (more fuel, where the temperature is missing), and has an alarm later for what it always was.
One of another family is off by more than is believed: learned as if it weren't, its intervals are too narrow.
The variances are those under which the readings of the reference are most probable (Rasmussen & Williams, 2006,
section 5.4.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import NOTHING_FURTHER, Belief, Further, with_further

_ROUGH = (0.0, 0.1, 0.3, 1.0, 3.0)  # over the variance of the usual errors
_OF_RATIO = (0.0, 0.3, 1.0)
_SIZES = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)  # times what is believed
_AHEAD = 10.0  # of log evidence by which maps must be more probable with a further kind of error: odds of 20000


def further_errors(
    prior: Belief, map_rms: float, information: Array, vector: Array, by_an_effect: Callable[[], float]
) -> Further:
    """Errors of the maps beyond the usual ones that the readings ask for.

    Args:
        prior: what is believed of the usual ones.
        map_rms: size of their errors [-].
        information, vector: (D, D) and (D,) of all coordinates, about the prior's mean, in their inverse units.
        by_an_effect: log likelihood that the strongest effect of the catalogue gains beside the usual ones. Where it is
            more than larger errors of all maps gain, the reference has that fault, and no larger errors.
    """
    evidence: dict[Further, float] = {}

    def ahead(further: Further) -> float:
        if further not in evidence:
            evidence[further] = log_evidence(with_further(prior, map_rms, further).covariance, information, vector)
        kinds = (further.rough > 0.0) + (further.of_ratio > 0.0) + (further.size > 1.0)
        return evidence[further] - _AHEAD * kinds

    usual = max((Further(rough, of_ratio) for of_ratio in _OF_RATIO for rough in _ROUGH), key=ahead)
    larger = max((replace(usual, rough=rough, size=size) for size in _SIZES for rough in _ROUGH), key=ahead)
    if ahead(larger) > ahead(usual) and evidence[larger] - evidence[NOTHING_FURTHER] > by_an_effect():
        return larger
    return usual


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
