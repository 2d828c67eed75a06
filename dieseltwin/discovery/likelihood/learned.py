"""What was learned of an engine as directions of the likelihood: all that is still open of its maps and sensors.

The directions are columns of a factor of the belief's covariance, turned so that those come first which move the
readings of this recording; those that don't move them are left out. So a map is held where the reference drove and
free where it didn't, and what maps and sensors have in common is one direction, not two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, cast, runtime_checkable

import numpy as np

from dieseltwin.discovery.likelihood.metric import Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance, signal_responses, signs
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin, rows_of
from dieseltwin.discovery.twins.offers import Offer
from dieseltwin.engine import MEASURED
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, basis_along
from dieseltwin.engine.quantities import POINTS
from dieseltwin.learning.belief import GAINS_AT, MAPS_AT, OFFSETS_AT, Belief

_SMALL = 1e-5  # of a coefficient, for its response: as of health, which it is one product with, at kinks too
_RUNAWAY = 300.0  # of a middle reading: engines answer with up to some thirty times that, surging with 1e4 and more
_SEEN = 1e-2  # of squared whitened response to one standard deviation: a tenth of the noise of one reading


@runtime_checkable
class LearnedTwin(Offer, Protocol):
    """A twin that may know its engine.

    Attributes:
        belief: what was learned, None for nothing.
        deviation: (K,) by how much the simulated corrections differ from the belief's mean.
        moved: (n, C) linear response to `deviation`, which `measured` contains, so that what is believed stays centred
            at the belief's mean.
    """

    belief: Belief | None
    deviation: Array
    moved: Array

    def deviating(self, deviation: Array, moved: Array) -> Twin:
        """The twin about other corrections."""
        ...


def belief_of(twin: Twin) -> Belief | None:
    """What a twin has learned of its engine, None for nothing."""
    return twin.belief if isinstance(twin, LearnedTwin) else None


def map_columns(twin: Twin, lanes: Lanes, simulated: Array, which: np.ndarray) -> Array:
    """Responses (F, n, C) of the readings to the coefficients of the corrections, next to one lane.

    Args:
        twin: bound to its recording.
        lanes: one; simulated: its readings (n, C).
        which: (K,) whose F responses are asked.
    """
    points = [POINTS.index(CORRECTED_POINTS[m]) for m in basis().maps[which]]
    signals = _SMALL * basis_along(twin.variables(lanes), which)
    return signal_responses(twin, lanes, simulated, points, signals, linear=True) / _SMALL


def running_away(twin: Twin, simulated: Array, *responses: Array) -> np.ndarray:
    """Rows (n,) of the windows in which responses (..., n, C), to a map that is off by itself or to a state by its
    scale, go beyond all readings (n, C): there small differences grow from row to row, and linear says nothing."""
    most = _RUNAWAY * np.median(np.abs(simulated), axis=0)
    far = np.any([~(np.abs(some) < most).all(axis=(0, 2)) for some in responses], axis=0)
    return rows_of(twin, np.logical_or.reduceat(far, twin.starts))


def learned_nuisances(
    twin: Twin, belief: Belief, lanes: Lanes, simulated: Array, whitening: Whitening, of_free: Array | None = None
) -> list[Nuisance]:
    """Directions of what is still open, one standard deviation each.

    Args:
        twin: bound to its recording; belief: its own.
        lanes: one, next to which the responses are taken; simulated: its readings (n, C).
        whitening: of the readings.
        of_free: `map_columns` of what is free there, where they are known.
    """
    known = map_columns(twin, lanes, simulated, belief.free) if of_free is None else of_free
    told, maps = _telling(twin, belief), len(known)
    columns = np.zeros((told.size, *simulated.shape))
    columns[:maps] = known
    columns[:maps, running_away(twin, simulated, known)] = 0.0
    for j, name in enumerate(twin.channels):
        factor = 1.0 / (1.0 + belief.gains[MEASURED.index(name)])
        columns[maps + 2 * j, :, j] = factor * simulated[:, j]
        columns[maps + 2 * j + 1, :, j] = factor
    whitened = whitening.apply(columns)
    factor_of_belief = belief.factor
    seen, turn = np.linalg.eigh(factor_of_belief[told].T @ (whitened @ whitened.T) @ factor_of_belief[told])
    loadings = (factor_of_belief @ turn[:, seen > _SEEN][:, ::-1]).T
    loadings *= signs(loadings)[:, None]
    of_maps = np.tensordot(loadings[:, told[:maps]], columns[:maps], 1)
    responses = of_maps.copy()
    for j in range(len(twin.channels)):  # a sensor's errors move its own channel alone
        own = slice(maps + 2 * j, maps + 2 * j + 2)
        responses[:, :, j] += loadings[:, told[own]] @ columns[own, :, j]
    return [
        Nuisance(f"learned {k + 1}", response=responses[k], loading=loadings[k], of_maps=of_maps[k])
        for k in range(len(loadings))
    ]


def _telling(twin: Twin, belief: Belief) -> np.ndarray:
    """Places (F + 2 C,) of the coordinates of a belief that readings answer to: of the maps those that are free, then
    the gain and the offset of each channel. All others move nothing, and most of the maps' are none of these."""
    channels = [MEASURED.index(name) for name in twin.channels]
    sensors = [at.start + channel for channel in channels for at in (GAINS_AT, OFFSETS_AT)]
    return np.array([*(MAPS_AT.start + np.flatnonzero(belief.free)), *sensors], dtype=np.int64)


def loadings_of(nuisances: Sequence[Nuisance]) -> Array | None:
    """Loadings (K, D) of directions of what was learned; None for other directions."""
    found = [nuisance.loading for nuisance in nuisances if nuisance.loading is not None]
    return np.stack(found) if found and len(found) == len(nuisances) else None


def about(twin: Twin, lanes: Lanes, nuisances: Sequence[Nuisance], estimate: Array) -> tuple[Twin, Array, Array]:
    """The twin about an estimate of its maps, with the readings moved by the responses taken there.

    Args:
        twin: that has learned something.
        lanes: one, next to which the responses are taken.
        nuisances, estimate: directions, and (K,) where along them in standard deviations.

    Returns:
        The twin, its simulation of the lane (n, C), and the responses there as of `map_columns`.
    """
    known = cast(LearnedTwin, twin)
    deviation = np.tensordot(estimate, np.stack([n.loading for n in nuisances]), 1)[MAPS_AT]  # type: ignore[misc]
    other = known.deviating(deviation, np.zeros_like(twin.measured))
    free = cast(Belief, known.belief).free
    simulated = other.simulate(lanes)[0]
    columns = map_columns(other, lanes, simulated, free)
    return known.deviating(deviation, np.tensordot(deviation[free], columns, 1)), simulated, columns


def rebased_learned(twin: Twin, nuisances: Sequence[Nuisance], estimate: Array) -> Twin:
    """As `about`, with the responses that the nuisances have, for metrics that are made of these."""
    if not isinstance(twin, LearnedTwin) or not nuisances:
        return twin
    deviation = np.tensordot(estimate, np.stack([n.loading for n in nuisances]), 1)[MAPS_AT]  # type: ignore[misc]
    return twin.deviating(deviation, np.tensordot(estimate, np.stack([n.of_maps for n in nuisances]), 1))  # type: ignore[misc]
