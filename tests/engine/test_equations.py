"""Each equation of the appendix once, and the same function on every backend."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numba
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import dieseltwin.engine
from dieseltwin.engine import bind, constants, we2011
from dieseltwin.engine._fastmath import fast_exp, fast_log, fast_positive_power
from dieseltwin.engine.binding import equations
from dieseltwin.errors import DieselTwinError

# What the paper prints twice or inside another equation: its number -> the number that carries the formula.
ALIASES = {14: 10, 29: 30, 41: 40, 43: 40, 45: 49, 46: 50}
LAST_EQUATION = 50


def _cited() -> dict[int, list[str]]:
    """Equation number -> functions that claim it in the first line of their docstring: "(A.7)", "(A.49; ...)"."""
    found: dict[int, list[str]] = {}
    for source in sorted(Path(dieseltwin.engine.__file__).parent.glob("*.py")):
        for node in ast.parse(source.read_text()).body:
            if isinstance(node, ast.FunctionDef) and node.name in equations():
                first = (ast.get_docstring(node) or "").split("\n")[0]
                for bracket in re.findall(r"\((A\.\d+[^()]*)\)", first):
                    if bracket.startswith("factor"):
                        continue
                    own = re.split(r"[;:]| with | is ", bracket)[0]
                    for number in re.findall(r"A\.(\d+)", own):
                        found.setdefault(int(number), []).append(node.name)
    return found


def test_every_equation_once() -> None:
    cited = _cited()
    duplicates = {n: names for n, names in cited.items() if len(names) > 1}
    assert not duplicates, f"equations with two functions: {duplicates}"
    holes = [n for n in range(1, LAST_EQUATION + 1) if n not in cited and ALIASES.get(n) not in cited]
    assert not holes, f"equations without a function: {holes}"


def test_equation_functions_have_units() -> None:
    missing = [name for name, f in equations().items() if "[" not in (f.__doc__ or "") and name not in _NO_UNITS]
    assert not missing


_NO_UNITS = {
    "cylinder_sweep", "settle_cylinder", "quantities", "quantities_extended", "intake_side", "exhaust_side",
    "charge_constants", "driver_quantities", "secant",
}  # fmt: skip  compositions: units are those of what they put together

_states = st.tuples(
    st.floats(0.9e5, 3.5e5), st.floats(0.9e5, 4.5e5), st.floats(500.0, 12000.0), st.floats(0.01, 0.1),
    st.floats(290.0, 360.0), st.floats(600.0, 2000.0), st.floats(1.0, 250.0), st.floats(-10.0, 110.0),
    st.floats(20.0, 100.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def backends():  # type: ignore[no-untyped-def]
    model = bind("numba")
    quantities = model.quantities

    @numba.njit(error_model="numpy")
    def compiled(a, b, w, x, t, n, d, e, v, c):  # type: ignore[no-untyped-def]
        return quantities(a, b, w, x, t, n, d, e, v, c)

    return bind("numpy"), bind("torch"), compiled


@settings(max_examples=60, deadline=None)
@given(point=_states)
def test_backends_agree(backends, point) -> None:  # type: ignore[no-untyped-def]
    numpy_model, torch_model, compiled = backends
    c = constants(we2011.PARAMETERS)
    expected = numpy_model.quantities(*(np.array([value]) for value in point), c)
    with_torch = torch_model.quantities(*(torch.tensor([value], dtype=torch.float64) for value in point), c)
    with_numba = compiled(*point, c)
    for name, *values in zip(expected._fields, expected, with_torch, with_numba, strict=True):
        a, b, d = (float(np.ravel(value)[0]) for value in values)  # of the published model some are constants
        scale = max(abs(a), 1e-9)
        rate = name.startswith("d")  # rates are differences of large flows: compare on the scale of one flow
        tolerance = 1e-6 * 1e5 if rate else 1e-10 * scale
        assert abs(b - a) <= tolerance and abs(d - a) <= tolerance, name


@settings(max_examples=100, deadline=None)
@given(point=_states)
def test_gradients_are_finite(backends, point) -> None:  # type: ignore[no-untyped-def]
    """Also on the limiters (closed valve, Pi_c = 1, Pi_egr = 1), where a plain square root gives NaN."""
    model = backends[1]
    arguments = [torch.tensor([value], dtype=torch.float64, requires_grad=True) for value in point]
    c = constants(we2011.PARAMETERS)
    q = model.quantities(*arguments, c)
    (q.dp_im + q.dp_em + q.domega_t + q.T_1_next).sum().backward()
    assert all(torch.isfinite(argument.grad).all() for argument in arguments if argument.grad is not None)


def test_gradient_at_the_limits(backends) -> None:  # type: ignore[no-untyped-def]
    model = backends[1]
    c = constants(we2011.PARAMETERS)
    p = torch.tensor([c.p_amb], dtype=torch.float64, requires_grad=True)
    one = torch.ones(1, dtype=torch.float64)
    q = model.quantities(
        p, p * 1.0, 2000.0 * one, 0.03 * one, 310.0 * one, 600.0 * one, 5.0 * one, 0.0 * one, 30.0 * one, c
    )
    (q.W_egr + q.W_c + q.W_t + q.eta_c).sum().backward()
    assert torch.isfinite(p.grad).all()


def test_replacing_a_map_reaches_the_composition() -> None:
    c = constants(we2011.PARAMETERS)
    point = [np.array([v]) for v in (1.5e5, 1.8e5, 5000.0, 0.03, 310.0, 1200.0, 80.0, 40.0, 50.0)]
    doubled = bind("numpy", replace={"eta_vol": lambda p_im, n_e, c: 0.5 + 0.0 * p_im})
    assert doubled.quantities(*point, c).W_ei == pytest.approx(
        bind("numpy").quantities(*point, c).W_ei * 0.5 / bind("numpy").eta_vol(point[0], point[5], c)
    )
    with pytest.raises(DieselTwinError, match="eta_volume"):
        bind("numpy", replace={"eta_volume": lambda *a: 0})


@settings(max_examples=200, deadline=None)
@given(x=st.floats(-600.0, 600.0), y=st.floats(1e-280, 1e280), a=st.floats(-3.0, 3.0))
def test_fast_functions_match_the_c_library(x: float, y: float, a: float) -> None:
    assert fast_exp(x) == pytest.approx(np.exp(x), rel=1e-15 * 4)
    assert fast_log(y) == pytest.approx(np.log(y), rel=4e-16 * 2, abs=4e-16)
    base = min(max(y, 1e-6), 1e6)
    assert fast_positive_power(base, a) == pytest.approx(base**a, rel=1e-14)
    assert fast_positive_power(-base, a) == 0.0


def test_behaviour_of_the_engine() -> None:
    """What a calibration engineer would check at one operating point."""
    model = bind("numpy")
    p = we2011.PARAMETERS
    c = constants(p)
    point = (1.6e5, 2.0e5, 6000.0, 0.03, 310.0, 1300.0, 120.0, 50.0, 45.0)
    q = model.quantities(*point, c)
    more = model.quantities(*point, constants(p.replace(A_egrmax=1.2 * p.A_egrmax)))
    assert more.W_egr == pytest.approx(1.2 * q.W_egr)
    wider = model.quantities(*point, constants(p.replace(A_vgtmax=1.1 * p.A_vgtmax)))
    assert wider.W_t == pytest.approx(1.1 * q.W_t)
    colder = model.quantities(*point, constants(p.replace(h_tot=1.5 * p.h_tot)))
    assert c.T_amb < colder.T_em < q.T_em < q.T_e
    assert q.W_eo == pytest.approx(q.W_ei + q.W_f)
    assert model.torque(120.0, 1300.0, 1.6e5, 2.0e5, c) > model.torque(120.0, 1300.0, 1.6e5, 2.4e5, c) > 500.0


@given(st.floats(70e3, 103e3), st.floats(250.0, 320.0))
def test_corrected_flow_and_speed_make_one_compressor_map_of_all_weather(p_amb: float, T_amb: float) -> None:
    """Same corrected flow, corrected speed and pressure quotient: same efficiency and flow coefficient. By published
    maps both change; in their own weather there is no difference."""
    m, published = bind("numpy"), we2011.PARAMETERS
    own = published.replace(p_cmap=published.p_amb, T_cmap=published.T_amb, k_cflow=1.0, k_cspeed=1.0)
    here, there = constants(own), constants(own.replace(p_amb=p_amb, T_amb=T_amb))
    W_c, Pi_c, omega_t = np.array([0.1, 0.2, 0.35]), np.array([1.3, 1.6, 2.2]), np.array([5e3, 6.5e3, 9e3])
    faster = np.sqrt(T_amb / published.T_amb)
    flow = W_c * (p_amb / published.p_amb) / faster
    np.testing.assert_allclose(m.eta_c(flow, Pi_c, there), m.eta_c(W_c, Pi_c, here), rtol=1e-12)
    flows = [m.Phi_c(c.T_amb, Pi_c, omega, c) for c, omega in ((there, omega_t * faster), (here, omega_t))]
    np.testing.assert_allclose(*flows, rtol=1e-9)
    np.testing.assert_array_equal(m.eta_c(W_c, Pi_c, here), m.eta_c(W_c, Pi_c, constants(published)))


def test_the_published_compressor_knows_no_weather() -> None:
    m, high_up = bind("numpy"), we2011.PARAMETERS.replace(p_amb=85e3, T_amb=270.0)
    own = high_up.replace(p_cmap=101e3, T_cmap=298.0)
    for weather in (high_up, own):
        assert constants(weather).flow_correction == constants(weather).speed_correction == 1.0
    assert m.eta_c(0.2, 1.6, constants(own)) != m.eta_c(0.2, 1.6, constants(own.replace(k_cflow=0.5)))
