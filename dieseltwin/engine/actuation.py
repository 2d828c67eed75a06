"""Actuator states from commands: dead time and lags, and the effects before them; exact for commands that run linearly.

Effects enter a command as a valve that stands still, play or further dead time, an input of the engine as a lag
(`effect.Entry`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.engine._compiled import JUMP_S, follow_lags, follow_lanes, follow_play
from dieseltwin.engine.effect import Entry, Operator, Through
from dieseltwin.engine.effects import ACTUATION_EFFECTS, EFFECTS
from dieseltwin.engine.egr import egr_valve_position
from dieseltwin.engine.inputs import DEFAULT_STEP_S, Actuation, Inputs, half_step_times, steps_between
from dieseltwin.engine.parameters import EngineParameters, constants
from dieseltwin.engine.terms import amounts, effect_terms
from dieseltwin.errors import InputError

_BY_ENTRY = {EFFECTS[name].enters: name for name in ACTUATION_EFFECTS}
_OF_COMMANDS: tuple[Operator, ...] = ("stuck", "play", "dead_time")


def play(time_s: np.ndarray, u: np.ndarray, width: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Output of a play operator as break points (times [s], values), shapes (m,) each, linear in between.

    Args:
        time_s, u: piecewise linear command, (n,); the output starts at u[0].
        width: full width of the play in the unit of u, one or one per sample, held over the following interval.
    """
    widths = np.broadcast_to(np.asarray(width, dtype=np.float64), u.shape)
    times, values, count = follow_play(time_s, u, np.ascontiguousarray(widths))
    return times[:count], values[:count]


