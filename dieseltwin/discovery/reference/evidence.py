"""What recordings of a healthy engine say: each as a Gaussian factor over what is believed, and all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dieseltwin.discovery.reference.conditions import Weather
from dieseltwin.discovery.reference.suspicion import Suspicion
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import Belief, Further
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.weather import Exponent


@dataclass(frozen=True)
class Evidence:
    """What one recording says, as a Gaussian factor over the coordinates of a belief.

    Attributes:
        information: (D, D) in inverse squared units of the coordinates, without any prior, about what all say.
        vector: (D,) information times the point at which the factor is largest.
        misfit: squared whitened residual a reading at the estimate; 1 for an engine that the maps can describe.
    """

    information: Array
    vector: Array
    misfit: float


@dataclass(frozen=True)
class Learned:
    """What some recordings say together.

    Attributes:
        belief: after all of them.
        evidence: of each, linearised about what all say.
        converged: whether all fits did, and linearising anew changed nothing worth naming.
        further: errors of the maps beyond the usual ones, as the recordings ask for them.
        suspicions: effects by which the reference itself looks faulty, strongest first.
        clocks: column -> how late it is recorded, of those whose clock is off [s].
        strange: weather and charge of a recording that lie where next to nobody drives.
        exponents: of the compressor by name, where the recordings are in different weather.
        faults: the main faults, each fitted beside maps that are believed to be off by no more than usual.
    """

    belief: Belief
    evidence: tuple[Evidence, ...]
    converged: bool
    further: Further
    suspicions: tuple[Suspicion, ...] = ()
    clocks: Mapping[str, float] = field(default_factory=dict)
    strange: tuple[Weather, ...] = ()
    faults: tuple[FaultBeside, ...] = ()
    exponents: Mapping[str, Exponent] = field(default_factory=dict)


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
