"""A recording of a rig: the columns that its file names, at the rate that it asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.arrays import Array
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.recordings.channels import TIME
from dieseltwin.recordings.error_codes import without_outlying_codes
from dieseltwin.recordings.named_columns import Imported, named_columns, numbers
from dieseltwin.rigs.parameters import RigParameters
from dieseltwin.settings.names import listed

LEAST_ROWS = 20
LEAST_SAMPLES = 3  # of a window, for each state that starts anew and for the parameters


@dataclass(frozen=True)
class RigRecording:
    """Samples of a rig.

    Attributes:
        time_s: (n,) ascending [s].
        inputs: column -> (n,), no gaps.
        readings: column -> (n,), NaN where missing; columns that aren't there, or are empty, are left out.
        path, sha256: where it comes from.
        notes: what reading did to the file.
    """

    time_s: Array
    inputs: Mapping[str, Array]
    readings: Mapping[str, Array]
    path: str
    sha256: str
    notes: tuple[Note, ...] = ()

    def part(self, rows: slice) -> RigRecording:
        """Some of its rows."""
        inputs = {name: values[rows] for name, values in self.inputs.items()}
        readings = {name: values[rows] for name, values in self.readings.items()}
        return RigRecording(self.time_s[rows], inputs, readings, self.path, self.sha256, self.notes)


def read_rig(source: str | Path | pd.DataFrame | Imported, rig: RigParameters) -> RigRecording:
    """Read a recording of a rig, inputs averaged over the rows that one sample stands for.

    Raises:
        InputError: a file that can't be read, a column that is missing or holds text, times that don't increase, an
            input that isn't there in every row.
    """
    found, where, digest, notes = named_columns(source)
    asked = (TIME, *rig.inputs, *rig.readings)
    columns = {name: numbers(name, found[name], where, needed=True) for name in asked if name in found}
    for name in (TIME, *rig.inputs):
        if name not in columns:
            raise InputError(f"{where}: column {name}", f"none ({listed(list(found))})", f"a column of {rig.name}",
                             "name the columns as the rig's file does")
    n = len(columns[TIME]) // rig.every * rig.every
    time_s = np.asarray(columns[TIME][:n : rig.every], dtype=np.float64)
    if len(time_s) < LEAST_ROWS:
        rows = f"{len(columns[TIME])} rows" + (f", {len(time_s)} samples of {rig.every} rows" if rig.every > 1 else "")
        raise InputError(where, rows, f"{LEAST_ROWS} or more samples", "record longer" if rig.every == 1 else
                         f"record longer, or lower `every` of {rig.name}")  # fmt: skip
    _refuse_disorder(columns[TIME], where)
    _refuse_short_runs(rig, time_s)
    inputs = {name: columns[name][:n].reshape(-1, rig.every).mean(axis=1) for name in rig.inputs}
    for name, values in inputs.items():
        if not np.isfinite(values).all():
            raise InputError(f"{where}: column {name}, sample {int(np.flatnonzero(~np.isfinite(values))[0]) + 1}",
                             "no number", "a number in every row of an input", "fill in or drop this row")
    coded: list[Note] = []
    for name in (name for name in rig.readings if name in columns):
        columns[name], said = without_outlying_codes(name, columns[name])
        coded += [Note(text, "reading", (name,)) for text in said]
    readings = {name: columns[name][:n : rig.every] for name in rig.readings
                if name in columns and np.isfinite(columns[name][:n : rig.every]).any()}  # fmt: skip
    return RigRecording(time_s, inputs, readings, where, digest, (*notes, *coded))


def refuse_still(recording: RigRecording, rig: RigParameters) -> None:
    """A reading that stands still tells nothing: every machine that doesn't move fits it.

    Raises:
        InputError: a reading with one and the same value in every row.
    """
    for name, values in recording.readings.items():
        if np.nanmin(values) == np.nanmax(values):
            raise InputError(f"{recording.path}: column {name}", f"{np.nanmax(values):g} in every row",
                             "a reading that moves", "check that its sensor was connected, record the machine moving, "
                             f"or leave this reading out of the file of {rig.name}")  # fmt: skip


def _refuse_short_runs(rig: RigParameters, time_s: Array) -> None:
    """Windows and runs whose states start anew at nearly every sample explain anything and say nothing."""
    step = float(np.median(np.diff(time_s)))
    least = (len(rig.states) + 1) * LEAST_SAMPLES
    for key, length in (("window_s", rig.window_s), ("run_s", rig.run_s)):
        if length is not None and length < least * step:
            raise InputError(f"{rig.name}: {key}", f"{length:g} s, where a sample comes every {step:.3g} s",
                             f"{least * step:.3g} s or more, {least} samples", "give a longer one, or leave it out")


def _refuse_disorder(time_s: Array, where: str) -> None:
    """Times (n,) of every row must be there and increase."""
    missing = np.flatnonzero(~np.isfinite(time_s))
    if missing.size:
        raise InputError(f"{where}: column {TIME}, data row {missing[0] + 1}", "no number", "a time in every row",
                         "fill in or drop this row")
    back = np.flatnonzero(np.diff(time_s) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InputError(f"{where}: column {TIME}, data row {row + 1}", f"{time_s[row]:g} after {time_s[row - 1]:g}",
                         "times that increase", "sort the rows, drop repeated ones, or give two recordings one by one")
