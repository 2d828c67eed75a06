"""Compiled kernel of the extended model: RK4 in eight lanes with effects, signals and restarts.

As in `_compiled` eight lanes share every evaluation of the right-hand side (`_compiled_rates`). Here each of them is at
a place of its own, so that windows of one recording fill them as well as many parameter sets do: otherwise one set
takes as long as eight.
"""

from __future__ import annotations

import numba
import numpy as np

from dieseltwin.engine._compiled import (
    _OPTIONS,
    LANES,
    N_READ,
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
    _limit,
    _variant,
)
from dieseltwin.engine._compiled_rates import (
    CARRY,
    CONSTANT,
    EFFECT,
    FRACTION,
    GAIN,
    GAS,
    INPUT,
    N_EFFECTS,
    N_POINTS,
    N_STATES,
    P_BC,
    P_ES,
    RATE,
    READING,
    SIGNAL,
    SLOPE,
    STATIC,
    T_EM,
    W_C,
    correct_maps,
    evaluate,
    evaluate_restricted,
)
from dieseltwin.engine.effects import GAS_LAG, STATE_EFFECTS
from dieseltwin.engine.model_constants import CONSTANT_NAMES
from dieseltwin.inner import kernel

INERTIA = STATE_EFFECTS.index(GAS_LAG)
P_AMB = CONSTANT_NAMES.index("p_amb")
T_GAS_START = 700.0  # K, start of the fixed point of the gas temperature

FIRST, SECOND, SETTLING, DONE = 0, 1, 2, 3
"""What a lane does in a pair of evaluations: first or second half of a step, sweeps at a sample, nothing any more."""

ON_ITS_WAY, AT_SAMPLE, AT_END = 0, 1, 2
"""Where a lane has come to: nowhere new, the next sample of its piece, the end of the piece."""


@numba.njit(**_OPTIONS)
def load_lane(work, k, lane, constants):  # type: ignore[no-untyped-def]
    """Constants of a lane, and the cylinder and the gas before anything is known of them."""
    for j in range(constants.shape[0]):
        work[(CONSTANT + j) * LANES + k] = constants[j, lane]
    work[GAIN * LANES + k] = 1.0
    work[CARRY * LANES + k] = 0.0


@numba.njit(**_OPTIONS)
def load_interval(  # type: ignore[no-untyped-def]
    work, k, lane, i, time, magnitudes, schedules, schedule_of_lane, signals, lane_point, lane_signal
):
    """Magnitudes of a lane at sample i and the signals from there to the next sample."""
    following = min(i + 1, time.shape[0] - 1)
    g = schedule_of_lane[lane]
    for e in range(N_EFFECTS):
        work[(EFFECT + e) * LANES + k] = schedules[g, e, i] * magnitudes[e, lane]
    for p in range(N_POINTS):
        work[(SIGNAL + p) * LANES + k] = signals[p, i]
        work[(SLOPE + p) * LANES + k] = signals[p, following] - signals[p, i]
    p = lane_point[lane]
    if p >= 0:
        work[(SIGNAL + p) * LANES + k] += lane_signal[lane, i]
        work[(SLOPE + p) * LANES + k] += lane_signal[lane, following] - lane_signal[lane, i]


@numba.njit(**_OPTIONS)
def load_restart(work, k, lane, window, initial):  # type: ignore[no-untyped-def]
    """The states at a restart; what settles there, settles from the same start wherever the lane comes from."""
    for j in range(3):
        work[j * LANES + k] = initial[lane, window, j]
    work[3 * LANES + k] = X_R_START
    work[4 * LANES + k] = T_1_START
    work[GAS * LANES + k] = T_GAS_START
    work[W_C * LANES + k] = 0.0
    work[P_BC * LANES + k] = work[P_ES * LANES + k] = work[(CONSTANT + P_AMB) * LANES + k]


@numba.njit(**_OPTIONS)
def load_inputs(work, grids, grid, at, fraction):  # type: ignore[no-untyped-def]
    """Inputs of every lane at its place in its grid, and the share of its interval that has passed."""
    for k in range(LANES):
        for j in range(4):
            work[(INPUT + j) * LANES + k] = grids[grid[k], j, at[k]]
        work[FRACTION * LANES + k] = fraction[k]


@numba.njit(**_OPTIONS)
def relax_gas(work, carried, static, gain, kept):  # type: ignore[no-untyped-def]
    """Gas of every lane: exact solution of the lag for a static temperature that runs linearly from `static`."""
    for k in range(LANES):
        work[GAIN * LANES + k] = 1.0 - gain[k]
        work[CARRY * LANES + k] = (gain[k] - kept[k]) * static[k] + kept[k] * carried[k]


