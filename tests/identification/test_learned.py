"""Classical estimation with learned maps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dieseltwin.engine import Observations, actuate, parameter_batch, simulate_states, we2011
from dieseltwin.identification import SegmentProblem
from dieseltwin.identification.learned import NOMINAL, LearnedSimulator


class Maps:
    """Stands for trained maps with three members."""

    members = 3


@pytest.fixture
def simulator(monkeypatch: pytest.MonkeyPatch) -> LearnedSimulator:
    """A simulator whose member m is the exact engine with all readings raised by m; compiling maps takes a minute."""
    from dieseltwin.surrogates import map_compiled

    def stand_in(maps: Maps, member: int | None = None) -> Callable[..., Observations]:
        def simulate(*arguments: object) -> Observations:
            exact = simulate_states(*arguments)  # type: ignore[arg-type]
            return Observations(exact.states, exact.measured + (0 if member is None else member))

        return simulate

    monkeypatch.setattr(map_compiled, "compiled_simulator", stand_in)
    return LearnedSimulator(Maps())  # type: ignore[arg-type]


def test_each_lane_gets_its_own_member(simulator: LearnedSimulator, problem: SegmentProblem) -> None:
    actuation = actuate(problem.inputs, we2011.PARAMETERS)
    batch = parameter_batch(we2011.PARAMETERS, A_vgtmax=np.linspace(7e-4, 9e-4, 6))
    initial = np.tile(problem.first_states(), (6, 1))
    member = np.array([3, NOMINAL, 1, 3, 2, 1])
    found = simulator([actuation] * 6, batch, initial, member)
    exact = simulate_states(actuation, batch, initial)
    np.testing.assert_array_equal(found.states, exact.states)
    np.testing.assert_allclose(found.measured - exact.measured, np.broadcast_to(member[:, None, None], (6, 151, 6)))


def test_one_run_takes_the_nominal_maps_and_several_the_members(simulator: LearnedSimulator) -> None:
    assert simulator.members(1).tolist() == [NOMINAL]
    assert simulator.members(5).tolist() == [1, 2, 3, 1, 2]
