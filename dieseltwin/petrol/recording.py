"""Recordings of a petrol engine's air path: strict reader, pooled references, pieces between gaps."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.petrol.components import RPM
from dieseltwin.recordings.channels import ChannelMap
from dieseltwin.recordings.derived import STAND_IN_PA
from dieseltwin.recordings.named_columns import Imported, columns_sha256, named_columns, numbers
from dieseltwin.recordings.plausibility import FRACTION, as_fraction
from dieseltwin.recordings.reader import CRANKING_RPM
from dieseltwin.recordings.shared_rows import distinct, refuse_overlapping, share_known
from dieseltwin.settings.strict import listed

GAP_S = 0.9  # a longer step of the time stamps ends one piece and begins another: no block is without rows then
APART_S = 10.0  # between recordings that are pooled: a gap
FEW_LEFT_OUT = 0.01  # of the rows: fewer that lack a reading aren't worth a word
COARSEST_STEP_S = 0.25  # of the rows: the filling of the volumes is read from pressures at a block's ends
FEWEST_BLOCKS = 60
RUNNING_RAD_S = CRANKING_RPM / RPM  # below it the engine stands or is cranked, and no balance holds
LEAST_PRESSURE_PA = 5e3  # an engine in overrun draws 15 kPa; less is a sensor that has dropped out
# column -> (range of the median, unit)
COLUMNS: Mapping[str, tuple[float, float, str]] = {
    "p_ic_pa": (3e4, 5e5, "Pa"),
    "t_ic_k": (230.0, 450.0, "K"),
    "p_im_pa": (5e3, 5e5, "Pa"),
    "w_af_kg_s": (1e-4, 1.0, "kg/s"),
    "omega_e_rad_s": (30.0, 1000.0, "rad/s"),
    "alpha_th_pct": (0.0, 100.0, "%"),
    "p_amb_pa": (5e4, 1.1e5, "Pa"),
    "t_amb_k": (230.0, 330.0, "K"),
}
SURROUNDINGS: Mapping[str, float] = {"p_amb_pa": STAND_IN_PA, "t_amb_k": 293.15}
"""Columns that a recording may be judged without, and what is taken where they aren't recorded: a usual day."""


@dataclass(frozen=True)
class Signals:
    """Signals over n rows [SI]; `log_eta`, `log_area`, `leak_im`, `leak_ic` are what an effect adds, else 0.

    Attributes:
        time_s: (n,) from the recording's first row [s].
        p_ic, T_ic, p_im, W_af, omega_e, alpha, p_amb, T_amb: (n,) channels; alpha is the throttle's position [%].
        leak_im: flow into the intake manifold besides the throttle's [kg/s].
        leak_ic: flow out of the volume before the throttle besides the throttle's [kg/s].
        log_eta, log_area: logarithm of a factor on the volumetric efficiency and on the throttle's area [-].
    """

    time_s: Array
    p_ic: Array
    T_ic: Array
    p_im: Array
    W_af: Array
    omega_e: Array
    alpha: Array
    p_amb: Array
    T_amb: Array
    leak_im: Array | None = None
    leak_ic: Array | None = None
    log_eta: Array | None = None
    log_area: Array | None = None

    def part(self, start_s: float, end_s: float) -> Signals:
        """Rows with start_s <= time < end_s; the time starts at 0 again."""
        kept = (self.time_s >= start_s) & (self.time_s < end_s)
        cut = {k: v[kept] for k, v in vars(self).items() if v is not None}
        cut["time_s"] = cut["time_s"] - cut["time_s"][0]
        return replace(self, **cut)


@dataclass(frozen=True)
class PetrolRecording:
    """A recording with its origin; `time0_s`: first time stamp of the file [s]; `notes`: what reading did to it."""

    signals: Signals
    time0_s: float
    path: str
    sha256: str
    columns: tuple[str, ...]
    notes: tuple[Note, ...] = ()

    @property
    def rows_sha256(self) -> str:
        """Hash of the rows, the same for a copy with other line ends or in another format."""
        return columns_sha256({name: value for name, value in vars(self.signals).items() if value is not None})


