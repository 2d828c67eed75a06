"""Compiled kernel of the equations at given states with their derivatives, eight points in one vector register."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from dieseltwin.engine._compiled import _INLINED, _OPTIONS, LANES, load_constants, settle_cylinder
from dieseltwin.engine.binding import primitives_of
from dieseltwin.engine.model_constants import CONSTANT_NAMES
from dieseltwin.engine.parameters import HEALTH
from dieseltwin.engine.tangents import ARGUMENTS, DIRECTIONS, VALUES, point_text
from dieseltwin.inner import inner, kernel

N_ARGUMENTS, N_HEALTH, N_STATES = len(ARGUMENTS), len(HEALTH), 3
N_RESULTS = len(VALUES) * (1 + len(DIRECTIONS))
X_R_AT, T_1_AT, RESULTS_AT = (ARGUMENTS.index("x_r"), ARGUMENTS.index("T_1"), N_ARGUMENTS)
_HEALTH_ROWS = np.array([CONSTANT_NAMES.index(name) for name in HEALTH])


def _make_point() -> Any:
    scope: dict[str, Any] = {**primitives_of("numba"), "__name__": __name__}
    exec(point_text("point"), scope)
    return inner(**_INLINED)(scope["point"])


def _make_store() -> Any:
    # Written out: numba indexes a tuple of unknown length in no loop.
    lines = [f"    work[({RESULTS_AT} + {j}) * lanes + k] = values[{j}]" for j in range(N_RESULTS)]
    scope: dict[str, Any] = {"__name__": __name__}
    exec("\n".join(("def store(work, k, lanes, values):", *lines)), scope)
    return inner(**_INLINED)(scope["store"])


_point, _store = _make_point(), _make_store()


@numba.njit(**_OPTIONS)
def _settle_block(work, c):  # type: ignore[no-untyped-def]
    for k in range(LANES):
        s = settle_cylinder(
            work[k], work[LANES + k], work[5 * LANES + k], work[6 * LANES + k], work[3 * LANES + k],
            work[4 * LANES + k], c,
        )  # fmt: skip
        work[3 * LANES + k] = s.x_r
        work[4 * LANES + k] = s.T_1


@numba.njit(**_OPTIONS)
def _point_block(work, c):  # type: ignore[no-untyped-def]
    for k in range(LANES):
        values = _point(
            work[k], work[LANES + k], work[2 * LANES + k], work[3 * LANES + k], work[4 * LANES + k],
            work[5 * LANES + k], work[6 * LANES + k], work[7 * LANES + k], work[8 * LANES + k], c,
        )  # fmt: skip
        _store(work, k, LANES, values)


@kernel(**_OPTIONS)
def linearise_points(states, cylinder, inputs, health, constants, pairs, results):  # type: ignore[no-untyped-def]
    """Fixed point, values and total derivatives at the points of R runs.

    states (R, 3, n), cylinder (R, 2, n): start of x_r and T_1, replaced by their fixed point after `pairs` pairs of
    sweeps; inputs (R or 1, 4, n), health (R, 4), constants (n_constants,) -> results (R, 8 V, n): the V `VALUES`, then
    their derivatives by `DIRECTIONS`, seven rows for each value.
    """
    runs, n = states.shape[0], states.shape[2]
    work = np.empty((RESULTS_AT + N_RESULTS) * LANES)
    own = constants.copy()
    for r in range(runs):
        for j in range(N_HEALTH):
            own[_HEALTH_ROWS[j]] = health[r, j]
        c = load_constants(own, 0, 1)
        row = r if inputs.shape[0] > 1 else 0
        for first in range(0, n, LANES):
            for k in range(LANES):
                i = min(first + k, n - 1)  # the last block repeats the last point
                for j in range(N_STATES):
                    work[j * LANES + k] = states[r, j, i]
                for j in range(2):
                    work[(X_R_AT + j) * LANES + k] = cylinder[r, j, i]
                for j in range(4):
                    work[(T_1_AT + 1 + j) * LANES + k] = inputs[row, j, i]
            for _ in range(pairs):
                _settle_block(work, c)
            _point_block(work, c)
            for k in range(min(LANES, n - first)):
                for j in range(2):
                    cylinder[r, j, first + k] = work[(X_R_AT + j) * LANES + k]
                for j in range(N_RESULTS):
                    results[r, j, first + k] = work[(RESULTS_AT + j) * LANES + k]
