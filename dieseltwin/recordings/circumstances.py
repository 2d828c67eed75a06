"""What a recording was made under, where it says so wrongly or not at all: ambient, fuel, clocks of the channels.

Names are `p_amb_pa`, `t_amb_k`, `t_im_k` (values), `drift:p_amb_pa` (change from the first row to the last),
`scale:u_delta_mg` (true over recorded), `time_shift:<column>` (recorded late by so much) and `corrected:k_cflow`,
`corrected:k_cspeed` (how far the compressor's maps go by corrected flow and speed, 0-1, where the weather isn't that of
learning). Of several recordings that are judged together the number of the recording follows, counted from 0:
`p_amb_pa@2`; what is the engine's own, and so the same in all, has no number: `corrected:k_cflow`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.engine import EngineParameters
from dieseltwin.recordings.channels import INPUTS
from dieseltwin.recordings.reader import Recording

DRIFT, SCALE, TIME_SHIFT, CORRECTED = "drift", "scale", "time_shift", "corrected"

ROUNDED = "rounded"
"""What moving an input between its rows does to its corners, `rounded:<column>`: no circumstance, but what one does.
Its size is that share of what the input bends by at every row."""

_OF = "@"

_POSSIBLE = {"p_amb_pa": (4.5e4, 1.1e5), "t_amb_k": (215.0, 330.0), "t_im_k": (230.0, 420.0)}
"""Weather and charge behind a cooler that an engine can have: to 6 km of height, -58 to 57 degC."""

POSSIBLE_EXPONENTS = -0.5, 1.5
"""Of a compressor's corrected flow and speed: 0 to 1, and what errors of maps add [-]."""

@dataclass(frozen=True)
class Circumstance:
    """One thing that a recording doesn't say, or may say wrongly.

    Attributes:
        name: as in the module's text.
        assumed: what stands in [unit].
        std: standard deviation of what is believed before the recording [unit].
        unit: unit.
        notable: distance from what is assumed that is worth a word [unit].
        unknown: no column gives it, so that it is always open; else it is taken as assumed unless plainly off.
        effects: effects of the catalogue that do the same.
        read: a column gives it, so that it is as sure as that sensor, and no more open than that.
    """

    name: str
    assumed: float
    std: float
    unit: str
    notable: float
    unknown: bool
    effects: tuple[str, ...] = ()
    read: bool = False

    @property
    def kind(self) -> str:
        """As `kind_of` its name."""
        return kind_of(self.name)

    @property
    def column(self) -> str:
        """The column that it is about."""
        return self.name.rpartition(":")[2].partition(_OF)[0]

    @property
    def drives(self) -> bool:
        """Whether it is the clock of an input."""
        return self.kind == TIME_SHIFT and self.column in INPUTS

    @property
    def plain(self) -> str:
        """Its name in its own recording."""
        return self.name.partition(_OF)[0]

    @property
    def recording(self) -> int | None:
        """Number of its recording among several, from 0; None where there is one."""
        number = self.name.partition(_OF)[2]
        return int(number) if number else None


def among_several(name: str, recording: int) -> str:
    """Name of a circumstance of one of several recordings, counted from 0; of the engine's own it is the same."""
    return name if kind_of(name) == CORRECTED else f"{name}{_OF}{recording}"


def of_recording(values: Mapping[str, float], recording: int) -> dict[str, float]:
    """Those of some values that are of one of several recordings, or of the engine, under the names that they have in
    it."""
    end = among_several("", recording)
    return {
        name.removesuffix(end): value for name, value in values.items()
        if name.endswith(end) or kind_of(name) == CORRECTED
    }  # fmt: skip


def kind_of(name: str) -> str:
    """`drift`, `scale`, `time_shift`, `corrected`, or empty for a value."""
    return name.rpartition(":")[0]


def applicable(recording: Recording, name: str, value: float) -> float:
    """The value as `put_right` can apply it: weather as there is on earth, which a channel that is plainly wrong can
    ask beyond; shifts of sensors are whole rows, so that their noise stays as it is."""
    kind, _, column = name.rpartition(":")
    if name in _POSSIBLE:
        return float(np.clip(value, *_POSSIBLE[name]))
    if kind == DRIFT:
        return 0.0
    if kind == CORRECTED:
        return float(np.clip(value, *POSSIBLE_EXPONENTS))
    if kind == TIME_SHIFT and column not in INPUTS:
        step = float(np.median(np.diff(recording.time_s)))
        return step * round(value / step)
    return value


def with_charge(engine: EngineParameters, recording: Recording) -> EngineParameters:
    """The engine with the charge temperature that a recording has, its median: in the model it is constant."""
    values = np.asarray(recording.columns.get("t_im_k", np.nan), dtype=np.float64)
    return engine.replace(T_im=float(np.nanmedian(values))) if np.isfinite(values).any() else engine


def put_right(
    recording: Recording, engine: EngineParameters, values: Mapping[str, float]
) -> tuple[Recording, EngineParameters]:
    """The recording as it would have been under known circumstances, and the engine with the charge's temperature and
    its compressor's exponents.

    Columns that a channel map computed (absolute from gauge pressure, fuel per stroke from fuel per hour) are worked
    out again from what they follow.

    Args:
        recording: as it was read.
        engine: as it was given.
        values: name -> value; drifts are not applied.
    """
    before = recording.columns.get("p_amb_pa", recording.p_amb_pa)
    columns = {**recording.columns, **recording.made.undone(recording.columns, before)}
    for name, value in values.items():
        kind, _, column = name.rpartition(":")
        if kind == SCALE:
            columns[column] = columns[column] * value
        elif kind == CORRECTED:
            engine = engine.replace(**{column: value})
        elif kind == TIME_SHIFT and value != 0.0 and column in columns:
            if column in INPUTS:
                columns[column] = _earlier(recording, columns[column], value)
            else:
                columns[column] = _earlier_rows(recording.time_s, columns[column], value)
    p_amb, t_amb = float(values.get("p_amb_pa", recording.p_amb_pa)), float(values.get("t_amb_k", recording.t_amb_k))
    columns |= recording.made.redone(columns, before + (p_amb - recording.p_amb_pa))
    if "t_im_k" in values:
        engine = engine.replace(T_im=float(values["t_im_k"]))
    return replace(recording, columns=columns, p_amb_pa=p_amb, t_amb_k=t_amb), engine


def _earlier(recording: Recording, values: np.ndarray, shift_s: float) -> np.ndarray:
    """An input that is recorded late, put right: linear between its rows, (n,).

    Each stretch of running engine by itself, so that the same rows count as running, whatever the shift.
    """
    out = np.array(values, dtype=np.float64)
    for piece in recording.pieces():
        time, known = recording.time_s[piece], np.isfinite(values[piece])
        moved = np.interp(time + shift_s, time[known], values[piece][known])
        out[piece] = np.where(known, moved, np.nan)
    return out


def _earlier_rows(time: np.ndarray, values: np.ndarray, shift_s: float) -> np.ndarray:
    """The same by whole rows, NaN where there is none within half a step, (n,)."""
    wanted = time + shift_s
    right = np.clip(np.searchsorted(time, wanted), 1, time.size - 1)
    nearest = np.where(wanted - time[right - 1] <= time[right] - wanted, right - 1, right)
    there = np.abs(time[nearest] - wanted) <= 0.55 * float(np.median(np.diff(time)))
    return np.where(there, values[nearest], np.nan)
