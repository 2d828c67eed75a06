"""Derivatives written down from the equations are those of the equations, x_r and T_1 at their fixed point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dieseltwin.engine import constants, we2011
from dieseltwin.engine._compiled_tangents import N_RESULTS, linearise_points
from dieseltwin.engine.binding import numpy_model, primitives_of
from dieseltwin.engine.tangents import DIRECTIONS, VALUES, Symbol, Text, point_text, symbolic_primitives
from dieseltwin.errors import DieselTwinError

INPUTS = (1400.0, 120.0, 30.0, 60.0)  # n_e [rpm], u_delta [mg], u_egr, u_vgt [%]
STATES = (1.8e5, 2.2e5, 5200.0)
SWEEPS = 30


def settled(states: np.ndarray, c: Any) -> np.ndarray:
    """The values at states (3,), x_r and T_1 at their fixed point."""
    model, x_r, T_1 = numpy_model(), 0.03, 310.0
    for _ in range(SWEEPS):
        q = model.quantities(*states, x_r, T_1, *INPUTS, c)
        x_r, T_1 = q.x_r_next, q.T_1_next
    return np.array([float(getattr(q, name)) for name in VALUES] + [float(x_r), float(T_1)])


def test_the_text_gives_values_and_derivatives_over_numpy() -> None:
    c = constants(we2011.FIELD)
    scope = primitives_of("numpy")
    exec(point_text("point"), scope)
    values = settled(np.array(STATES), c)
    found = np.array(scope["point"](*STATES, *values[6:], *INPUTS, c), dtype=float)
    np.testing.assert_allclose(found[:6], values[:6], rtol=1e-12)
    slopes = found[6:].reshape(6, 7)
    for j, name in enumerate(DIRECTIONS):
        step = 1e-6
        both = []
        for factor in (1.0 + step, 1.0 - step):
            states = np.array(STATES)
            if j < 3:
                states[j] *= factor
            both.append(settled(states, c if j < 3 else c._replace(**{name: getattr(c, name) * factor})))
        width = 2.0 * step * (STATES[j] if j < 3 else 1.0)  # health values: by their logarithms
        np.testing.assert_allclose(slopes[:, j], (both[0] - both[1])[:6] / width, rtol=2e-5, atol=1e-9, err_msg=name)


def test_the_kernel_gives_every_point_what_the_text_gives() -> None:
    """More points than a block holds, two runs of different health, a common drive."""
    rng = np.random.default_rng(4)
    n, health = 19, np.stack([we2011.FIELD.health(), we2011.PARAMETERS.health()])
    states = np.array(STATES)[None, :, None] * rng.uniform(0.8, 1.2, (2, 3, n))
    inputs = np.array(INPUTS)[None, :, None] * rng.uniform(0.7, 1.3, (1, 4, n))
    cylinder = np.tile(np.array([0.03, 310.0])[None, :, None], (2, 1, n))
    results = np.empty((2, N_RESULTS, n))
    linearise_points(states, cylinder, inputs, health, np.array(constants(we2011.FIELD)), SWEEPS, results)
    scope = primitives_of("numpy")
    exec(point_text("point"), scope)
    for r, parameters in enumerate((we2011.FIELD, we2011.PARAMETERS)):
        c = constants(parameters)
        for i in range(n):
            alone = np.array(scope["point"](*states[r, :, i], *cylinder[r, :, i], *inputs[0, :, i], c), dtype=float)
            np.testing.assert_allclose(results[r, :, i], alone, rtol=1e-9, atol=1e-9)


def test_an_exponent_that_moves_is_refused() -> None:
    text = Text()
    x = Symbol(text, "x", {"x": 1.0})
    with pytest.raises(DieselTwinError, match="exponent x"):
        symbolic_primitives(text)["positive_power"](Symbol(text, "y"), x)


def test_what_stands_in_the_text_is_not_written_again() -> None:
    text = Text()
    x, y = (Symbol(text, name, {name: 1.0}) for name in "xy")
    product = x * y + x * y
    assert text.lines.count("v0 = x * y") == 1
    assert {name: str(value) for name, value in product.by.items()} == {"x": "v1", "y": "v2"}
    assert {"v1 = y + y", "v2 = x + x", "v3 = v0 + v0"} <= set(text.lines)
