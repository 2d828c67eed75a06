"""Compiled right-hand side of the extended model, of eight lanes at once: effects, signals and corrected maps.

As in `_compiled` all that the lanes are made of stands in one flat work array. One evaluation serves the four stages of
a step and the samples: its text is long, and so is its compilation.
"""

from __future__ import annotations

from typing import Any

import numba

from dieseltwin.engine import unrestricted
from dieseltwin.engine._compiled import (
    _INLINED,
    _OPTIONS,
    LANES,
    N_READ,
    _limit,
    _model,
    _variant,
    load_constants,
    readings_stored,
)
from dieseltwin.engine.binding import bind, functions_of
from dieseltwin.engine.effects import STATE_EFFECTS, Magnitudes
from dieseltwin.engine.map_corrections import GRIDS, OF_RATIO
from dieseltwin.engine.quantities import Gas, OperatingPoint, Signals
from dieseltwin.inner import inner
from dieseltwin.sensors import READ

N_EFFECTS, N_POINTS = len(STATE_EFFECTS), len(Signals._fields)
N_CORRECTED = len(GRIDS)
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
CORRECTION = SLOPE + N_POINTS  # relative, on `map_corrections.GRIDS`
ARGUMENT = CORRECTION + N_CORRECTED  # of the corrections: u_egr, u_vgt, Pi_t, Pi_c, Psi_c, BSR, W_cc, omega_c
FRACTION = ARGUMENT + 8  # of the interval between samples that has passed, for the signals
P_BC = FRACTION + 1  # before the compressor and behind the turbine, of the evaluation before
P_ES = P_BC + 1
CONSTANT = P_ES + 1


_free_model = bind("numba", {
    name: inner(**_INLINED)(function) for name, function in functions_of(unrestricted).items()
})  # fmt: skip
driven = _model.driven
intake_side = _free_model.intake_side
exhaust_side = _free_model.exhaust_side
charge_constants = _model.charge_constants
cylinder_sweep = _model.cylinder_sweep
exhaust_to_intake_ratio = _model.exhaust_to_intake_ratio
map_arguments = _model.map_arguments
blade_speed_ratio = _model.blade_speed_ratio
corrected_flow = _model.corrected_flow


def _loader(name: str, kind: Any, first: int, moving: bool = False) -> Any:
    fields = [f"work[{first + j} * lanes + k]" for j in range(len(kind._fields))]
    if moving:
        slopes = [f"work[{FRACTION} * lanes + k] * work[{SLOPE + j} * lanes + k]" for j in range(len(fields))]
        fields = [f"{value} + {slope}" for value, slope in zip(fields, slopes, strict=True)]
        for row, (point, _) in enumerate(GRIDS):
            fields[Signals._fields.index(point)] += f" + work[{CORRECTION + row} * lanes + k]"
    scope: dict[str, Any] = {"Kind": kind, "__name__": __name__}
    exec(f"def {name}(work, k, lanes):\n    return Kind({', '.join(fields)})\n", scope)
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
def correct_maps(work, tables, low, per_unit):  # type: ignore[no-untyped-def]
    """Corrections of the maps at the lanes' own arguments (`map_corrections.GRIDS`); no tables, no corrections.

    What follows from the flows among the arguments (the compressor's flow, pressures behind a filter and before a
    silencer, the exhaust's temperature) is that of the evaluation before. The arguments come first, in a loop by
    themselves: with look-ups in it, powers would be taken lane by lane.
    """
    if tables.shape[0] == 0:
        return
    for k in range(LANES):
        c = load_constants(work, CONSTANT * LANES + k, LANES)
        m, s = load_magnitudes(work, k, LANES), load_signals(work, k, LANES)
        x = driven(load_point(work, k, LANES), m, s, c)
        p_bc, p_es, T_em = work[P_BC * LANES + k], work[P_ES * LANES + k], work[GAS * LANES + k]
        at = map_arguments(x.p_im, x.p_em, x.omega_t, p_bc, p_es, T_em, c)
        work[ARGUMENT * LANES + k] = x.u_egr
        work[(ARGUMENT + 1) * LANES + k] = x.u_vgt
        work[(ARGUMENT + 2) * LANES + k] = at.Pi_t
        work[(ARGUMENT + 3) * LANES + k] = at.Pi_c
        work[(ARGUMENT + 4) * LANES + k] = at.Psi_c
        work[(ARGUMENT + 6) * LANES + k] = corrected_flow(work[W_C * LANES + k], c)
        work[(ARGUMENT + 7) * LANES + k] = at.omega_c
    _look_up(work, tables, 0, low, per_unit, 0, INPUT)
    _look_up(work, tables, 1, low, per_unit, ARGUMENT, INPUT)  # of one argument: alike along the other
    _look_up(work, tables, 2, low, per_unit, ARGUMENT + 1, ARGUMENT + 2)
    _look_up(work, tables, 3, low, per_unit, 2, ARGUMENT + 2)
    _look_up(work, tables, 4, low, per_unit, ARGUMENT + 6, ARGUMENT + 3)
    _look_up(work, tables, 5, low, per_unit, ARGUMENT + 4, ARGUMENT + 7)
    if tables.shape[0] > OF_RATIO:
        for k in range(LANES):
            c = load_constants(work, CONSTANT * LANES + k, LANES)
            omega_t, T_em, Pi_t = work[2 * LANES + k], work[GAS * LANES + k], work[(ARGUMENT + 2) * LANES + k]
            work[(ARGUMENT + 5) * LANES + k] = blade_speed_ratio(omega_t, T_em, Pi_t, c)
        _look_up(work, tables, OF_RATIO, low, per_unit, 2, ARGUMENT + 5)


def _evaluate(work):  # type: ignore[no-untyped-def]
    """Rates and outputs of all lanes at the states and inputs in `work`, two sweeps of the cylinder's fixed point."""
    for k in range(LANES):
        c = load_constants(work, CONSTANT * LANES + k, LANES)
        m = load_magnitudes(work, k, LANES)
        s = load_signals(work, k, LANES)
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
        work[P_BC * LANES + k] = q.p_bc
        work[P_ES * LANES + k] = q.p_es
        store_readings(work, k, LANES, q)


evaluate = numba.njit(**_OPTIONS)(_evaluate)
"""Rates and outputs without the effects of `effects.IMPLICIT`."""

evaluate_restricted = numba.njit(**_OPTIONS)(
    _variant(_evaluate, "_restricted", LANES, intake_side=_model.intake_side, exhaust_side=_model.exhaust_side)
)
"""Rates and outputs with them."""
