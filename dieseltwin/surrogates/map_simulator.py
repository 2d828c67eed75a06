"""The engine with other maps over numpy: where it comes to rest, and many lanes of driving in step.

The same Runge-Kutta steps as the compiled simulators', for any functions in place of the six maps (networks of any
depth, formulae), without compiling: a minute of twenty lanes takes five seconds of one core.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import root

from dieseltwin.arrays import Array
from dieseltwin.engine import Actuation, EngineParameters, Observations, ParameterBatch
from dieseltwin.engine._compiled import (
    OMEGA_HIGH,
    OMEGA_LOW,
    P_EM_HIGH,
    P_EM_LOW,
    P_IM_HIGH,
    P_IM_LOW,
    SAMPLE_SWEEPS,
    START_SWEEPS,
    T_1_START,
    X_R_START,
)
from dieseltwin.engine.binding import Model, bind
from dieseltwin.engine.model_constants import Constants
from dieseltwin.engine.observations import observations
from dieseltwin.engine.parameters import constants
from dieseltwin.sensors import READ

MapFunctions = Mapping[str, Callable[..., Any]]
"""Functions of the engine's signatures by the names of `engine.MAPS`, over numpy; none: the formulae."""
Point = tuple[float, float, float, float]
"""Constant inputs: n_e [rpm], u_delta [mg/cycle], u~_egr, u~_vgt [%]."""

_SCALE = np.array([1e5, 1e5, 1e3, 0.1, 1e2])  # p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K]: all of order one
_PUSH = 1e-6  # of the scaled states: the step of central differences
_AT_REST = 1e-9  # largest scaled rate that counts as none [1/s]


def rest(
    functions: MapFunctions, point: Point, parameters: EngineParameters, start: Array
) -> Array | None:
    """Where the engine with these maps rests at constant inputs; None where no stable rest is found.

    Args:
        functions: the maps.
        point: the inputs.
        parameters: the engine.
        start: p_im, p_em [Pa], omega_t [rad/s] from which the search goes out, (3,).

    Returns:
        p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K]; (5,).
    """
    model, c = bind("numpy", functions), constants(parameters)

    def rates(x: Array) -> Array:
        states = x * _SCALE
        q = model.quantities(*states, *point, c)
        change = [q.dp_im, q.dp_em, q.domega_t, q.x_r_next - states[3], q.T_1_next - states[4]]
        return np.asarray(change, dtype=np.float64) / _SCALE

    with np.errstate(all="ignore"):
        found = root(rates, np.array([*start, X_R_START, T_1_START]) / _SCALE, tol=1e-12)
        x = found.x
        if not (np.abs(rates(x)).max() < _AT_REST and (x > 0.0).all()):
            return None
        jacobian = np.stack([(rates(x + push) - rates(x - push)) / (2.0 * _PUSH) for push in _PUSH * np.eye(5)], axis=1)
    # x_r and T_1 follow at once: they are a fixed point, not states with a rate
    followed = np.linalg.solve(jacobian[3:, 3:], jacobian[3:, :3])
    slowest = float(np.linalg.eigvals(jacobian[:3, :3] - jacobian[:3, 3:] @ followed).real.max())
    return np.asarray(x * _SCALE) if slowest < 0.0 else None


def numpy_simulator(functions: MapFunctions) -> Callable[..., Observations]:
    """`engine.simulate_states` with these maps: the same arguments and results, but one actuation a lane or one for all
    and no terms."""
    model = bind("numpy", functions)

    def simulate(
        actuation: Actuation | Sequence[Actuation], batch: ParameterBatch, initial: Array, *, threads: int | None = None
    ) -> Observations:
        actuations = [actuation] if isinstance(actuation, Actuation) else list(actuation)
        with np.errstate(all="ignore"):  # what a broken map makes of the states is the caller's to judge
            states = _states(model, actuations, batch, initial)
            inputs = np.stack([one.at_samples() for one in actuations], axis=1)
            q = model.quantities(*np.moveaxis(states, -1, 0), *inputs, batch.constants())
        read = [np.broadcast_to(getattr(q, name), states.shape[:-1])[..., None] for name in READ]
        return observations(np.concatenate([states, *read], axis=-1), states.shape[-1])

    return simulate


