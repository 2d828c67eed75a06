"""What one recording of a healthy engine says, as a Gaussian factor over what is believed of the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import Belief


@dataclass(frozen=True)
class Evidence:
    """What one recording says, as a Gaussian factor over the coordinates of a belief.

    Attributes:
        information: (D, D) in inverse squared units of the coordinates, without any prior, about what all say.
        vector: (D,) information times the point at which the factor is largest.
        misfit: squared whitened residual a reading at the estimate; 1 for an engine that the maps can describe.
        readings: number of readings used.
        left_out: share of the windows in which what is believed doesn't act linearly, which were not used.
    """

    information: Array
    vector: Array
    misfit: float
    readings: int
    left_out: float


def combined(prior: Belief, evidence: Sequence[Evidence]) -> Belief:
    """The belief after some recordings; their order doesn't matter, to the last bit if they are sorted."""
    scale = np.sqrt(np.diag(prior.covariance))
    inverse = np.linalg.inv(prior.covariance / np.outer(scale, scale))
    information = inverse.copy()
    vector = inverse @ (prior.mean / scale)
    for item in evidence:
        information += item.information * np.outer(scale, scale)
        vector += item.vector * scale
    covariance = np.linalg.inv(information)
    covariance = 0.5 * (covariance + covariance.T)
    return Belief(scale * (covariance @ vector), covariance * np.outer(scale, scale))
