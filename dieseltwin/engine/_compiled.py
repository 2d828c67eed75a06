"""Compiled kernels of the simulator: RK4 in lockstep lanes, and the actuators' exact solution.

Lanes are parameter sets (or segments) that advance together: the loop over the lanes of a block is the innermost one
and the equations are branch-free, so that the compiler runs eight lanes in one vector register.
"""

from __future__ import annotations

import types
from typing import Any

import numba
import numpy as np

from dieseltwin.engine._fastmath import select
from dieseltwin.engine.binding import bind
from dieseltwin.engine.manifolds import X_OC as _OXYGEN_OF_AIR
from dieseltwin.engine.model_constants import CONSTANT_NAMES, Constants
from dieseltwin.inner import inner, kernel
from dieseltwin.sensors import READ

LANES = 8
"""Lanes of a block: doubles in a 512-bit register."""

N_STATES = 5  # p_im, p_em, omega_t, x_r, T_1
N_CONSTANTS = len(CONSTANT_NAMES)
CONSTANTS_AT = N_STATES + 12  # of the flat work array, in units of LANES
N_READ = len(READ)
N_OUT = N_STATES + N_READ

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}

_INLINED: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}

P_IM_LOW, P_IM_HIGH = 0.5, 10.0  # of p_amb, limiters of the published simulation
P_EM_LOW, P_EM_HIGH = 0.5, 20.0
OMEGA_LOW, OMEGA_HIGH = 100.0 * np.pi / 30.0, 200000.0 * np.pi / 30.0  # rad/s

_model = bind("numba")
quantities = _model.quantities
settle_cylinder = _model.settle_cylinder
cylinder_sweep = _model.cylinder_sweep
cylinder_inflow = _model.cylinder_inflow
fuel_flow = _model.fuel_flow
eta_vol = _model.eta_vol
exhaust_to_intake_ratio = _model.exhaust_to_intake_ratio
actuator_update = _model.actuator_update
play_output = _model.play_output
play_edge = _model.play_edge


def _make_load_constants() -> Any:
    # Written out by a loop: numba builds a NamedTuple from a fixed list of scalars only.
    fields = ", ".join(f"values[{j} * lanes + k]" for j in range(N_CONSTANTS))
    scope: dict[str, Any] = {"Constants": Constants, "__name__": __name__}
    exec(f"def load_constants(values, k, lanes):\n    return Constants({fields})\n", scope)
    return inner(**_INLINED)(scope["load_constants"])


load_constants = _make_load_constants()


def readings_stored(arguments: str, place: str) -> Any:
    """A compiled function of `arguments` that writes what the sensors read of quantities q, one `place` for each j."""
    lines = [f"    {place.format(j=j)} = q.{name}" for j, name in enumerate(READ)]
    scope: dict[str, Any] = {"__name__": __name__}
    exec("\n".join((f"def store_readings({arguments}, q):", *lines)), scope)
    return inner(**_INLINED)(scope["store_readings"])


store_readings = readings_stored("out, k, i", f"out[k, i, {N_STATES} + {{j}}]")


@inner(**_INLINED)
def _rates(p_im, p_em, omega_t, x_r, T_1, n_e, u_delta, u_egr, u_vgt, c):  # type: ignore[no-untyped-def]
    # Two sweeps of the cylinder's fixed point, warm from the stage before: one here, one in `quantities`. One alone
    # lags and errs by 0.03 % of the mean; three change nothing above 1e-5.
    W_ei = cylinder_inflow(eta_vol(p_im, n_e, c), p_im, n_e, c)
    warm = cylinder_sweep(exhaust_to_intake_ratio(p_em, p_im), W_ei, fuel_flow(u_delta, n_e, c), x_r, T_1, c)
    q = quantities(p_im, p_em, omega_t, warm.x_r, warm.T_1, n_e, u_delta, u_egr, u_vgt, c)
    return q.dp_im, q.dp_em, q.domega_t, q.x_r_next, q.T_1_next


@inner(**_INLINED)
def _limit(x, low, high):  # type: ignore[no-untyped-def]
    x = select(x > low, x, low)
    return select(x < high, x, high)


