"""Errors of an engine's maps beyond those that are believed of every engine, as its reference asks for them.

Maps are believed smooth, and the turbine's efficiency to be off by a function of speed and pressure ratio. An engine
whose maps are rougher, or whose turbine's efficiency is off by a function of its blade speed ratio and so changes with
the exhaust's temperature, leaves residuals that no usual correction takes up; learned without them it is distorted
into what comes nearest (more fuel, where the temperature is missing), and has an alarm later for what it always was.
One of another family is off by more than is believed: learned as if it weren't, its intervals are too narrow.
The variances are those under which the readings of the reference are most probable (Rasmussen & Williams, 2006,
section 5.4.1). How large errors are and over what length they are correlated is told by the same readings: small ones
of a short length leave what large ones of a long one leave. A length that is held shorter than it is has many functions
of which none is there, and the size that is most probable with it is too small by a fifth to two fifths; so sizes and
lengths are averaged by their probability.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import NOTHING_FURTHER, Belief, Further, with_further

_ROUGH = (0.0, 0.1, 0.3, 1.0, 3.0)  # over the variance of the usual errors
_OF_RATIO = (0.0, 0.3, 1.0)
_SIZES = (1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.5, 4.0, 5.0, 6.0)  # times what is believed
_WITHIN = (0.25, 0.5, 1.0)  # times what is believed: no larger errors
_LENGTHS = (1.0, 1.15, 1.3, 1.5)  # times what is believed, of errors larger than that
_STEP = 0.05  # to which an average is rounded: readings that change in the last digits ask for the same
_AHEAD = 10.0  # of log evidence by which maps must be more probable with a further kind of error: odds of 20000


def further_errors(
    prior: Belief, map_rms: float, information: Array, vector: Array, by_an_effect: Callable[[], tuple[float, float]]
) -> Further:
    """Errors of the maps beyond the usual ones that the readings ask for.

    Args:
        prior: what is believed of the usual ones.
        map_rms: size of their errors [-].
        information, vector: (D, D) and (D,) of all coordinates, about the prior's mean, in their inverse units.
        by_an_effect: log likelihood that the strongest effect of the catalogue gains beside the usual ones, and the
            strongest that one recording of several shows alone. Where the first is more than larger errors of all maps
            gain, or the second more than any others gain, the reference has that fault, and no further errors.
    """
    evidence: dict[Further, float] = {}

    def ahead(further: Further) -> float:
        if further not in evidence:
            evidence[further] = log_evidence(with_further(prior, map_rms, further).covariance, information, vector)
        kinds = (further.rough > 0.0) + (further.of_ratio > 0.0) + (further.size > 1.0)
        return evidence[further] - _AHEAD * kinds

    usual = max((Further(rough, of_ratio) for of_ratio in _OF_RATIO for rough in _ROUGH), key=ahead)
    sizes = [replace(usual, rough=rough, size=size) for size in _SIZES[::2] for rough in _ROUGH[1:]]
    sizes += [replace(usual, rough=0.0, size=size, smooth=length) for size in _SIZES for length in _LENGTHS]
    larger = max(sizes, key=ahead)
    # maps that hardly err are smooth to the eye: a longer length alone would pass for larger errors
    within = [replace(usual, rough=0.0, size=size, smooth=length) for size in _WITHIN for length in _LENGTHS]
    best = larger if ahead(larger) > max(map(ahead, (usual, *within))) else usual
    if best == NOTHING_FURTHER:
        return best
    gains = by_an_effect()
    if evidence[larger] - evidence[NOTHING_FURTHER] > max(gains) and best == larger:
        return _average({item: evidence[item] for item in sizes if item.rough == larger.rough})
    return usual if evidence[usual] - evidence[NOTHING_FURTHER] > gains[1] else NOTHING_FURTHER


def gain_of(further: Further, prior: Belief, map_rms: float, information: Array, vector: Array) -> float:
    """Decrease of -2 log evidence by further errors of the maps, arguments as of `further_errors`."""
    believed = (with_further(prior, map_rms, item).covariance for item in (further, NOTHING_FURTHER))
    more, usual = (log_evidence(covariance, information, vector) for covariance in believed)
    return 2.0 * (more - usual)


def _average(evidence: Mapping[Further, float]) -> Further:
    """Errors as large and as smooth as they are on average over kinds that differ in nothing else."""
    kinds, logs = list(evidence), np.array(list(evidence.values()))
    shares = np.exp(logs - logs.max()) / np.exp(logs - logs.max()).sum()
    size = float(shares @ np.square([item.size for item in kinds])) ** 0.5
    smooth = float(np.exp(shares @ np.log([item.smooth for item in kinds])))
    return replace(kinds[0], size=_rounded(size), smooth=_rounded(smooth))


def _rounded(value: float) -> float:
    return round(round(value / _STEP) * _STEP, 2)


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
