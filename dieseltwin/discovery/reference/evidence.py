"""What recordings of a healthy engine say: each as a Gaussian factor over what is believed, and all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri, fdtri

from dieseltwin.discovery.reference.conditions import Weather
from dieseltwin.discovery.reference.suspicion import Suspicion
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import Belief, Further
from dieseltwin.learning.faults import FaultBeside
from dieseltwin.learning.weather import Exponent
from dieseltwin.settings.discovery import LearnConfig


@dataclass(frozen=True)
class Evidence:
    """What one recording says, as a Gaussian factor over the coordinates of a belief.

    Attributes:
        information: (D, D) in inverse squared units of the coordinates, without any prior, about what all say.
        vector: (D,) information times the point at which the factor is largest.
        misfit: squared whitened residual at the estimate over `freedom`; 1 for an engine that the maps can describe.
        freedom: readings less what the fit's coordinates follow of them. Initial states and circumstances, which have
            priors of their own, count for nothing.
        noise_freedom: degrees of freedom from which its noise is known; infinite where rows tell it.
    """

    information: Array
    vector: Array
    misfit: float
    freedom: float
    noise_freedom: float


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

    def misfit_marks(self, settings: LearnConfig) -> tuple[float, ...]:
        """Misfit of each recording, above which it is of another engine or of one that wasn't well.

        Few readings leave more than many by chance alone, as chi-square over its degrees of freedom: of six, one
        recording in seven leaves 1.6 times what is expected. It is F's distribution where few tell the noise, too.
        """
        level = settings.misfit_level / max(len(self.evidence), 1)  # of all recordings none may be refused by chance

        def by_chance(item: Evidence) -> float:
            if np.isinf(item.noise_freedom):
                return float(chdtri(item.freedom, level)) / item.freedom
            return float(fdtri(item.freedom, item.noise_freedom, 1.0 - level))

        return tuple(max(settings.misfit_max, by_chance(item)) for item in self.evidence)


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
