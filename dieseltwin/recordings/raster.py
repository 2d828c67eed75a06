"""Channels on several rasters -> rows on one, without inventing readings.

Inputs are interpolated, for the engine has them at all times. A reading of a sensor stands only in the row next to its
own time and is missing (NaN) in the others: a sensor of 1 Hz in rows of 5 Hz is four fifths missing, not held.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.engine import MEASURED
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import INPUTS, TIME, ChannelMap, known_columns, unit_of
from dieseltwin.recordings.error_codes import without_codes
from dieseltwin.recordings.importers.signals import RawChannels, Signal

ROW_STEP_S = 0.2  # rows of 5 Hz hold the inputs of driving; faster ones only where the slowest sensor is faster too
SAME_STEP = 1.05  # steps that agree to 5 % are the same raster
LONGEST_HOLE = 1.5  # own steps of an input that are bridged, and at least `LONGEST_BRIDGE_S`
LONGEST_BRIDGE_S = 1.0


def quantities(raw: RawChannels, mapping: ChannelMap) -> tuple[dict[str, Signal], list[str]]:
    """Our columns as signals, each at its own times: the map's entries, and channels that carry our names already.

    Error codes are left out, for an input would be interpolated towards them; notes say so.

    Raises:
        InputError: a name of the map that the file doesn't have, or something that a formula needs and nobody maps.
    """
    where = str(raw.path)
    mapping.refuse_unknown(raw.names, where)
    found: dict[str, Signal] = {}
    notes: list[str] = []

    def add(column: str, signal: Signal, values: np.ndarray) -> None:
        kept, coded = without_codes(column, signal.values, values)
        found[column] = Signal(column, unit_of(column), signal.time_s, kept, signal.origin, signal.spn)
        notes.extend(coded)

    for name, signal in raw.signals.items():
        if name not in mapping.entries and name != TIME and (name in known_columns() or unit_of(name) is not None):
            add(name, signal, signal.values)
    for name, entry in mapping.in_order():
        if entry.column == TIME:
            continue  # every channel has its own times here
        mapping.refuse_unfit(name, entry, found, where)
        signal = raw.signals[name]
        time = _times(signal)
        beside = {need: _at(time, found[need]) for need in entry.needs}
        add(entry.column, signal, entry.derived(entry.converted(signal.values), beside))
    return found, notes


def on_one_raster(signals: Mapping[str, Signal], where: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """Rows for a recording: `time_s` and every column on it.

    Args:
        signals: our columns, each at its own times (`quantities`).
        where: name of the file, for messages.

    Returns:
        Columns (n,) with NaN where a sensor has no reading, and notes.

    Raises:
        InputError: no inputs among them, or no time that all inputs share.
    """
    inputs = [name for name in INPUTS if name in signals]
    if not inputs:
        raise InputError(
            where, "none of the inputs", ", ".join(INPUTS), "map them: dieseltwin channels FILE --out map.yaml"
        )
    times = [_times(signals[name]) for name in signals]
    if all(np.array_equal(time, times[0]) for time in times[1:]):
        return {TIME: times[0], **{name: signal.values for name, signal in signals.items()}}, []
    sensors = [name for name in MEASURED if name in signals]
    rows, step = _rows(signals, inputs, sensors, where)
    columns, notes = {TIME: rows}, []
    largest, slow = 0.0, []
    for name, signal in signals.items():
        if name in sensors:
            columns[name], shift = _placed(rows, step, signal)
            largest = max(largest, shift)
            if _step(signal) > SAME_STEP * step:
                slow.append(f"{name} every {_step(signal):.3g} s")
        else:
            columns[name] = _interpolated(rows, signal)
    notes.append(
        f"several rasters: rows every {step:.3g} s; inputs interpolated, readings at most {1e3 * largest:.0f} ms "
        "from their row"
    )
    if slow:
        notes.append(f"{', '.join(slow)}: rows between have no reading (nothing is held or interpolated)")
    for name in inputs:
        if _step(signals[name]) > ROW_STEP_S * SAME_STEP:
            notes.append(f"{name} comes every {_step(signals[name]):.3g} s only: {SLOW_INPUT}")
    return columns, notes


SLOW_INPUT = (
    "what it does in between is unknown, so lags and dead times of actuators are out of reach and fast "
    "transients count as noise; slow driving still tells areas and efficiencies"
)


def _times(signal: Signal) -> np.ndarray:
    if signal.time_s is None:
        raise InputError(f"channel {signal.name!r}", "no times", "a time for every reading", "export the time too")
    return signal.time_s


def _step(signal: Signal) -> float:
    """Median time between readings that are there [s]."""
    time = _times(signal)[np.isfinite(signal.values)]
    return float(np.median(np.diff(time))) if time.size > 1 else np.inf


def _rows(signals: Mapping[str, Signal], inputs: list[str], sensors: list[str], where: str) -> tuple[np.ndarray, float]:
    """Times of the rows: in step and phase with the slowest sensor, not slower than the inputs move."""
    slowest_input = max(_step(signals[name]) for name in inputs)
    steps = {name: _step(signals[name]) for name in sensors}
    told = {name: step for name, step in steps.items() if np.isfinite(step)}
    if told:
        leader = max(told, key=lambda name: told[name])
        step = min(told[leader], max(ROW_STEP_S, min(*told.values(), slowest_input, told[leader])))
        phase = float(_times(signals[leader])[np.isfinite(signals[leader].values)][0])
    else:
        step = max(ROW_STEP_S, slowest_input)
        phase = float(_times(signals[inputs[0]])[0])
    start = max(float(_times(signals[name])[0]) for name in inputs)
    end = min(float(_times(signals[name])[-1]) for name in inputs)
    count = np.floor((end - phase) / step + 1e-9) - np.ceil((start - phase) / step - 1e-9) + 1
    if not np.isfinite(step) or count < 2:
        raise InputError(
            where, "inputs that share no stretch of time", "all inputs over the same time", "record them together"
        )
    first = np.ceil((start - phase) / step - 1e-9)
    return phase + step * (first + np.arange(int(count))), step


def _placed(rows: np.ndarray, step: float, signal: Signal) -> tuple[np.ndarray, float]:
    """Each row's own reading, the nearest within half a step and no reading twice; and the largest distance [s]."""
    present = np.isfinite(signal.values)
    time, values = _times(signal)[present], signal.values[present]
    column = np.full(rows.size, np.nan)
    if not time.size:
        return column, 0.0
    row = np.clip(np.rint((time - rows[0]) / step).astype(np.int64), 0, rows.size - 1)
    distance = np.abs(time - rows[row])
    usable = np.flatnonzero(distance <= 0.5 * step * (1.0 + 1e-9))
    if not usable.size:
        return column, 0.0
    order = usable[np.lexsort((distance[usable], row[usable]))]
    chosen = order[np.r_[True, np.diff(row[order]) > 0]]
    column[row[chosen]] = values[chosen]
    return column, float(distance[chosen].max())


def _at(times: np.ndarray, signal: Signal) -> np.ndarray:
    """A channel at other times: linear between its readings, the nearest one beyond its ends."""
    present = np.isfinite(signal.values)
    if not present.any():
        return np.full(times.size, np.nan)
    return np.interp(times, _times(signal)[present], signal.values[present])


def _interpolated(rows: np.ndarray, signal: Signal) -> np.ndarray:
    """An input on the rows; NaN inside a hole longer than its own raster (and than 1 s)."""
    present = np.isfinite(signal.values)
    time = _times(signal)[present]
    if time.size < 2:
        return np.full(rows.size, signal.values[present][0] if time.size else np.nan)
    after = np.clip(np.searchsorted(time, rows), 1, time.size - 1)
    hole = time[after] - time[after - 1] > max(LONGEST_BRIDGE_S, LONGEST_HOLE * _step(signal))
    inside = (rows > time[after - 1]) & (rows < time[after])
    return np.where(hole & inside, np.nan, np.interp(rows, time, signal.values[present]))
