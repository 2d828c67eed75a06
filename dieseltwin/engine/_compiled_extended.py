"""Compiled kernel of the extended model: RK4 in lockstep lanes with effects, signals and restarts.

As in `_compiled` eight lanes advance together in one flat work array. Here one compiled evaluation of the right-hand
side serves the four stages and the samples: its text is long, and so is its compilation.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from dieseltwin.engine._compiled import (
    _INLINED,
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
    _model,
    _variant,
    load_constants,
    readings_stored,
)
from dieseltwin.engine.binding import bind
from dieseltwin.engine.effects import DRIFTS, GAS_LAG, STATE_EFFECTS, Magnitudes
from dieseltwin.engine.map_corrections import CORRECTED_POINTS
from dieseltwin.engine.model_constants import CONSTANT_NAMES
from dieseltwin.engine.quantities import Gas, OperatingPoint, Signals
from dieseltwin.inner import inner
from dieseltwin.sensors import READ

N_EFFECTS, N_POINTS = len(STATE_EFFECTS), len(Signals._fields)
N_CORRECTED = len(CORRECTED_POINTS)
N_STATES = 6  # p_im, p_em, omega_t, x_r, T_1, T_gas
N_OUT = N_STATES + N_READ

# Rows of the flat work array, in units of LANES.
GAS, GAIN, CARRY = 5, 6, 7  # behind p_im, p_em, omega_t, x_r, T_1
INPUT = 8  # n_e, u_delta, u_egr, u_vgt
RATE = 12  # dp_im, dp_em, domega_t
STATIC = 15
READING = 16  # `sensors.READ`
T_EM, W_C = READING + READ.index("T_em"), READING + READ.index("W_c")
EFFECT = READING + N_READ
SIGNAL = EFFECT + N_EFFECTS  # value at the sample before
SLOPE = SIGNAL + N_POINTS  # change until the sample after
CORRECTION = SLOPE + N_POINTS  # relative, at `CORRECTED_POINTS`
ARGUMENT = CORRECTION + N_CORRECTED  # of the corrections: u_egr, u_vgt, Pi_t, Pi_c, Psi_c
CONSTANT = ARGUMENT + 5

INERTIA = STATE_EFFECTS.index(GAS_LAG)
GROWS = np.array(DRIFTS)
P_AMB = CONSTANT_NAMES.index("p_amb")


@inner(**_INLINED)
def _free_inlet(x, m, s, c):  # type: ignore[no-untyped-def]
    return c.p_amb * (1.0 + s.p_bc)


@inner(**_INLINED)
def _free_outlet(x, T_em, m, s, c):  # type: ignore[no-untyped-def]
    return c.p_amb * (1.0 + s.p_es)


_free_model = bind("numba", {"inlet_pressure": _free_inlet, "outlet_pressure": _free_outlet})
driven = _model.driven
intake_side = _free_model.intake_side
exhaust_side = _free_model.exhaust_side
charge_constants = _model.charge_constants
cylinder_sweep = _model.cylinder_sweep
exhaust_to_intake_ratio = _model.exhaust_to_intake_ratio
compressor_pressure_ratio = _model.compressor_pressure_ratio
turbine_pressure_ratio = _model.turbine_pressure_ratio
energy_transfer_coefficient = _model.energy_transfer_coefficient


def _loader(name: str, kind: Any, first: int, moving: bool = False) -> Any:
    fields = [f"work[{first + j} * lanes + k]" for j in range(len(kind._fields))]
    if moving:
        slopes = [f"fraction * work[{SLOPE + j} * lanes + k]" for j in range(len(fields))]
        fields = [f"{value} + {slope}" for value, slope in zip(fields, slopes, strict=True)]
        for row, point in enumerate(CORRECTED_POINTS):
            fields[Signals._fields.index(point)] += f" + work[{CORRECTION + row} * lanes + k]"
    scope: dict[str, Any] = {"Kind": kind, "__name__": __name__}
    exec(f"def {name}(work, k, lanes, fraction):\n    return Kind({', '.join(fields)})\n", scope)
    return inner(**_INLINED)(scope[name])


load_magnitudes = _loader("load_magnitudes", Magnitudes, EFFECT)
load_signals = _loader("load_signals", Signals, SIGNAL, moving=True)
store_readings = readings_stored("work, k, lanes", f"work[({READING} + {{j}}) * lanes + k]")


@inner(**_INLINED)
def load_point(work, k, lanes):  # type: ignore[no-untyped-def]
    return OperatingPoint(
        work[k], work[lanes + k], work[2 * lanes + k], work[3 * lanes + k], work[4 * lanes + k],
        work[INPUT * lanes + k], work[(INPUT + 1) * lanes + k], work[(INPUT + 2) * lanes + k],
        work[(INPUT + 3) * lanes + k],
    )  # fmt: skip


@inner(**_INLINED)
def _look_up(work, tables, row, low, per_unit, at_x, at_y):  # type: ignore[no-untyped-def]
    """Correction of one map, bilinear and held beyond the edges; its arguments are rows of `work`."""
    last = tables.shape[1] - 1
    for k in range(LANES):
        a = _limit((work[at_x * LANES + k] - low[row, 0]) * per_unit[row, 0], 0.0, last)
        b = _limit((work[at_y * LANES + k] - low[row, 1]) * per_unit[row, 1], 0.0, last)
        i = min(int(a), last - 1)
        j = min(int(b), last - 1)
        a -= i
        b -= j
        work[(CORRECTION + row) * LANES + k] = (1.0 - a) * (
            (1.0 - b) * tables[row, i, j] + b * tables[row, i, j + 1]
        ) + a * ((1.0 - b) * tables[row, i + 1, j] + b * tables[row, i + 1, j + 1])


@numba.njit(**_OPTIONS)
def correct_maps(work, fraction, tables, low, per_unit):  # type: ignore[no-untyped-def]
    """Corrections of the maps at the lanes' own arguments (`map_corrections.ARGUMENTS`); no tables, no corrections.

    The compressor's flow among the arguments is that of the evaluation before; a filter's loss isn't. The arguments
    come first, in a loop by themselves: with look-ups in it, powers would be taken lane by lane.
    """
    if tables.shape[0] == 0:
        return
    for k in range(LANES):
        c = load_constants(work, CONSTANT * LANES + k, LANES)
        m, s = load_magnitudes(work, k, LANES, fraction), load_signals(work, k, LANES, fraction)
        x = driven(load_point(work, k, LANES), m, s, c)
        Pi_c = compressor_pressure_ratio(x.p_im, c)
        work[ARGUMENT * LANES + k] = x.u_egr
        work[(ARGUMENT + 1) * LANES + k] = x.u_vgt
        work[(ARGUMENT + 2) * LANES + k] = turbine_pressure_ratio(x.p_em, c)
        work[(ARGUMENT + 3) * LANES + k] = Pi_c
        work[(ARGUMENT + 4) * LANES + k] = energy_transfer_coefficient(c.T_amb, Pi_c, x.omega_t, c)
    _look_up(work, tables, 0, low, per_unit, 0, INPUT)
    _look_up(work, tables, 1, low, per_unit, ARGUMENT, INPUT)  # of one argument: alike along the other
    _look_up(work, tables, 2, low, per_unit, ARGUMENT + 1, ARGUMENT + 2)
    _look_up(work, tables, 3, low, per_unit, 2, ARGUMENT + 2)
    _look_up(work, tables, 4, low, per_unit, W_C, ARGUMENT + 3)
    _look_up(work, tables, 5, low, per_unit, ARGUMENT + 4, 2)


def _evaluate(work, fraction):  # type: ignore[no-untyped-def]
    """Rates and outputs of all lanes at the states and inputs in `work`, two sweeps of the cylinder's fixed point.

    fraction: of the interval between samples that has passed, for the signals.
    """
    for k in range(LANES):
        c = load_constants(work, CONSTANT * LANES + k, LANES)
        m = load_magnitudes(work, k, LANES, fraction)
        s = load_signals(work, k, LANES, fraction)
        x = driven(load_point(work, k, LANES), m, s, c)
        gas = Gas(work[GAS * LANES + k], work[GAIN * LANES + k], work[CARRY * LANES + k])
        i = intake_side(x, gas, m, s, c)
        warm = cylinder_sweep(
            exhaust_to_intake_ratio(x.p_em, x.p_im), i.W_ei, i.W_f, x.x_r, x.T_1, charge_constants(i, x, m, s, c)
        )
        x = OperatingPoint(x.p_im, x.p_em, x.omega_t, warm.x_r, warm.T_1, x.n_e, x.u_delta, x.u_egr, x.u_vgt)
        q = exhaust_side(i, x, gas, m, s, c)
        work[3 * LANES + k] = q.x_r_next
        work[4 * LANES + k] = q.T_1_next
        work[GAS * LANES + k] = q.T_em
        work[RATE * LANES + k] = q.dp_im
        work[(RATE + 1) * LANES + k] = q.dp_em
        work[(RATE + 2) * LANES + k] = q.domega_t
        work[STATIC * LANES + k] = q.T_em_static
        store_readings(work, k, LANES, q)


evaluate = numba.njit(**_OPTIONS)(_evaluate)

@numba.njit(**_OPTIONS)
def load_interval(  # type: ignore[no-untyped-def]
    work, i, time, start, magnitudes, schedules, schedule_of_lane, signals, lane_point, lane_signal
):
    """Magnitudes at sample i and the signals from there to the next sample."""
    following = min(i + 1, time.shape[0] - 1)
    for e in range(N_EFFECTS):
        since = max(time[i] - start, 0.0) if GROWS[e] else 1.0
        for k in range(LANES):
            work[(EFFECT + e) * LANES + k] = schedules[schedule_of_lane[k], e, i] * since * magnitudes[e, k]
    for p in range(N_POINTS):
        for k in range(LANES):
            work[(SIGNAL + p) * LANES + k] = signals[p, i]
            work[(SLOPE + p) * LANES + k] = signals[p, following] - signals[p, i]
    for k in range(LANES):
        p = lane_point[k]
        if p >= 0:
            work[(SIGNAL + p) * LANES + k] += lane_signal[k, i]
            work[(SLOPE + p) * LANES + k] += lane_signal[k, following] - lane_signal[k, i]


@numba.njit(**_OPTIONS)
def load_inputs(work, grids, grid_of_lane, at):  # type: ignore[no-untyped-def]
    for j in range(4):
        for k in range(LANES):
            work[(INPUT + j) * LANES + k] = grids[grid_of_lane[k], j, at]


@numba.njit(**_OPTIONS)
def hold_gas(work, carried):  # type: ignore[no-untyped-def]
    """Gas at the start of a step: the lagged temperature where there is thermal inertia."""
    for k in range(LANES):
        inert = work[(EFFECT + INERTIA) * LANES + k] > 0.0
        work[GAIN * LANES + k] = 0.0 if inert else 1.0
        work[CARRY * LANES + k] = carried[k] if inert else 0.0


@numba.njit(**_OPTIONS)
def relax_gas(work, carried, static, gain, kept):  # type: ignore[no-untyped-def]
    """Gas within a step: exact solution of the lag for a static temperature that runs linearly from `static`."""
    for k in range(LANES):
        work[GAIN * LANES + k] = 1.0 - gain[k]
        work[CARRY * LANES + k] = (gain[k] - kept[k]) * static[k] + kept[k] * carried[k]


@numba.njit(**_OPTIONS)
def lag_weights(work, width, gain, kept):  # type: ignore[no-untyped-def]
    for k in range(LANES):
        tau = work[(EFFECT + INERTIA) * LANES + k]
        gain[k] = 0.0
        kept[k] = 0.0
        if tau > 0.0:
            kept[k] = np.exp(-width / tau)
            gain[k] = tau / width * (1.0 - kept[k])


def _integrate_extended(  # type: ignore[no-untyped-def]
    grids, grid_of_lane, steps, time, start, constants, magnitudes, schedules, schedule_of_lane, signals, lane_point,
    lane_signal, restarts, initial, late, tables, low_end, per_unit, part, out,
):  # fmt: skip
    """Integrate one block of LANES lanes over a part of the samples, which starts at a restart.

    The last stage starts from `late` of the third stage's rate and the rest of the second's. With 1 that is RK4; with
    less it is of third order, and stable up to longer steps.

    grids (G, 4, 2 N + 1), grid_of_lane (LANES,), steps (n - 1,), time (n,), start [s], constants (n_constants, LANES),
    magnitudes (N_EFFECTS, LANES), schedules (G', N_EFFECTS, n), schedule_of_lane (LANES,), signals (N_POINTS, n),
    lane_point (LANES,), lane_signal (LANES, n), restarts (W,), initial (LANES, W, 3), late [-],
    tables (0 or N_CORRECTED, nodes, nodes) [-] over grids from low_end (N_CORRECTED, 2) with per_unit (N_CORRECTED, 2)
    nodes a unit, part (4,): first sample, the one behind the last, the first's place in `grids` and its restart
    -> out (LANES, n, N_OUT), the part's rows.
    """
    work = np.zeros((CONSTANT + constants.shape[0]) * LANES)
    for j in range(constants.shape[0]):
        for k in range(LANES):
            work[(CONSTANT + j) * LANES + k] = constants[j, k]
    base = np.empty(3 * LANES)
    total = np.empty(3 * LANES)
    second = np.empty(3 * LANES)
    carried = np.empty(LANES)
    static = np.empty(LANES)
    half_gain, half_kept = np.empty(LANES), np.empty(LANES)
    full_gain, full_kept = np.empty(LANES), np.empty(LANES)
    low = np.empty(3 * LANES)
    high = np.empty(3 * LANES)
    for k in range(LANES):
        work[3 * LANES + k] = X_R_START
        work[4 * LANES + k] = T_1_START
        work[GAS * LANES + k] = T_GAS_START
        carried[k] = T_GAS_START
        p_amb = work[(CONSTANT + P_AMB) * LANES + k]
        low[k], high[k] = P_IM_LOW * p_amb, P_IM_HIGH * p_amb
        low[LANES + k], high[LANES + k] = P_EM_LOW * p_amb, P_EM_HIGH * p_amb
        low[2 * LANES + k], high[2 * LANES + k] = OMEGA_LOW, OMEGA_HIGH
    begin, end, at, window = part
    for i in range(begin, end):
        if window < restarts.shape[0] and restarts[window] == i:
            for k in range(LANES):
                for j in range(3):
                    work[j * LANES + k] = initial[k, window, j]
            window += 1
        load_interval(
            work, i, time, start, magnitudes, schedules, schedule_of_lane, signals, lane_point, lane_signal
        )
        load_inputs(work, grids, grid_of_lane, at)
        hold_gas(work, carried)
        if i == begin:  # at rest: the gas, too
            for k in range(LANES):
                work[GAIN * LANES + k] = 1.0
                work[CARRY * LANES + k] = 0.0
        for _sweep in range(START_SWEEPS if i == begin else SAMPLE_SWEEPS):
            correct_maps(work, 0.0, tables, low_end, per_unit)
            evaluate(work, 0.0)
        if i == begin:
            for k in range(LANES):
                carried[k] = work[T_EM * LANES + k]
        for k in range(LANES):
            out[k, i, 3] = work[3 * LANES + k]
            out[k, i, 4] = work[4 * LANES + k]
            out[k, i, 5] = work[GAS * LANES + k]
        correct_maps(work, 0.0, tables, low_end, per_unit)
        evaluate(work, 0.0)
        for k in range(LANES):
            for j in range(3):
                out[k, i, j] = work[j * LANES + k]
            for j in range(N_READ):
                out[k, i, N_STATES + j] = work[(READING + j) * LANES + k]
            carried[k] = work[T_EM * LANES + k]
        if i + 1 == end:
            break
        h = (time[i + 1] - time[i]) / steps[i]
        lag_weights(work, 0.5 * h, half_gain, half_kept)
        lag_weights(work, h, full_gain, full_kept)
        for step in range(steps[i]):
            for j in range(3 * LANES):  # slices would bring numba's text of a shape error, seconds of compilation
                base[j] = work[j]
            if step > 0:  # the first step's first stage is the sample's own evaluation
                load_inputs(work, grids, grid_of_lane, at)
                hold_gas(work, carried)
                correct_maps(work, step / steps[i], tables, low_end, per_unit)
                evaluate(work, step / steps[i])
            for k in range(LANES):
                static[k] = work[STATIC * LANES + k]
            load_inputs(work, grids, grid_of_lane, at + 1)
            relax_gas(work, carried, static, half_gain, half_kept)
            for j in range(3 * LANES):
                rate = work[RATE * LANES + j]
                total[j] = rate
                work[j] = base[j] + 0.5 * h * rate
            correct_maps(work, (step + 0.5) / steps[i], tables, low_end, per_unit)
            evaluate(work, (step + 0.5) / steps[i])
            relax_gas(work, carried, static, half_gain, half_kept)
            for j in range(3 * LANES):
                rate = work[RATE * LANES + j]
                total[j] += 2.0 * rate
                second[j] = rate
                work[j] = base[j] + 0.5 * h * rate
            correct_maps(work, (step + 0.5) / steps[i], tables, low_end, per_unit)
            evaluate(work, (step + 0.5) / steps[i])
            load_inputs(work, grids, grid_of_lane, at + 2)
            relax_gas(work, carried, static, full_gain, full_kept)
            for j in range(3 * LANES):
                rate = work[RATE * LANES + j]
                total[j] += 2.0 * rate
                work[j] = base[j] + h * (late * rate + (1.0 - late) * second[j])
            correct_maps(work, (step + 1.0) / steps[i], tables, low_end, per_unit)
            evaluate(work, (step + 1.0) / steps[i])
            for j in range(3 * LANES):
                value = base[j] + h / 6.0 * (total[j] + work[RATE * LANES + j])
                work[j] = _limit(value, low[j], high[j])
            for k in range(LANES):
                carried[k] = work[T_EM * LANES + k]
            at += 2


T_GAS_START = 700.0  # K, start of the fixed point of the gas temperature

integrate_free = numba.njit(cache=True, **_OPTIONS)(_integrate_extended)
"""Integrate a block without the effects of `effects.IMPLICIT`."""

_evaluate_restricted = numba.njit(**_OPTIONS)(
    _variant(_evaluate, "_restricted", LANES, intake_side=_model.intake_side, exhaust_side=_model.exhaust_side)
)
integrate_restricted = numba.njit(cache=True, **_OPTIONS)(
    _variant(_integrate_extended, "_restricted", LANES, evaluate=_evaluate_restricted)
)
"""Integrate a block with them."""
