"""What the balances of one set of numbers say depends on no other set beside it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from dieseltwin.calibration.relations import log_ratio, middle_sizes
from dieseltwin.calibration.steady_model import SteadyModel
from dieseltwin.recordings.steady_points import STATES, SteadyPoints
from tests.calibration.simulated import TRUTH, made_points


@pytest.fixture(scope="module")
def data() -> SteadyPoints:
    return made_points(count=30, noise=0.003)


@pytest.mark.parametrize("strong", [{"boost_leak": 1e-4}, {"exhaust_leak": 1e-4}, {"w_egr_gain": 0.3},
                                    {"air_filter_restriction": 4e4}, {"compressor_efficiency_loss": 0.3}])  # fmt: skip
def test_a_lane_says_the_same_beside_any_other(data: SteadyPoints, strong: Mapping[str, float]) -> None:
    """Small flows were damped by the middle flow of all lanes, so that a leak tried beside it changed a valve's own."""
    model, x = SteadyModel(TRUTH), data.states()
    alone = model.relations(data, x, {"A_egrmax": TRUTH.A_egrmax}).residual[0]
    tried = {name: np.array([0.0, size, size]) for name, size in strong.items()}
    lanes = {"A_egrmax": np.full(3, TRUTH.A_egrmax), **tried}
    beside = model.relations(data, x, lanes).residual
    np.testing.assert_allclose(beside[0], alone, rtol=0.0, atol=1e-12)
    assert np.abs(beside[1] - alone).max() > 1e-3


def test_the_same_area_by_two_names_changes_one_balance_alone(data: SteadyPoints) -> None:
    """An area that is larger and a valve that is open farther, among lanes of other places: one is the other's size."""
    model, x, step, shape = SteadyModel(TRUTH), data.states(), 1e-4, (4, data.size)
    signals = {name: np.zeros(shape) for name in ("f_egr", "p_bc", "intake_balance", "eta_c")}
    for lane, name in enumerate(signals):
        signals[name][lane] = step
    area = {"A_egrmax": np.array([1.0, 1.0 + step]) * TRUTH.A_egrmax}
    by_area = np.diff(model.relations(data, x, area).residual, axis=0)[0]
    without = model.relations(data, x, {"A_egrmax": TRUTH.A_egrmax}).residual[0]
    by_valve = SteadyModel(TRUTH, signals=signals).relations(data, x, {"A_egrmax": np.full(4, TRUTH.A_egrmax)})
    np.testing.assert_allclose(by_valve.residual[0] - without, by_area, rtol=0.0, atol=1e-12)


def test_small_flows_are_small_beside_what_was_read(data: SteadyPoints) -> None:
    """A reading that is off at a point is no other size of all points; without readings each lane has its own."""
    sizes = middle_sizes(data)
    assert sizes["egr_flow"] == pytest.approx(np.median(data["w_egr_kg_s"]))
    measured, predicted = SteadyModel(TRUTH).relations(data, data.states(), {}).pairs["turbo_power"]
    assert sizes["turbo_power"] == pytest.approx(np.median(measured), rel=0.2) and np.shape(predicted)
    blind = SteadyPoints({n: v for n, v in data.columns.items() if n not in STATES}, data.row)
    assert middle_sizes(blind) == {}
    flows = np.array([[1.0, 2.0, 3.0], [10.0, np.nan, 30.0], [np.nan, np.nan, np.nan]])
    together = log_ratio(flows, np.ones((3, 3)))
    for lane, flow in zip(together, flows, strict=True):
        np.testing.assert_array_equal(lane, log_ratio(flow, np.ones(3)))
