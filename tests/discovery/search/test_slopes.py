"""Names by their derivative, where the response to a size of interest crosses an edge."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.search.singles import with_singles
from dieseltwin.discovery.search.slopes import refit_by_slopes
from dieseltwin.discovery.twins.interface import Lanes
from tests.discovery.toy import SETTINGS, Toy


class _Edged(Toy):
    """A machine that a large leak beside what else is known at first takes over an edge in one of its windows."""

    edge = 0.012

    def simulate(self, lanes: Lanes) -> np.ndarray:
        readings = super().simulate(lanes)
        leak = lanes.magnitudes.get("leak", np.zeros(lanes.size))
        last = self.starts[-1]
        readings[:, last:, :] += np.where(leak > self.edge, 3.0, 0.0)[:, None, None]
        return readings


def test_a_name_whose_size_of_interest_crosses_an_edge_is_refitted_by_its_derivative() -> None:
    """1.5 % of a turbine's efficiency gained 18 linearly, its derivative 105: the name was never refitted."""
    twin = _Edged()
    twin.edge = 1.0
    twin.record(gain=0.95, leak=0.01)
    twin.edge = 0.012  # sizes of interest are 0.015
    found = with_singles(prepare(twin, SETTINGS))
    found.singles = [fit for fit in found.singles if fit.candidate.names != ("leak",)]
    assert refit_by_slopes(found)
    assert found.singles[0].candidate.names == ("leak",)
    assert abs(found.singles[0].magnitudes[0] - 0.01) < 0.002
    lead = found.singles[0]
    assert not refit_by_slopes(found) and found.singles[0] is lead


def test_names_that_are_straight_are_left_as_they_are() -> None:
    found = with_singles(prepare(Toy().record(gain=0.95, leak=0.02), SETTINGS))
    before = list(found.singles)
    assert not refit_by_slopes(found) and found.singles == before
