"""Shooting with learned maps: a compiled simulator with them, and what their own uncertainty does to the readings.

One per cent of eta_tm or eta_c is four per cent of A_egrmax: a likelihood that believes learned maps to be exact is
sure and wrong. The members of each map show in which directions the readings may be off; noise along those directions
is added to the noise of the sensors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.engine import MEASURED, Actuation, Observations, ParameterBatch

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps

Index = NDArray[np.int_]


class LearnedSimulator:
    """A `shooting.Simulator` whose empirical maps are learned ones, in variants.

    Variant 0 has the nominal maps; each further one has a single map replaced by one of its members.

    Args:
        maps: improved maps (one hidden layer); the compiled simulator refuses others with an InputError.
    """

    def __init__(self, maps: EmpiricalMaps) -> None:
        self.maps = maps
        members = maps.members
        self.variants: list[dict[str, int]] = [{}]
        self.variants += [{name: 1 + m} for name in maps.maps for m in range(members)]
        self.scale = np.array(
            [0.0]
            + [maps.maps[name].spread / np.sqrt(max(members - 1, 1)) for name in maps.maps for _ in range(members)]
        )
        self._of_variant: dict[int, Callable[..., Observations]] = {}

    def __call__(
        self, actuations: Sequence[Actuation], batch: ParameterBatch, initial: Array, variant: Index
    ) -> Observations:
        """Simulate B lanes, each with the maps of its variant.

        Args:
            actuations: B actuations on one time grid.
            batch: B parameter sets.
            initial: (B, 3) p_im, p_em, omega_t at the start [Pa, Pa, rad/s].
            variant: (B,) index into `variants`.

        Returns:
            States (B, n, 5) and measured (B, n, C).
        """
        shape = (batch.size, len(actuations[0].time_s))
        states, measured = np.empty((*shape, 5)), np.empty((*shape, len(MEASURED)))
        for number in np.unique(variant):
            lanes = np.flatnonzero(variant == number)
            chosen = [actuations[i] for i in lanes.tolist()]
            part = self._simulator(int(number))(chosen, ParameterBatch(batch.values[:, lanes]), initial[lanes])
            states[lanes], measured[lanes] = part.states, part.measured
        return Observations(states, measured)

    def _simulator(self, number: int) -> Callable[..., Observations]:
        if number not in self._of_variant:
            from dieseltwin.surrogates.map_compiled import compiled_simulator

            self._of_variant[number] = compiled_simulator(self.maps, self.variants[number] or None)
        return self._of_variant[number]


@dataclass(frozen=True)
class ErrorDirections:
    """Errors of the model in the readings of one segment: independent amplitudes of unit variance along directions.

    With readings over sigma, the covariance is I + D D'. `whiten` applies its inverse square root.

    Attributes:
        basis: (N, K) orthonormal directions.
        shrink: (K,) share of the component along each that the inverse square root takes away [-].
    """

    basis: Array
    shrink: Array

    @classmethod
    def of(cls, directions: Array) -> ErrorDirections:
        """Make them from directions that need not be orthogonal.

        Args:
            directions: (N, M) effect of one standard deviation of each error on the readings over sigma [-].

        Returns:
            The directions that matter beside the noise.
        """
        basis, size, _ = np.linalg.svd(directions, full_matrices=False)
        kept = size > VISIBLE
        return cls(basis[:, kept], 1.0 - 1.0 / np.sqrt(1.0 + size[kept] ** 2))

    def whiten(self, rows: Array) -> Array:
        """Inverse square root of the covariance applied to the last axis.

        Args:
            rows: (.., N) residuals or sensitivities over sigma [-].

        Returns:
            (.., N) whitened rows.
        """
        return np.asarray(rows - ((rows @ self.basis) * self.shrink) @ self.basis.T)


VISIBLE = 0.03
"""Directions shorter than this [standard deviations of the noise, over the whole segment] change nothing."""
