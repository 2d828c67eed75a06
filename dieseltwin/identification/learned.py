"""Shooting with learned maps: the compiled simulator with each lane's own member of the maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine import Actuation, Observations, ParameterBatch

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps

NOMINAL = 0
"""Member number of the nominal maps; the members themselves count from 1."""


class LearnedSimulator:
    """A `shooting.Simulator` whose empirical maps are learned ones.

    Args:
        maps: improved maps (one hidden layer); the compiled simulator refuses others with an InputError.
    """

    def __init__(self, maps: EmpiricalMaps) -> None:
        self.maps = maps
        self._of_member: dict[int, Callable[..., Observations]] = {}

    def __call__(
        self,
        actuations: Sequence[Actuation],
        batch: ParameterBatch,
        initial: NDArray[np.float64],
        member: NDArray[np.int_],
    ) -> Observations:
        """Simulate B lanes, each with the maps of its member.

        Args:
            actuations: B actuations on one time grid.
            batch: B parameter sets.
            initial: (B, 3) p_im, p_em, omega_t at the start [Pa, Pa, rad/s].
            member: (B,) `NOMINAL` or a member's number.

        Returns:
            States (B, n, 5) and measured (B, n, 6).
        """
        shape = (batch.size, len(actuations[0].time_s))
        states, measured = np.empty((*shape, 5)), np.empty((*shape, 6))
        for number in np.unique(member):
            lanes = np.flatnonzero(member == number)
            part = self._simulator(int(number))(
                [actuations[i] for i in lanes.tolist()], ParameterBatch(batch.values[:, lanes]), initial[lanes]
            )
            states[lanes], measured[lanes] = part.states, part.measured
        return Observations(states, measured)

    def members(self, runs: int) -> NDArray[np.int_]:
        """Members of the runs: a single run takes the nominal maps, several go through the members in turn.

        Args:
            runs: number of runs R.

        Returns:
            (R,) member numbers.
        """
        if runs == 1 or self.maps.members == 0:
            return np.full(runs, NOMINAL)
        return 1 + np.arange(runs) % self.maps.members

    def _simulator(self, number: int) -> Callable[..., Observations]:
        if number not in self._of_member:
            from dieseltwin.surrogates.map_compiled import compiled_simulator

            self._of_member[number] = compiled_simulator(self.maps, None if number == NOMINAL else number)
        return self._of_member[number]