def _states(model: Model, actuations: Sequence[Actuation], batch: ParameterBatch, initial: Array) -> Array:
    """States (B, n, 5) at the samples; x_r and T_1 are settled there."""
    c = Constants(*batch.values)
    first = actuations[0]
    grid = np.stack([one.grid for one in actuations], axis=1)  # (4, B or 1, half steps)
    time = first.time_s
    start = np.broadcast_to(np.asarray(initial, dtype=np.float64), (batch.size, 3))
    x: tuple[Array, ...] = (*start.T, np.full(batch.size, X_R_START), np.full(batch.size, T_1_START))
    states = np.empty((batch.size, time.size, 5))
    at = 0
    for i in range(time.size):
        p_im, p_em, omega_t, x_r, T_1 = x
        for _ in range(SAMPLE_SWEEPS if i else START_SWEEPS):
            sweep = model.settle_cylinder(p_im, p_em, grid[0, :, at], grid[1, :, at], x_r, T_1, c)
            x_r, T_1 = sweep.x_r, sweep.T_1
        x = (p_im, p_em, omega_t, x_r, T_1)
        for k, value in enumerate(x):
            states[:, i, k] = value
        if i + 1 < time.size:
            h = (time[i + 1] - time[i]) / first.steps[i]
            for _ in range(first.steps[i]):
                x = _step(model, x, grid[:, :, at : at + 3], h, c)
                at += 2
    return states


def _step(model: Model, x: Sequence[Array], inputs: Array, h: float, c: Constants) -> tuple[Array, ...]:
    """One Runge-Kutta step of h [s]; inputs (4, B, 3) at its start, middle and end."""
    slopes: list[list[Array]] = []
    states, cylinder = x[:3], list(x[3:])
    for share, moment in ((0.0, 0), (0.5, 1), (0.5, 1), (1.0, 2)):
        at = [a + share * h * k for a, k in zip(states, slopes[-1], strict=True)] if slopes else states
        *rates, x_r, T_1 = _rates(model, (*at, *cylinder), inputs[..., moment], c)
        slopes.append(rates)
        cylinder = [x_r, T_1]
    weighted = zip(states, *slopes, strict=True)
    p_im, p_em, omega_t = (a + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4) for a, k1, k2, k3, k4 in weighted)
    return (
        np.clip(p_im, P_IM_LOW * c.p_amb, P_IM_HIGH * c.p_amb),
        np.clip(p_em, P_EM_LOW * c.p_amb, P_EM_HIGH * c.p_amb),
        np.clip(omega_t, OMEGA_LOW, OMEGA_HIGH), *cylinder,
    )  # fmt: skip


def _rates(model: Model, x: Sequence[Array], inputs: Array, c: Constants) -> tuple[Array, ...]:
    """dp_im, dp_em [Pa/s], domega_t [rad/s2], and x_r [-], T_1 [K] after two sweeps, as in the compiled simulators."""
    p_im, p_em, omega_t, x_r, T_1 = x
    n_e, u_delta = inputs[0], inputs[1]
    W_ei = model.cylinder_inflow(model.eta_vol(p_im, n_e, c), p_im, n_e, c)
    warm = model.cylinder_sweep(
        model.exhaust_to_intake_ratio(p_em, p_im), W_ei, model.fuel_flow(u_delta, n_e, c), x_r, T_1, c
    )
    q = model.quantities(p_im, p_em, omega_t, warm.x_r, warm.T_1, *inputs, c)
    return q.dp_im, q.dp_em, q.domega_t, q.x_r_next, q.T_1_next