def standing(
    time_s: np.ndarray, u: np.ndarray, position: float, acts: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """A command of a valve that stands still, as break points (times [s], values), linear in between.

    Args:
        time_s, u: piecewise linear command, (n,) each.
        position: where it stands [unit of u].
        acts: (n,) factor of the position over the interval behind each sample, 0 where the valve moves; None: it never
            does.
    """
    if acts is None:
        return time_s[[0, -1]], np.full(2, position)
    still = acts > 0.0
    at = np.where(still, position * acts, u)
    left = np.append(at[:1], np.where(still[:-1], at[:-1], u[1:]))  # what the interval before each sample ends with
    jumps = np.flatnonzero(left != at)
    return np.insert(time_s, jumps, time_s[jumps] - JUMP_S), np.insert(at, jumps, left[jumps])


def _behind_dead_time(
    knots: np.ndarray, values: np.ndarray, delay: float, more: float, factor: np.ndarray | None,
    time: np.ndarray, wanted: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Times and values of the delayed command at all its breaks and the wanted times, and where the wanted are among
    them; `more` is added where factor."""
    start = min(time[0], wanted[0])
    breaks = [np.array([start]), knots + delay]
    if more > 0.0:
        breaks.append(knots + delay + more)
        if factor is not None:  # it jumps where the factor does
            jumps = time[1:][np.diff(factor) != 0.0]
            breaks += [jumps - JUMP_S, jumps]
    inner = np.concatenate(breaks)
    merged, at_wanted = _merged(inner[(inner >= start) & (inner < wanted[-1])], wanted)
    delayed = np.interp(merged, knots + delay, values)
    if more > 0.0:
        later = np.interp(merged, knots + delay + more, values)
        at = np.clip(np.searchsorted(time, merged, side="right") - 1, 0, time.size - 1)
        share = np.ones(merged.size) if factor is None else factor[at]
        delayed = delayed + share * (later - delayed)
    return merged, delayed, at_wanted


def _merged(breaks: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All times once, in order, and where the wanted ones are, which are so already and many more than the breaks."""
    breaks = np.unique(breaks)
    before = np.searchsorted(wanted, breaks)
    fresh = wanted[np.minimum(before, wanted.size - 1)] != breaks
    own = np.zeros(wanted.size + np.count_nonzero(fresh), dtype=bool)
    own[before[fresh] + np.arange(np.count_nonzero(fresh))] = True
    merged = np.empty(own.size)
    merged[own], merged[~own] = breaks[fresh], wanted
    return merged, np.flatnonzero(~own)


def _behind_lag(
    time: np.ndarray, values: np.ndarray, tau: float, factor: np.ndarray | None, wanted: np.ndarray
) -> np.ndarray:
    """A signal behind a lag of tau [s], settled at its start, at the wanted times; tau is multiplied by factor (n,)."""
    merged, at_wanted = _merged(time, wanted)
    at = np.clip(np.searchsorted(time, merged, side="right") - 1, 0, time.size - 1)
    taus = np.full(merged.size, tau) if factor is None else tau * factor[at]
    lagged = follow_lanes(merged, np.interp(merged, time, values)[None], np.ascontiguousarray(taus[None]))[0]
    return lagged[at_wanted]


def actuate_with(
    inputs: Inputs,
    parameters: EngineParameters,
    magnitudes: Mapping[str, float],
    schedules: Mapping[str, np.ndarray] | None = None,
    step_s: float | np.ndarray = DEFAULT_STEP_S,
    plain: Actuation | None = None,
) -> Actuation:
    """`actuate` under effects on commands and inputs.

    Args:
        inputs: inputs with their history; for play give the whole recording before, as its output has a memory.
        parameters: dead times, lags and K_egr.
        magnitudes: names of `ACTUATION_EFFECTS` -> magnitude; others are not looked at.
        schedules: name -> factor of the magnitude per row of `inputs` (history included), held until the next.
        step_s: largest integration step [s].
        plain: the same without effects, where it is known: what no effect moves is taken from it.

    Raises:
        InputError: a negative or non-finite magnitude, or a step that is no positive time.
    """
    if not (np.isfinite(step_s) & (np.asarray(step_s) > 0)).all():
        raise InputError("integration step", repr(step_s), "a positive time in s", f"use {DEFAULT_STEP_S}")
    schedules = schedules or {}
    for name in ACTUATION_EFFECTS:
        value = magnitudes.get(name, 0.0)
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError(f"effect {name}", got=repr(value), allowed="0 or more", do="correct the magnitude")
    time = inputs.segment_time_s
    steps = steps_between(time, step_s) if plain is None else plain.steps
    half = half_step_times(time, steps)
    at = np.concatenate([[0], np.cumsum(2 * steps)])  # the samples among the half steps
    p = parameters

    def effect(through: Through, kind: str, operator: Operator) -> tuple[float, np.ndarray | None]:
        name = _BY_ENTRY.get(Entry(through, kind, operator), "")
        return magnitudes.get(name, 0.0), schedules.get(name)

    def still(through: Through, kind: str, *operators: Operator) -> Actuation | None:
        """`plain`, where none of these effects acts."""
        return None if any(effect(through, kind, operator)[0] > 0.0 for operator in operators) else plain

    def positions(kind: str, command: np.ndarray, delay: float, taus: tuple[float, ...]) -> np.ndarray:
        knots, values = inputs.time_s, command
        position, acts = effect("command", kind, "stuck")
        if position > 0.0:
            knots, values = standing(knots, values, position, acts)
        width, acts = effect("command", kind, "play")
        if width > 0.0:
            behind = np.clip(np.searchsorted(inputs.time_s, knots, side="right") - 1, 0, None)
            knots, values = play(knots, values, width if acts is None else width * acts[behind])
        more, acts = effect("command", kind, "dead_time")
        merged, delayed, at_half = _behind_dead_time(knots, values, delay, more, acts, inputs.time_s, half)
        return follow_lags(merged, delayed, np.asarray(taus, dtype=np.float64))[:, at_half]

    def input_at_half_steps(kind: str, values: np.ndarray) -> np.ndarray:
        tau, acts = effect("input", kind, "lag")
        if tau == 0.0:
            return np.interp(half, inputs.time_s, values)
        return _behind_lag(inputs.time_s, values, tau, acts, half)

    grid = np.empty((4, half.size))
    for row, kind, values in ((0, "n_e", inputs.n_e_rpm), (1, "u_delta", inputs.u_delta_mg)):
        as_it_was = still("input", kind, "lag")
        grid[row] = input_at_half_steps(kind, values) if as_it_was is None else as_it_was.grid[row]
    if as_it_was := still("command", "egr", *_OF_COMMANDS):
        u_egr1, u_egr2, grid[2] = as_it_was.u_egr1, as_it_was.u_egr2, as_it_was.grid[2]
    else:
        first, second = positions("egr", inputs.u_egr_pct, p.tau_degr, (p.tau_egr1, p.tau_egr2))
        u_egr1, u_egr2, grid[2] = first[at], second[at], egr_valve_position(first, second, constants(p))
    if as_it_was := still("command", "vgt", *_OF_COMMANDS):
        grid[3] = as_it_was.grid[3]
    else:
        (grid[3],) = positions("vgt", inputs.u_vgt_pct, p.tau_dvgt, (p.tau_vgt,))
    return Actuation(time, steps, inputs, u_egr1, u_egr2, grid[3, at], grid[2, at], grid)


def actuate_lanes(
    inputs: Inputs,
    parameters: EngineParameters,
    magnitudes: Mapping[str, np.ndarray],
    size: int,
    schedules: Mapping[str, np.ndarray] | None = None,
    step_s: float | np.ndarray = DEFAULT_STEP_S,
    plain: Actuation | None = None,
) -> list[Actuation]:
    """One actuation per lane for `simulate_extended`; lanes with the same magnitudes share one.

    Args:
        inputs, parameters, schedules, step_s, plain: as in `actuate_with`.
        magnitudes: effect name -> (B,) magnitudes; names that aren't in `ACTUATION_EFFECTS` are not looked at.
        size: number of lanes B.
    """
    columns = {name: np.broadcast_to(magnitudes[name], (size,)) for name in ACTUATION_EFFECTS if name in magnitudes}
    made: dict[tuple[float, ...], Actuation] = {}
    lanes = []
    for lane in range(size):
        key = tuple(float(column[lane]) for column in columns.values())
        if key not in made:
            own = dict(zip(columns, key, strict=True))
            made[key] = actuate_with(inputs, parameters, own, schedules, step_s, plain)
        lanes.append(made[key])
    return lanes


def actuate(inputs: Inputs, parameters: EngineParameters, step_s: float | np.ndarray = DEFAULT_STEP_S) -> Actuation:
    """Exact actuator states at the samples and at the half integration steps.

    Args:
        inputs: inputs with their history.
        parameters: gives dead times, lags and K_egr (A.16-A.18, A.25), and terms on commands and inputs, which count
            from `inputs.recording_start_s`.
        step_s: largest integration step [s], one for all or one per sample interval, (n - 1,).
    """
    start, conditions = inputs.recording_start_s, inputs.columns
    rows = amounts(parameters.terms, ACTUATION_EFFECTS, inputs.clock_s, start, conditions)
    used = {name: row for name, row in zip(ACTUATION_EFFECTS, rows, strict=True) if row.any()}
    # Shares of what all terms come to: those of the largest row would depend on where the recording ends.
    whole = {name: sum(t.magnitude for t in effect_terms(parameters.terms) if t.slot == name) for name in used}
    schedules = {name: row / whole[name] for name, row in used.items() if (row != whole[name]).any()}
    return actuate_with(inputs, parameters, whole, schedules, step_s)
