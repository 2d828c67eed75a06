"""Memory of lanes, and the steps that discovery chooses."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.twins.diesel_lanes import Memory
from dieseltwin.discovery.twins.diesel_steps import step_lengths
from dieseltwin.discovery.twins.interface import Lanes
from dieseltwin.engine.simulate import Observations


class _Counted:
    """States that tell a lane's parameter and effect; counts the lanes that it is asked for."""

    def __init__(self) -> None:
        self.lanes = 0

    def __call__(self, lanes: Lanes) -> Observations:
        self.lanes += lanes.size
        value = lanes.parameters[:, 0] + 10.0 * lanes.magnitudes.get("boost_leak", np.zeros(lanes.size))
        factor = np.ones((lanes.size, 4)) * lanes.schedules.get("boost_leak", np.ones(4))
        states = np.repeat((value[:, None] * factor)[:, :, None], 6, axis=2)
        return Observations(states, 2.0 * states)


def _lanes(parameters: list[float], **magnitudes: list[float]) -> Lanes:
    named = {name: np.array(values) for name, values in magnitudes.items()}
    return Lanes(np.array(parameters)[:, None], np.zeros((len(parameters), 1, 1)), named)


def test_only_new_lanes_are_simulated() -> None:
    memory, simulate = Memory(), _Counted()
    first = memory.trajectories(_lanes([1.0, 2.0, 1.0]), simulate)
    assert simulate.lanes == 2  # two are the same
    np.testing.assert_array_equal(first.states[:, 0, 0], [1.0, 2.0, 1.0])
    again = memory.trajectories(_lanes([3.0, 2.0], t_em_gain=[0.0, 0.1], boost_leak=[0.5, 0.0]), simulate)
    assert simulate.lanes == 3  # a sensor's fault leaves the engine as it is
    np.testing.assert_array_equal(again.measured[:, 0, 0], [16.0, 4.0])


def test_a_schedule_makes_another_lane() -> None:
    memory, simulate = Memory(), _Counted()
    lanes = _lanes([1.0, 1.0], boost_leak=[0.5, 0.5])
    own = Lanes(lanes.parameters, lanes.local, lanes.magnitudes, {"boost_leak": np.array([[1.0] * 4, [0.0, 0, 1, 1]])})
    found = memory.trajectories(own, simulate)
    np.testing.assert_array_equal(found.states[:, 0, 0], [6.0, 0.0])
    memory.trajectories(Lanes(lanes.parameters, lanes.local, lanes.magnitudes, {"boost_leak": np.ones(4)}), simulate)
    assert simulate.lanes == 3


def test_steps_are_short_where_it_is_stiff_and_behind_a_start() -> None:
    rate = np.full(100, 40.0)
    rate[50] = 150.0
    lengths = step_lengths(rate, np.array([0, 70]))
    assert lengths.shape == (99,)
    assert lengths[[0, 70]].max() == lengths.min() == 0.0125
    assert np.all(150.0 * lengths[48:52] < 2.7) and np.all(40.0 * lengths < 2.7)
    assert lengths[20] > 0.06
