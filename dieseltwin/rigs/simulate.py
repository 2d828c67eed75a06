"""Free runs of a rig over a recording: everything is fixed but the first states, which early readings tell."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dieseltwin.discovery.twins.interface import Array, Lanes, single
from dieseltwin.discovery.twins.windows import ends_of, window_of_rows
from dieseltwin.errors import InputError
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.rigs.recording import RigRecording
from dieseltwin.rigs.twin import RigTwin

_ROUNDS = 8
_SHARES = (0.05, 0.25, 1.0)  # of a run's readings, one after another
_LEAST_ROWS = 5
_DIFFERENCE = 1e-4  # of a state's scale
_GROW, _SHRINK = 2.0, 0.4  # of a step that helped, and of one that didn't
_CONDITION = 1e-8
_AWAY = 1e9  # scales of a state, the size of a typical change: no machine goes so far


def simulate_rig(rig: RigParameters, recording: RigRecording) -> pd.DataFrame:
    """States, quantities and readings of the rig at every sample, run by run (`rig.run_s`).

    A run starts where its first readings (`rig.first_rows`) say; without readings at the states' own `first`.
    """
    twin = RigTwin(rig, recording, rig.run_s)
    with np.errstate(all="ignore"):  # a quotient may have no value at some rows; see `refuse_runaway` for what matters
        lanes = single(values_of(rig), first_states(twin, values_of(rig), rig.first_rows))
        known = {name: v for name, v in twin.variables(lanes).items() if ":" not in name}
        shown = dict(zip(twin.channels, twin.simulate(lanes)[0].T, strict=True))
    return pd.DataFrame({"time_s": recording.time_s, **known, **shown})


def refuse_runaway(rig: RigParameters, table: pd.DataFrame) -> None:
    """Whether a simulation of `simulate_rig` is one of a machine; other quantities may be without value (a quotient).

    Raises:
        InputError: a state that goes a billion times farther than it changes typically, a reading that isn't finite.
    """
    values = table[[*rig.states, *rig.readings]]
    scales = pd.Series({name: state.scale for name, state in rig.states.items()})
    away = ~np.isfinite(values) | (values.abs() > _AWAY * scales.reindex(values.columns))
    for row in np.flatnonzero(away.any(axis=1))[:1]:
        name = values.columns[int(np.argmax(away.iloc[row]))]
        got = f"{name} = {values[name].iloc[row]:.3g} at {table['time_s'].iloc[row]:g} s"
        raise InputError(f"simulating {rig.name}", got, "a machine that doesn't run away",
                         "check values and units, give more sub_steps or a shorter run_s")  # fmt: skip


def step_error(twin: RigTwin, lanes: Lanes) -> Array:
    """By how much the readings of one lane change where every step of the integration is halved, (n, C) [their
    units]: three quarters of their error."""
    finer = RigTwin(twin.rig.model_copy(update={"sub_steps": 2 * twin.rig.sub_steps}), twin.recording, twin.window_s)
    return np.asarray(finer.simulate(lanes)[0] - twin.simulate(lanes)[0])


def values_of(rig: RigParameters) -> Array:
    """Parameters and sizes of the terms, as `RigTwin.parameters` has them."""
    return np.array([*(p.value for p in rig.parameters.values()), *(t.magnitude for t in rig.terms)])


def run_error(rig: RigParameters, recording: RigRecording) -> Array:
    """Root mean square error of each reading in free runs, (C,) [units of the readings]; NaN for one that is absent."""
    twin = RigTwin(rig, recording, rig.run_s)
    local = first_states(twin, values_of(rig), rig.first_rows)
    error = twin.measured - twin.simulate(single(values_of(rig), local))[0]
    error[_within(twin) < (rig.first_rows or 0)] = np.nan  # what the first states were fitted to is no forecast
    count = np.isfinite(error).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(error**2, axis=0) / np.where(count > 0, count, np.nan)))


def _within(twin: RigTwin) -> Array:
    """Number of each sample in its run, (n,)."""
    n = len(twin.time_s)
    return np.asarray(np.arange(n) - twin.starts[window_of_rows(twin.starts, n)])


def first_states(twin: RigTwin, parameters: Array, first_rows: int | None = None) -> Array:
    """First states (W, S) of every run by damped least squares on its first readings.

    The readings are taken in by and by: over a long run a state's slope can lead to another valley than its own.

    Args:
        twin: bound to the recording.
        parameters: (P,) of it.
        first_rows: of each run that count; None for all.
    """
    known = np.where(np.isfinite(twin.measured), 1.0 / np.maximum(twin.misfit, 1e-300), 0.0)
    within, local = _within(twin), twin.first_local()
    last = float(within.max() + 1 if first_rows is None else first_rows)
    if known.any():
        for share in _SHARES:
            counted = within[:, None] < max(share * last, _LEAST_ROWS)
            local = _fitted_states(twin, parameters, np.where(counted, known, 0.0), local)
    return local


def _fitted_states(twin: RigTwin, parameters: Array, weights: Array, first: Array) -> Array:
    local, ends = first.copy(), ends_of(twin.starts, len(twin.time_s))
    best, cost, step = first.copy(), np.full(len(ends), np.inf), np.ones(len(ends))
    for _ in range(_ROUNDS):
        simulated = twin.simulate(_moved(twin, parameters, local))
        with np.errstate(over="ignore", invalid="ignore"):  # a long run may diverge; its step is taken back
            residual = np.nan_to_num((twin.measured - simulated[0]) * weights, nan=0.0, posinf=1e6, neginf=-1e6)
        for w, (start, end) in enumerate(zip(twin.starts, ends, strict=True)):
            rows = slice(int(start), int(end))
            now = float(np.sum(residual[rows] ** 2))
            if now < cost[w] and np.isfinite(simulated[:, rows]).all():
                cost[w], best[w], step[w] = now, local[w], min(1.0, _GROW * step[w])
                slopes = (simulated[1:, rows] - simulated[0, rows]) * weights[rows]
                columns = slopes.reshape(len(twin.states), -1).T / (_DIFFERENCE * twin.state_scales)
                change = np.linalg.lstsq(columns, residual[rows].ravel(), rcond=_CONDITION)[0]
                local[w] = best[w] + step[w] * change
            else:
                step[w] *= _SHRINK
                local[w] = best[w] + _SHRINK * (local[w] - best[w])
    return best


def _moved(twin: RigTwin, parameters: Array, local: Array) -> Lanes:
    """A lane at the first states, and one for a small change of each."""
    count = len(twin.states)
    moved = np.repeat(local[None], 1 + count, axis=0)
    for j in range(count):
        moved[1 + j, :, j] += _DIFFERENCE * twin.state_scales[j]
    return Lanes(np.repeat(parameters[None], 1 + count, axis=0), moved)