def read_petrol(
    source: str | Path | pd.DataFrame | Imported, channels: ChannelMap | str | Path | None = None,
    absent: Collection[str] = (),
) -> PetrolRecording:
    """Read a recording of any format, or take a table of one; names are compared without regard to case.

    Args:
        source: a file of any format of `recordings.importers`, or a table with its columns; or what was imported.
        channels: map of foreign names and units to ours, see `recordings.channels`.
        absent: columns among `SURROUNDINGS` that it needn't have.

    Raises:
        InputError: missing file or column, no rising time, values that can't be in the unit of the column's name.
    """
    columns, path, sha256, read_notes = named_columns(source, channels)
    table = {name.strip().lower(): values for name, values in columns.items()}
    recorded = tuple(table)
    missing = [c for c in ("time_s", *COLUMNS) if c not in table and c not in absent]
    if missing:
        do = "name the columns so, units as in the names, or give a channel map (--channels)"
        if all(c in SURROUNDINGS for c in missing):
            do = "name the columns so, give a channel map, or leave them out with --sensors (`discover`)"
        raise InputError(f"{path}: columns", f"no {listed(missing)}", f"time_s, {listed(list(COLUMNS))}", do)
    for column in absent:
        if column not in table:
            table[column] = np.full(len(table["time_s"]), SURROUNDINGS[column])
    values = {column: numbers(column, table[column], path, needed=True) for column in ("time_s", *COLUMNS)}
    complete = np.all([np.isfinite(v) for v in values.values()], axis=0)
    if complete.sum() < 2:
        lacking = max(values, key=lambda column: int(np.isnan(values[column]).sum()))
        raise InputError(f"{path}: column {lacking}", f"{int(np.isfinite(values[lacking]).sum())} numbers, and "
                         f"{int(complete.sum())} complete rows", "a number in every column of most rows",
                         "record this column, or mend it")  # fmt: skip
    notes = [*read_notes, *_left_out(values, complete)]
    _check_time(values["time_s"], complete, path)
    for column, (low, high, unit) in COLUMNS.items():
        middle = float(np.median(values[column][complete]))
        if not low <= middle <= high:
            raise InputError(f"{path}: column {column}", f"median {middle:.4g}", f"{low:g} to {high:g} {unit}",
                             f"convert to {unit}")
    if (widest := float(values["alpha_th_pct"][complete].max())) <= FRACTION:
        raise as_fraction("alpha_th_pct", widest, path)
    possible, said = _possible(values, complete)
    notes += said
    values = {k: v[possible] for k, v in values.items()}
    time = values.pop("time_s")
    steps = np.diff(time)
    driven_s = float(np.sum(steps[steps <= GAP_S]))
    if driven_s < FEWEST_BLOCKS:
        raise InputError(path, f"{driven_s:.0f} s of a running engine", f"at least {FEWEST_BLOCKS} s", "record longer")
    signals = Signals(time - time[0], values["p_ic_pa"], values["t_ic_k"], values["p_im_pa"], values["w_af_kg_s"],
                      values["omega_e_rad_s"], values["alpha_th_pct"], values["p_amb_pa"], values["t_amb_k"])
    return PetrolRecording(signals, float(time[0]), path, sha256, recorded, tuple(notes))


def _check_time(time_s: Array, complete: NDArray[np.bool_], path: str) -> None:
    """Refuse complete rows (n,) whose time doesn't rise, or that are too far apart."""
    rows = np.flatnonzero(complete)
    steps = np.diff(time_s[rows])
    if np.any(steps <= 0.0):
        row = int(rows[1:][steps <= 0.0][0]) + 1
        raise InputError(f"{path}: time_s", f"no rise at data row {row}", "strictly rising time",
                         "sort the rows, drop repeated ones, or give two recordings one by one")
    step = float(np.median(steps))
    if step > COARSEST_STEP_S:
        raise InputError(f"{path}: time_s", f"a row every {step:.3g} s", f"one every {COARSEST_STEP_S:g} s at least",
                         "record faster")  # fmt: skip


def _possible(values: Mapping[str, Array], complete: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], list[Note]]:
    """(n,) the complete rows in which the engine runs and no pressure sensor has dropped out; what is left out."""
    possible, notes = complete.copy(), []
    for column in (name for name in COLUMNS if name.endswith("_pa")):
        dropped = complete & (values[column] < LEAST_PRESSURE_PA)
        if dropped.any():
            notes.append(Note(f"{int(dropped.sum())} rows left out, in which {column} reads less than "
                              f"{LEAST_PRESSURE_PA:g} Pa", "left_out", (column,)))  # fmt: skip
        possible &= ~dropped
    standing = complete & (values["omega_e_rad_s"] < RUNNING_RAD_S)
    if standing.any():
        notes.append(Note(f"{int(standing.sum())} rows left out, in which the engine runs at less than "
                          f"{CRANKING_RPM:g} rpm", "left_out", ("omega_e_rad_s",)))  # fmt: skip
    return possible & ~standing, notes


def _left_out(values: Mapping[str, Array], good: NDArray[np.bool_]) -> tuple[Note, ...]:
    share = float(np.mean(~good))
    if share < FEW_LEFT_OUT:
        return ()
    lacking = [column for column, read in values.items() if np.mean(~np.isfinite(read)) >= 0.1 * share]
    have = "have" if len(lacking) > 1 else "has"
    return (Note(f"{100.0 * share:.2g} % of the rows left out, as {listed(lacking)} {have} no number there", "left_out",
                 lacking),)  # fmt: skip


def pooled(recordings: Sequence[PetrolRecording]) -> PetrolRecording:
    """Several recordings of one engine as one with gaps, in an order of its own; copies with the same rows count once.

    Args:
        recordings: one at least.

    Raises:
        InputError: one that is, in part, driving of another.
    """
    once = distinct(recordings)
    if len(once) == 1:
        return once[0]
    refuse_overlapping(
        once, lambda others, one: share_known(rows_of(one.signals), [rows_of(other.signals) for other in others])
    )
    names = [f.name for f in fields(Signals) if getattr(once[0].signals, f.name) is not None]
    values = {name: np.concatenate([getattr(r.signals, name) for r in once]) for name in names}
    ends = np.cumsum([0.0, *(r.signals.time_s[-1] + APART_S for r in once[:-1])])
    values["time_s"] = np.concatenate([r.signals.time_s + end for r, end in zip(once, ends, strict=True)])
    sha256 = hashlib.sha256("".join(r.sha256 for r in once).encode()).hexdigest()
    columns = tuple(c for c in once[0].columns if all(c in r.columns for r in once))
    return PetrolRecording(Signals(**values), 0.0, ", ".join(r.path for r in once), sha256, columns,
                           tuple(note for r in once for note in r.notes))  # fmt: skip


def rows_of(signals: Signals) -> Array:
    """All channels but the time side by side, (n, C)."""
    return np.stack([value for name, value in vars(signals).items() if value is not None and name != "time_s"], axis=1)


def gaps(time_s: Array) -> NDArray[np.int64]:
    """First row of every piece between gaps of more than GAP_S, ascending, the first 0."""
    return np.concatenate([[0], np.flatnonzero(np.diff(time_s) > GAP_S) + 1]).astype(np.int64)
