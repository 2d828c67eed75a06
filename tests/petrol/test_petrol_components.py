"""Nozzle, leak, displaced flow and filling of the petrol engine's air path."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dieseltwin.petrol.components import (
    CRITICAL,
    LEAK_LINEAR_ABOVE,
    R_A,
    displaced_flow,
    nozzle_factor,
    nozzle_flow,
    signed_leak,
    storage_flow,
)
from dieseltwin.petrol.effects import undo
from dieseltwin.petrol.maps import roughness, spline_basis, sum_basis, tensor_basis
from dieseltwin.petrol.recording import Signals
from dieseltwin.petrol.simulate import _psi

pressure = st.floats(1.5e4, 2.5e5)


def test_nozzle_is_choked_below_the_critical_quotient() -> None:
    choked = np.sqrt(1.4) * (2.0 / 2.4) ** (2.4 / 0.8)
    np.testing.assert_allclose(nozzle_factor(np.array([0.0, 0.3, CRITICAL])), choked, rtol=1e-12)


@given(st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_nozzle_factor_falls_with_the_quotient(a: float, b: float) -> None:
    low, high = sorted((a, b))
    values = nozzle_factor(np.array([low, high]))
    assert values[1] <= values[0] + 1e-12 and values.min() >= 0.0
    if low >= 1.0:
        assert values[0] == 0.0


@given(pressure, pressure)
def test_leak_runs_down_the_pressure(inside: float, outside: float) -> None:
    flow = float(signed_leak(1e-6, np.array([inside]), np.array([300.0]), np.array([outside]), np.array([300.0]))[0])
    assert flow == 0.0 if inside == outside else np.sign(flow) in (0.0, np.sign(outside - inside))


@pytest.mark.parametrize("above_pa", [75.0, 120.0, 1000.0, 30e3])
def test_a_leak_is_a_nozzle_where_pressures_nearly_agree(above_pa: float) -> None:
    """Before the throttle the charge is 75 to 120 Pa above ambient in much of a drive."""
    p_amb, T, area, gamma = 1e5, 310.0, 15e-6, 1.4
    quotient = p_amb / (p_amb + above_pa)
    psi = np.sqrt(2 * gamma / (gamma - 1) * (quotient ** (2 / gamma) - quotient ** ((gamma + 1) / gamma)))
    out = -float(signed_leak(area, np.array([p_amb + above_pa]), np.array([T]), np.array([p_amb]), np.array([T]))[0])
    assert out == pytest.approx(area * (p_amb + above_pa) / np.sqrt(R_A * T) * psi, rel=1e-9)
    assert _psi(quotient, LEAK_LINEAR_ABOVE) == pytest.approx(psi, rel=1e-9)  # in the simulator as well


def test_displaced_flow_and_filling() -> None:
    one = np.array([1.0])
    # a cylinder charge every second turn
    expected = 1e5 * 2e-3 * 200.0 / (4.0 * np.pi * R_A * 300.0)
    assert displaced_flow(1e5 * one, 200.0 * one, 300.0 * one, 2e-3)[0] == pytest.approx(expected)
    assert storage_flow(1e4 * one, 300.0 * one, 2e-3)[0] == pytest.approx(1e4 * 2e-3 / (R_A * 300.0))
    assert nozzle_flow(0.0, 1e5 * one, 300.0 * one, 5e4 * one)[0] == 0.0


def test_splines_sum_to_one_everywhere() -> None:
    knots = np.linspace(0.0, 1.0, 6)
    x = np.linspace(-0.5, 1.5, 41)
    np.testing.assert_allclose(spline_basis(x, knots).sum(axis=1), 1.0)
    np.testing.assert_allclose(tensor_basis(x, x[::-1], knots, knots).sum(axis=1), 1.0)
    np.testing.assert_allclose(sum_basis(x, x, knots, knots).sum(axis=1), 2.0)
    line = np.linalg.lstsq(spline_basis(x[10:31], knots), x[10:31], rcond=None)[0]
    np.testing.assert_allclose(spline_basis(x, knots) @ line, np.clip(x, -0.2, 1.2), atol=1e-7)  # a step beyond
    straight = np.arange(8.0)
    assert straight @ roughness(8) @ straight == pytest.approx(0.0)


def test_a_hole_before_the_throttle_lets_air_in_below_the_ambient_pressure() -> None:
    """It let none in, and noise about the ambient pressure was a flow outwards."""
    p_ic = 1e5 + 200.0 * np.random.default_rng(1).standard_normal(5000)
    one = np.ones(5000)
    rest = Signals(0.1 * np.arange(5000), p_ic, 300.0 * one, 3e4 * one, 3e-3 * one, 90.0 * one, 2.0 * one, 1e5 * one,
                   300.0 * one)  # fmt: skip
    out = undo("boost_leak", 2e-5, rest).leak_ic
    assert out is not None
    below, above = out[p_ic < 1e5], out[p_ic > 1e5]
    assert (below < 0.0).all() and (above > 0.0).all()
    assert abs(out.mean()) < 0.02 * np.abs(out).mean()
