"""A belief about an engine: mean and joint covariance of its health, its maps' corrections and its sensors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky

from dieseltwin.engine import HEALTH, HEALTH_UNITS, MEASURED, EngineParameters
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import SENSOR_UNITS, corrections_in, without_corrections
from dieseltwin.least_squares import symmetric_root
from dieseltwin.sensors import SENSORS

Array = np.ndarray

HEALTH_PRIOR = 0.3
"""Standard deviation of a health parameter about the engine file's value [-]."""

SENSOR_GAIN, SENSOR_OFFSET = 0.005, 0.003
"""Standard deviation of a sensor's gain [-], and of its offset as a share of the channel's usual reading [-]: an
offset is a property of the sensor, not of what was driven."""


HELD = 1e-6
"""Standard deviation of a further function's coefficient where none is believed: so small that none shows [-]."""


@dataclass(frozen=True)
class Further:
    """Errors of the maps beyond the smooth ones over their usual arguments that are believed of every engine [-].

    Attributes:
        rough: variance of errors of all maps of half the correlation length, over that of the smooth ones.
        of_ratio: the same of errors of the turbine's efficiency over speed and blade speed ratio.
        size: of the smooth ones, times what is believed.
        smooth: their correlation length, times what is believed.
    """

    rough: float = 0.0
    of_ratio: float = 0.0
    size: float = 1.0
    smooth: float = 1.0


NOTHING_FURTHER = Further()


def coordinate_names() -> tuple[str, ...]:
    """Names of a belief's coordinates: health, coefficients of the corrections, gains, offsets."""
    return (
        *HEALTH, *basis().names, *(f"gain {name}" for name in MEASURED), *(f"offset {name}" for name in MEASURED)
    )  # fmt: skip


def coordinate_units() -> tuple[str, ...]:
    """Units of `coordinate_names`."""
    return (
        *(HEALTH_UNITS[name] for name in HEALTH), *("-" for _ in basis().names), *("-" for _ in MEASURED),
        *(SENSOR_UNITS[name] for name in MEASURED),
    )  # fmt: skip


HEALTH_AT = slice(0, len(HEALTH))
MAPS_AT = slice(len(HEALTH), len(HEALTH) + len(basis().names))
GAINS_AT = slice(MAPS_AT.stop, MAPS_AT.stop + len(MEASURED))
OFFSETS_AT = slice(GAINS_AT.stop, GAINS_AT.stop + len(MEASURED))


@dataclass(frozen=True)
class Belief:
    """A Gaussian over the D coordinates of `coordinate_names`.

    Attributes:
        mean: (D,) in the units of `coordinate_units`.
        covariance: (D, D).
    """

    mean: Array
    covariance: Array

    @property
    def health(self) -> Array:
        """Mean of the health parameters, (4,)."""
        return self.mean[HEALTH_AT]

    @property
    def coefficients(self) -> Array:
        """Mean of the corrections' coefficients, (K,) [-]."""
        return self.mean[MAPS_AT]

    @property
    def free(self) -> np.ndarray:
        """(K,) which of the corrections' functions may be there at all."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[MAPS_AT]) > 2.0 * HELD)

    @property
    def gains(self) -> Array:
        """Mean relative error of every sensor, (C,) [-]."""
        return self.mean[GAINS_AT]

    @property
    def offsets(self) -> Array:
        """Mean offset of every sensor, (C,) [unit of the column]."""
        return self.mean[OFFSETS_AT]

    @property
    def open(self) -> np.ndarray:
        """(D,) the coordinates without the functions that aren't free."""
        out = np.ones(self.mean.size, dtype=bool)
        out[MAPS_AT] = self.free
        return out

    @cached_property
    def factor(self) -> Array:
        """(D, F) whose product with its transpose is the covariance of the F coordinates that are open."""
        which = self.open
        covariance = self.covariance[np.ix_(which, which)]
        scale = np.sqrt(np.diag(covariance))
        out = np.zeros((which.size, scale.size))
        out[which] = scale[:, None] * symmetric_root(covariance / np.outer(scale, scale))
        return out

    def truthful(self, readings: Array) -> Array:
        """Readings (..., C) of the sensors -> what they would be without the sensors' mean errors."""
        return (readings - self.offsets) / (1.0 + self.gains)


def prior_belief(engine: EngineParameters, map_rms: float, further: Further = NOTHING_FURTHER) -> Belief:
    """What is believed before any recording.

    Args:
        engine: gives the means of the health parameters.
        map_rms: size of the maps' smooth relative errors [-].
        further: errors of the maps beyond those.
    """
    health = np.array(engine.health())
    mean = np.zeros(OFFSETS_AT.stop)
    mean[HEALTH_AT] = health
    std = np.concatenate([
        HEALTH_PRIOR * health, np.where(basis().usual, map_rms, HELD), np.full(len(MEASURED), SENSOR_GAIN),
        SENSOR_OFFSET * np.array([sensor.usual for sensor in SENSORS]),
    ])  # fmt: skip
    return with_further(Belief(mean, np.diag(std**2)), map_rms, further)


def about_corrections(engine: EngineParameters, map_rms: float) -> tuple[EngineParameters, Belief | None]:
    """An engine without the corrections of its maps, and what is believed about these before any recording; None where
    it has none. Arguments as of `prior_belief`."""
    corrections = corrections_in(engine.terms)
    if corrections is None:
        return engine, None
    bare = engine.replace(terms=without_corrections(engine.terms))
    usual = prior_belief(bare, map_rms)
    mean = usual.mean.copy()
    mean[MAPS_AT] = corrections
    return bare, Belief(mean, usual.covariance)


def is_about_corrections(prior: Belief, engine: EngineParameters, map_rms: float) -> bool:
    """Whether a belief is that of `about_corrections`, as unsure as of any engine; arguments as of `prior_belief`."""
    return np.array_equal(prior.covariance, prior_belief(engine, map_rms).covariance)


def with_further(belief: Belief, map_rms: float, further: Further) -> Belief:
    """A belief with further errors of the maps; arguments as of `prior_belief`."""
    if further == NOTHING_FURTHER:
        return belief
    covariance, functions = belief.covariance.copy(), basis()
    of_unit_rms = further.rough * functions.finer_covariance + further.of_ratio * np.diag(functions.of_ratio)
    larger = np.where(functions.usual, further.size, 1.0)[:, None]
    if further.smooth > 1.0:
        larger = larger * cholesky(functions.smoother(further.smooth), lower=True)
    else:
        larger = larger * np.eye(functions.usual.size)
    covariance[MAPS_AT] = larger @ covariance[MAPS_AT]
    covariance[:, MAPS_AT] = covariance[:, MAPS_AT] @ larger.T
    covariance[MAPS_AT, MAPS_AT] += (further.size * map_rms) ** 2 * of_unit_rms
    return Belief(belief.mean, covariance)
