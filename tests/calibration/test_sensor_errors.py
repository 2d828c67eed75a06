"""Sensors that are off within what is believed of them raise no alarm at settled points; one beyond it is named."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from dieseltwin.calibration import calibrate as module
from dieseltwin.calibration.calibrate import Calibration, calibrate
from dieseltwin.calibration.discover import Options, PointsDiscovery, discover_points
from dieseltwin.calibration.steady_model import SENSOR_ERROR
from dieseltwin.calibration.steady_twin import SteadyTwin
from dieseltwin.discovery.likelihood.fit import first_fit, prior_misfit
from dieseltwin.recordings.steady_points import STATES
from dieseltwin.settings.defaults import default_search
from tests.calibration.simulated import GEOMETRY, TRUTH, made_points

OFF = {"p_im_pa": 0.010, "p_em_pa": -0.013, "omega_t_rad_s": 0.008}
"""1.4 to 2.2 of the standard deviations that are believed of gain and offset together; p_em - p_im is 6 kPa in the
middle, of which they make 4."""

FAULT = 0.05  # of p_em: five tolerances


def calibrated(off: Mapping[str, float]) -> Calibration:
    """An engine from 70 points, 0.2 % noise on every reading, whose sensors are off by these shares."""
    data = made_points(TRUTH, 70, 0.002, 5, u_flap_pct=100.0)
    data = data.with_columns(**{name: data[name] * (1.0 + off.get(name, 0.0)) for name in STATES})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 0)
        return calibrate(data, TRUTH, GEOMETRY, believed=default_search().points)


def discovered(calibration: Calibration) -> PointsDiscovery:
    return discover_points(calibration, Options(law_search=False, search=default_search().points))


@pytest.fixture(scope="module")
def healthy() -> Calibration:
    return calibrated(OFF)


def test_errors_of_healthy_sensors_are_told_and_no_alarm(healthy: Calibration) -> None:
    values, std = healthy.estimate.values(), healthy.estimate.std()
    for column in STATES:
        level = float(np.nanmedian(healthy.points[column]))
        gain, offset = f"{SENSOR_ERROR}{column}:gain", f"{SENSOR_ERROR}{column}:offset"
        share = values[gain] + values[offset] / level
        assert share == pytest.approx(OFF.get(column, 0.0), abs=2.0 * np.hypot(std[gain], std[offset] / level)), column
    found = discovered(healthy)
    assert not found.mismatch, found.effects


def test_errors_are_believed_about_nought(healthy: Calibration) -> None:
    twin = SteadyTwin(healthy, default_search().points)
    errors = [p for p in twin.parameters if p.name.startswith(SENSOR_ERROR)]
    assert len(errors) == 2 * len(STATES)
    assert all(p.value == 0.0 for p in errors)
    begin = first_fit(twin).parameters
    assert prior_misfit(twin, begin) == pytest.approx(sum((p.first / p.prior_std) ** 2 for p in errors))
    assert prior_misfit(twin, begin) > 4.0  # that p_im and p_em are off is not for nothing


@pytest.mark.thorough
def test_a_sensor_beyond_belief_is_named() -> None:
    found = discovered(calibrated({**OFF, "p_em_pa": OFF["p_em_pa"] + FAULT}))
    assert tuple(found.effects) == ("p_em_gain",)
    magnitude, std = found.effects["p_em_gain"]
    assert magnitude == pytest.approx(FAULT + OFF["p_em_pa"], abs=2.0 * std)
    assert 0.003 < std < 0.01  # not known better than the gain that its sensor may have anyway