def _integrate_extended(  # type: ignore[no-untyped-def]
    grids, grid_of_lane, steps, time, constants, magnitudes, schedules, schedule_of_lane, signals, lane_point,
    lane_signal, restarts, initial, late, tables, low_end, per_unit, pieces, out,
):  # fmt: skip
    """Integrate pieces of B lanes, LANES pieces abreast; who has done one takes the next.

    Every lane is at a sample and a step of its own. They share pairs of evaluations: a step takes two, the sweeps at a
    sample one (`START_SWEEPS`/2 at a restart). Neighbours don't touch each other: results don't depend on the order.

    The last stage starts from `late` of the third stage's rate and the rest of the second's. With 1 that is RK4; with
    less it is of third order, and stable up to longer steps.

    grids (G, 4, 2 N + 1), grid_of_lane (B,), steps (n - 1,), time (n,), constants (n_constants, B),
    magnitudes (N_EFFECTS, B), schedules (G', N_EFFECTS, n), schedule_of_lane (B,), signals (N_POINTS, n),
    lane_point (B,), lane_signal (B, n), restarts (W,), initial (B, W, 3), late [-],
    tables (0 or N_CORRECTED, nodes, nodes) [-] over grids from low_end (N_CORRECTED, 2) with per_unit (N_CORRECTED, 2)
    nodes a unit, pieces (M, 5): lane, first sample, the one behind the last, the first's place in `grids` and its
    restart -> out (B, n, N_OUT), the pieces' rows.
    """
    work = np.zeros((CONSTANT + constants.shape[0]) * LANES)
    base, total, second = np.zeros(3 * LANES), np.zeros(3 * LANES), np.zeros(3 * LANES)
    low, high = np.empty(3 * LANES), np.empty(3 * LANES)
    carried, static = np.full(LANES, T_GAS_START), np.full(LANES, T_GAS_START)
    gain, kept = np.zeros(LANES), np.zeros(LANES)
    half_gain, half_kept = np.zeros(LANES), np.zeros(LANES)
    full_gain, full_kept = np.zeros(LANES), np.zeros(LANES)
    h, share, fraction = np.ones(LANES), np.ones(LANES), np.zeros(LANES)
    lane, grid = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    place, at = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)  # in its grid: of the step, of the evaluation
    sample, end, window = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
    step, count, sweeps = np.zeros(LANES, np.int64), np.ones(LANES, np.int64), np.zeros(LANES, np.int64)
    resting = np.zeros(LANES, np.int64)  # the gas, too, until the first sample of a piece has settled
    phase = np.full(LANES, DONE)
    come = np.full(LANES, AT_END)
    lags = False
    for j in range(magnitudes.shape[1]):
        lags = lags or magnitudes[INERTIA, j] != 0.0
    taken, running = 0, 0
    arrived, sampling = True, False  # whether any lane has come anywhere; whether any stands at a settled sample
    while True:
        for k in range(LANES if arrived else 0):
            if come[k] == AT_END:
                running -= phase[k] != DONE
                phase[k] = DONE
                b = min(taken, pieces.shape[0] - 1)  # lanes that nothing is left for get something to go on with
                lane[k], sample[k], end[k] = pieces[b, 0], pieces[b, 1], pieces[b, 2]
                place[k], window[k] = pieces[b, 3], pieces[b, 4]
                grid[k] = grid_of_lane[lane[k]]
                load_lane(work, k, lane[k], constants)
                p_amb = work[(CONSTANT + P_AMB) * LANES + k]
                low[k], high[k] = P_IM_LOW * p_amb, P_IM_HIGH * p_amb
                low[LANES + k], high[LANES + k] = P_EM_LOW * p_amb, P_EM_HIGH * p_amb
                low[2 * LANES + k], high[2 * LANES + k] = OMEGA_LOW, OMEGA_HIGH
                carried[k], static[k] = T_GAS_START, T_GAS_START
                resting[k] = 1
                if taken < pieces.shape[0]:
                    running += 1
                    phase[k] = SETTLING
                taken += 1
            if come[k] != ON_ITS_WAY:
                i = sample[k]
                sweeps[k] = SAMPLE_SWEEPS
                if window[k] < restarts.shape[0] and restarts[window[k]] == i:
                    load_restart(work, k, lane[k], window[k], initial)
                    window[k] += 1
                    sweeps[k] = START_SWEEPS
                load_interval(
                    work, k, lane[k], i, time, magnitudes, schedules, schedule_of_lane, signals, lane_point,
                    lane_signal,
                )  # fmt: skip
                step[k] = 0
                if i + 1 < end[k]:
                    count[k] = steps[i]
                    share[k] = 1.0 / steps[i]
                    h[k] = (time[i + 1] - time[i]) / steps[i]
                if lags:
                    tau = work[(EFFECT + INERTIA) * LANES + k]
                    half_gain[k], half_kept[k], full_gain[k], full_kept[k] = 0.0, 0.0, 0.0, 0.0
                    if tau > 0.0:
                        half_kept[k], full_kept[k] = np.exp(-0.5 * h[k] / tau), np.exp(-h[k] / tau)
                        half_gain[k] = tau / (0.5 * h[k]) * (1.0 - half_kept[k])
                        full_gain[k] = tau / h[k] * (1.0 - full_kept[k])
                come[k] = ON_ITS_WAY
        arrived = False
        if running == 0:
            break

        # The first evaluation of the pair: at a step's start or, in its second half, at its middle.
        for k in range(LANES):
            at[k] = place[k] + (1 if phase[k] == SECOND else 0)
            fraction[k] = (step[k] + (0.5 if phase[k] == SECOND else 0.0)) * share[k]
        load_inputs(work, grids, grid, at, fraction)
        if lags:
            for k in range(LANES):
                held = 1.0 if work[(EFFECT + INERTIA) * LANES + k] > 0.0 and resting[k] == 0 else 0.0
                gain[k] = half_gain[k] if phase[k] == SECOND else held
                kept[k] = half_kept[k] if phase[k] == SECOND else held
            relax_gas(work, carried, static, gain, kept)
        correct_maps(work, tables, low_end, per_unit)
        evaluate(work)
        for k in range(LANES if sampling else 0):
            if phase[k] == FIRST and step[k] == 0:  # the sample itself
                i, b = sample[k], lane[k]
                for j in range(3):
                    out[b, i, j] = work[j * LANES + k]
                for j in range(N_READ):
                    out[b, i, N_STATES + j] = work[(READING + j) * LANES + k]
                carried[k] = work[T_EM * LANES + k]
                resting[k] = 0
                if i + 1 == end[k]:
                    come[k], arrived = AT_END, True
        for j in range(3):  # slices would bring numba's text of a shape error, seconds of compilation
            for k in range(LANES):
                m = j * LANES + k
                state, rate = work[m], work[(RATE + j) * LANES + k]
                base[m] = state if phase[k] == FIRST else base[m]
                total[m] = rate if phase[k] == FIRST else total[m] + 2.0 * rate
                middle = state + 0.5 * h[k] * rate
                last = base[m] + h[k] * (late * rate + (1.0 - late) * second[m])
                work[m] = middle if phase[k] == FIRST else (last if phase[k] == SECOND else state)

        # The second one: at a step's middle or, in its second half, at its end.
        for k in range(LANES):
            if phase[k] == FIRST:
                static[k] = work[STATIC * LANES + k]
            ahead = 1 if phase[k] == FIRST else (2 if phase[k] == SECOND else 0)
            at[k] = place[k] + (0 if come[k] == AT_END else ahead)
            fraction[k] = (step[k] + 0.5 * ahead) * share[k]
        load_inputs(work, grids, grid, at, fraction)
        if lags:
            for k in range(LANES):
                if phase[k] == FIRST:
                    gain[k], kept[k] = half_gain[k], half_kept[k]
                elif phase[k] == SECOND:
                    gain[k], kept[k] = full_gain[k], full_kept[k]
            relax_gas(work, carried, static, gain, kept)
        correct_maps(work, tables, low_end, per_unit)
        evaluate(work)
        for j in range(3):
            for k in range(LANES):
                m = j * LANES + k
                state, rate = work[m], work[(RATE + j) * LANES + k]
                second[m] = rate
                middle = base[m] + 0.5 * h[k] * rate
                after = _limit(base[m] + h[k] / 6.0 * (total[m] + rate), low[m], high[m])
                total[m] += 2.0 * rate
                work[m] = middle if phase[k] == FIRST else (after if phase[k] == SECOND else state)
        sampling = False
        for k in range(LANES):
            if phase[k] == FIRST:
                phase[k] = SECOND
            elif phase[k] == SECOND:
                carried[k] = work[T_EM * LANES + k]
                place[k] += 2
                step[k] += 1
                phase[k] = FIRST
                if step[k] == count[k]:
                    sample[k] += 1
                    phase[k] = SETTLING
                    come[k], arrived = AT_SAMPLE, True
            elif phase[k] == SETTLING:
                sweeps[k] -= 2
                if sweeps[k] <= 0:
                    if resting[k] == 1:
                        carried[k] = work[T_EM * LANES + k]
                    i, b = sample[k], lane[k]
                    out[b, i, 3] = work[3 * LANES + k]
                    out[b, i, 4] = work[4 * LANES + k]
                    out[b, i, 5] = work[GAS * LANES + k]
                    phase[k] = FIRST
                    sampling = True


integrate_free = kernel(**_OPTIONS)(_integrate_extended)
"""Integrate pieces without the effects of `effects.IMPLICIT`."""

integrate_restricted = kernel(**_OPTIONS)(
    _variant(_integrate_extended, "_restricted", LANES, evaluate=evaluate_restricted)
)
"""Integrate pieces with them."""