def _advance(work, h):  # type: ignore[no-untyped-def]
    """One RK4 step of all lanes.

    work: flat, LANES values each of the 5 states, 12 inputs (3 times x 4) and the constants. One array, because LLVM
    vectorises a loop of eight rounds only if it needn't check at run time whether arrays overlap.
    """
    for k in range(LANES):
        c = load_constants(work, CONSTANTS_AT * LANES + k, LANES)
        p_im = work[k]
        p_em = work[LANES + k]
        omega = work[2 * LANES + k]
        x_r = work[3 * LANES + k]
        T_1 = work[4 * LANES + k]
        n_0 = work[5 * LANES + k]
        d_0 = work[6 * LANES + k]
        e_0 = work[7 * LANES + k]
        v_0 = work[8 * LANES + k]
        n_1 = work[9 * LANES + k]
        d_1 = work[10 * LANES + k]
        e_1 = work[11 * LANES + k]
        v_1 = work[12 * LANES + k]
        n_2 = work[13 * LANES + k]
        d_2 = work[14 * LANES + k]
        e_2 = work[15 * LANES + k]
        v_2 = work[16 * LANES + k]
        a1, b1, w1, x_r, T_1 = _rates(p_im, p_em, omega, x_r, T_1, n_0, d_0, e_0, v_0, c)
        a2, b2, w2, x_r, T_1 = _rates(
            p_im + 0.5 * h * a1, p_em + 0.5 * h * b1, omega + 0.5 * h * w1, x_r, T_1, n_1, d_1, e_1, v_1, c
        )
        a3, b3, w3, x_r, T_1 = _rates(
            p_im + 0.5 * h * a2, p_em + 0.5 * h * b2, omega + 0.5 * h * w2, x_r, T_1, n_1, d_1, e_1, v_1, c
        )
        a4, b4, w4, x_r, T_1 = _rates(p_im + h * a3, p_em + h * b3, omega + h * w3, x_r, T_1, n_2, d_2, e_2, v_2, c)
        work[k] = _limit(p_im + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4), P_IM_LOW * c.p_amb, P_IM_HIGH * c.p_amb)
        work[LANES + k] = _limit(p_em + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4), P_EM_LOW * c.p_amb, P_EM_HIGH * c.p_amb)
        work[2 * LANES + k] = _limit(omega + h / 6.0 * (w1 + 2.0 * (w2 + w3) + w4), OMEGA_LOW, OMEGA_HIGH)
        work[3 * LANES + k] = x_r
        work[4 * LANES + k] = T_1


def _integrate(grids, grid_of_lane, steps, time, constants, initial, out):  # type: ignore[no-untyped-def]
    """Integrate one block of LANES lanes.

    grids (G, 4, 2 N + 1), grid_of_lane (LANES,), steps (n - 1,), time (n,), constants (n_constants, LANES),
    initial (LANES, 3) -> out (LANES, n, N_OUT): p_im, p_em, omega_t, x_r, T_1, then `sensors.READ`.
    """
    work = np.empty((CONSTANTS_AT + constants.shape[0]) * LANES)
    state = work[: N_STATES * LANES]
    for j in range(constants.shape[0]):
        for k in range(LANES):
            work[(CONSTANTS_AT + j) * LANES + k] = constants[j, k]
    for k in range(LANES):
        for j in range(3):
            state[j * LANES + k] = initial[k, j]
        state[3 * LANES + k] = X_R_START
        state[4 * LANES + k] = T_1_START
    at = 0
    for i in range(time.shape[0]):
        for k in range(LANES):  # x_r, T_1 converged at the sample, and what the sensors see
            c = load_constants(work, CONSTANTS_AT * LANES + k, LANES)
            g = grid_of_lane[k]
            n_e = grids[g, 0, at]
            u_delta = grids[g, 1, at]
            p_im = state[k]
            p_em = state[LANES + k]
            x_r = state[3 * LANES + k]
            T_1 = state[4 * LANES + k]
            for _sweep in range(SAMPLE_SWEEPS if i > 0 else START_SWEEPS):
                s = settle_cylinder(p_im, p_em, n_e, u_delta, x_r, T_1, c)
                x_r, T_1 = s.x_r, s.T_1
            state[3 * LANES + k] = x_r
            state[4 * LANES + k] = T_1
            q = quantities(
                p_im, p_em, state[2 * LANES + k], x_r, T_1, n_e, u_delta, grids[g, 2, at], grids[g, 3, at], c
            )
            out[k, i, 0] = p_im
            out[k, i, 1] = p_em
            out[k, i, 2] = state[2 * LANES + k]
            out[k, i, 3] = x_r
            out[k, i, 4] = T_1
            store_readings(out, k, i, q)
        if i + 1 < time.shape[0]:
            h = (time[i + 1] - time[i]) / steps[i]
            for _step in range(steps[i]):
                for m in range(3):
                    for j in range(4):
                        for k in range(LANES):
                            work[(N_STATES + 4 * m + j) * LANES + k] = grids[grid_of_lane[k], j, at + m]
                advance(work, h)
                at += 2


X_R_START, T_1_START = 0.03, 310.0  # start of the cylinder's fixed point, as in the published simulation
SAMPLE_SWEEPS = 2  # pairs of sweeps at a sample: the warm start is off by a step's change, 1e-3; 20**-4 of it remains
START_SWEEPS = 6  # pairs of sweeps from the cold start


def _variant(function: Any, suffix: str, lanes: int, **functions: Any) -> Any:
    """The same kernel for another number of lanes: globals are compile-time constants to numba."""
    scope = {**function.__globals__, "LANES": lanes, **functions}
    copy = types.FunctionType(function.__code__, scope, function.__name__ + suffix)
    copy.__qualname__ = function.__qualname__ + suffix  # numba names cache files by it
    copy.__module__ = function.__module__
    return copy


