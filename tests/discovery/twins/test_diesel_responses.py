"""Responses to many small signals: from intervals between samples as from a lane each, and as simulated corrections."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.discovery.likelihood.fit import Candidate, first_fit
from dieseltwin.discovery.likelihood.learned import map_columns
from dieseltwin.discovery.likelihood.nuisance import signal_responses
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.several import Occasion, SeveralTwin
from dieseltwin.engine import we2011
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, basis_along
from dieseltwin.engine.quantities import POINTS
from dieseltwin.recordings.reader import recording
from tests.api.simulated import drive

_STEP = 1e-3  # of a coefficient of a map's correction
_FUNCTIONS = 3  # of each map, the most important ones


@pytest.mark.parametrize("name, size", [("boost_leak", 2e-5), ("vgt_offset", -3.0), ("exhaust_thermal_inertia", 0.3)])
def test_responses_from_intervals_are_those_of_simulated_lanes(name: str, size: float):
    parts = [EngineTwin(recording(drive(40.0, seed=k)), we2011.PARAMETERS) for k in (1, 2)]
    twin = SeveralTwin(parts, [Occasion(0.0, 298.0), Occasion(30.0, 283.0)])
    lanes = first_fit(twin, Candidate((name,)), [size]).lanes()
    simulated = twin.simulate(lanes)[0]
    points = [POINTS.index(CORRECTED_POINTS[m]) for m in basis().maps]
    lane_each = signal_responses(twin, lanes, simulated, points, 1e-5 * basis_along(twin.variables(lanes))) / 1e-5
    found = map_columns(twin, lanes, simulated, np.ones(basis().maps.size, dtype=bool))
    size_of_each = np.linalg.norm(lane_each, axis=1)
    error = np.linalg.norm(found - lane_each, axis=1)
    assert np.all(error <= 1e-3 * size_of_each.max(axis=0))
    assert np.median(error / size_of_each) < 1e-4


@pytest.mark.parametrize(
    "name, size", [("bearing_friction", 2e-6), ("back_pressure", 1.6e5), ("air_filter_restriction", 5e4)]
)
def test_responses_to_corrections_of_maps_are_those_of_the_simulation(name: str, size: float):
    """Restrictions move where the turbine's and the compressor's maps are looked up, in the kernel as in the search."""
    twin = EngineTwin(recording(drive(40.0)), we2011.PARAMETERS)
    lanes = first_fit(twin, Candidate((name,)), [size]).lanes()
    maps = basis().maps
    which = np.zeros(maps.size, dtype=bool)
    for m in range(len(CORRECTED_POINTS)):
        which[np.flatnonzero(maps == m)[:_FUNCTIONS]] = True
    found = map_columns(twin, lanes, twin.simulate(lanes)[0], which)
    for response, function in zip(found, np.flatnonzero(which), strict=True):
        step = _STEP * (np.arange(maps.size) == function)
        up, down = (twin.with_coefficients(sign * step).simulate(lanes)[0] for sign in (1.0, -1.0))
        simulated = (up - down) / (2.0 * _STEP)
        assert np.linalg.norm(response - simulated) < 0.01 * np.linalg.norm(simulated), basis().names[function]