advance = numba.njit(**_OPTIONS)(_advance)
integrate_block = kernel(**_OPTIONS)(_integrate)
"""Integrate a block of eight lanes."""

_advance_one = numba.njit(**_OPTIONS)(_variant(_advance, "_one", 1))
integrate_one = kernel(**_OPTIONS)(_variant(_integrate, "_one", 1, advance=_advance_one))
"""Integrate a single lane."""


@kernel(**_OPTIONS)
def follow_lags(time, u, taus):  # type: ignore[no-untyped-def]
    """States (len(taus), len(time)) of first-order lags that follow u, linear between `time`, settled at the start."""
    out = np.empty((taus.shape[0], time.shape[0]))
    for j in range(taus.shape[0]):
        out[j, 0] = u[0]
        for i in range(time.shape[0] - 1):
            out[j, i + 1] = actuator_update(out[j, i], u[i], u[i + 1], time[i + 1] - time[i], taus[j])
    return out


@kernel(**_OPTIONS)
def follow_lanes(time, u, tau):  # type: ignore[no-untyped-def]
    """First-order lags behind u (B, n), linear between samples, settled at the start.

    tau (B, n): of a sample holds over the interval after it; 0: none.
    """
    out = np.empty_like(u)
    for k in range(u.shape[0]):
        out[k, 0] = u[k, 0]
        for i in range(time.shape[0] - 1):
            if tau[k, i] > 0.0:
                out[k, i + 1] = actuator_update(out[k, i], u[k, i], u[k, i + 1], time[i + 1] - time[i], tau[k, i])
            else:
                out[k, i + 1] = u[k, i + 1]
    return out


JUMP_S = 1e-6
"""How long a jump takes in a signal that is linear between its break points [s]."""


@kernel(**_OPTIONS)
def follow_play(time, u, width):  # type: ignore[no-untyped-def]
    """Break points of a play operator's output: times, values (3 n,) and how many of them there are."""
    n = time.shape[0]
    times, values = np.empty(3 * n), np.empty(3 * n)
    times[0], values[0] = time[0], u[0]
    count = 1
    y = u[0]
    for i in range(n - 1):
        half = 0.5 * width[i]
        here = play_output(y, u[i], half)
        if here != y:  # the play has become narrower, so that the output jumps
            times[count - 1] = max(times[count - 1] - JUMP_S, times[count - 2])
            times[count], values[count] = time[i], here
            count += 1
            y = here
        following = play_output(y, u[i + 1], half)
        if following != y:
            share = (play_edge(y, following, half) - u[i]) / (u[i + 1] - u[i])
            if 0.0 < share < 1.0:
                times[count], values[count] = time[i] + share * (time[i + 1] - time[i]), y
                count += 1
        y = following
        times[count], values[count] = time[i + 1], y
        count += 1
    return times, values, count


intake_oxygen_rate = _model.intake_oxygen_rate
exhaust_oxygen_rate = _model.exhaust_oxygen_rate
cylinder_out_oxygen = _model.cylinder_out_oxygen
X_OC = _OXYGEN_OF_AIR


@kernel(**_OPTIONS)
def follow_oxygen(time, p_im, p_em, T_em, W_c, W_egr, W_ei, W_f, W_eo, constants):  # type: ignore[no-untyped-def]
    """Oxygen mass fractions in both manifolds by Heun's method over the simulator's own steps; started at rest."""
    c = load_constants(constants, 0, 1)
    n = time.shape[0]
    intake = np.empty(n)
    exhaust = np.empty(n)
    x_im = X_OC
    x_em = X_OC
    for _ in range(OXYGEN_REST_SWEEPS):  # mixing of both manifolds at the first sample
        x_em = cylinder_out_oxygen(x_im, W_ei[0], W_f[0], c)
        x_im = (W_egr[0] * x_em + W_c[0] * X_OC) / (W_egr[0] + W_c[0])
    intake[0] = x_im
    exhaust[0] = x_em
    for i in range(n - 1):
        h = time[i + 1] - time[i]
        a1 = intake_oxygen_rate(x_im, x_em, p_im[i], W_c[i], W_egr[i], c)
        x_e = cylinder_out_oxygen(x_im, W_ei[i], W_f[i], c)
        b1 = exhaust_oxygen_rate(x_em, x_e, p_em[i], T_em[i], W_eo[i], c)
        y_im = x_im + h * a1
        y_em = x_em + h * b1
        a2 = intake_oxygen_rate(y_im, y_em, p_im[i + 1], W_c[i + 1], W_egr[i + 1], c)
        y_e = cylinder_out_oxygen(y_im, W_ei[i + 1], W_f[i + 1], c)
        b2 = exhaust_oxygen_rate(y_em, y_e, p_em[i + 1], T_em[i + 1], W_eo[i + 1], c)
        x_im += 0.5 * h * (a1 + a2)
        x_em += 0.5 * h * (b1 + b2)
        intake[i + 1] = x_im
        exhaust[i + 1] = x_em
    return intake, exhaust


OXYGEN_REST_SWEEPS = 50
