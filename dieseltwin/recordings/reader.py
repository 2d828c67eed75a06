"""Recordings: reader, writer, segments. Any format of `importers`, 1-100 Hz, time stamps used as they are, SI inside.

Column names and units are DISCOVERY's recording format (`channels.known_columns`); foreign names and units come in
through a channel map. Rows below 300 rpm and gaps over 1 s split a recording into pieces, and pieces are cut into
segments. Missing values of a sensor are masked (NaN in `Segment.measured`); missing values of an input are
bridged over at most 1 s when a recording is made, a longer hole splits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.atomic import atomic_path
from dieseltwin.engine import MEASURED, EngineParameters, Inputs, we2011
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import (
    AMBIENT,
    INPUTS,
    OPTIONAL_INPUTS,
    SENSORS,
    TIME,
    ChannelMap,
    foreign_hint,
    optional_inputs,
)
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.derived import NOTHING, Made
from dieseltwin.recordings.named_columns import Imported, columns_sha256, import_columns, numbers
from dieseltwin.recordings.plausibility import (
    LONGEST_GAP_S,
    bridge_inputs,
    check_plausible,
    cut_off_notes,
    longest_gap,
    mask_wild,
)
from dieseltwin.recordings.unit_checks import unit_notes
from dieseltwin.recordings.unread import held_unread, stuck_unread
from dieseltwin.settings.strict import listed

SLOWEST_HZ, FASTEST_HZ = 1.0, 100.0
FULL_HZ = 5.0  # below, the gas path's transients are not seen
RATE_TOLERANCE = 1.15  # time stamps jitter, and a logger that says 5 Hz gives 4.6
CRANKING_RPM = 300.0  # the engine is not running below this speed
SLOW_ROWS = (
    "what happens between them is unknown. Dead times, lags and play of actuators are out of reach, quick transients "
    "count as noise, and intervals widen with the root of the rate and by what the inputs may have done (`classical`, "
    "`discover`)"
)
LONGEST_S = 1e6  # eleven days; longer ones are in milliseconds
MOST_ROWS = 6_000_000  # of a table; with more, memory for the columns and their text runs out on small machines
HISTORY_S = 2.0  # of inputs kept before a segment: dead time and ten time constants of the slowest actuator are 1.4 s
MANY_REPEATED = 0.3  # of the steps of time: its clock shows too few digits
MINIMUM_ROWS = 10  # of a segment; fewer hold no information on four parameters and three states
CSV_SUFFIXES, PARQUET_SUFFIXES = (".csv", ".txt"), (".parquet", ".pq")
_KNOWN = (TIME, *INPUTS, *OPTIONAL_INPUTS, *MEASURED, *AMBIENT)


@dataclass(frozen=True)
class Segment:
    """A window of a recording, the unit of identification.

    Attributes:
        t0_s, t1_s: time of its first and last row [s].
        inputs: engine inputs with `inputs.n_history` rows before t0_s (at most 2 s).
        measured: (n, C) sensors in the order of `engine.MEASURED` [SI], NaN where masked or absent.
        columns: every column of the recording over the n rows of the segment.
    """

    t0_s: float
    t1_s: float
    inputs: Inputs
    measured: np.ndarray
    columns: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Recording:
    """A whole recording in SI.

    Attributes:
        time_s: (n,) strictly increasing [s].
        columns: our column names -> (n,) float64; NaN where missing. Holds time_s too.
        p_amb_pa, t_amb_k: median of the ambient columns, the engine's values where absent [Pa], [K].
        path: where it was read from, None for one made in memory.
        sha256: of the file, or of the columns for one made in memory.
        notes: what reading did to the file and what it costs, one sentence each.
        began: date of the first row [UTC], where the file's stamps say it.
        made: columns that a channel map computed from others.
        cut_from_s: first time stamp of the recording that these rows are a part of [s]; None: they are all of it.
        standing: whether it is settled points, each held for a while (`recordings.standing`).
    """

    time_s: np.ndarray
    columns: Mapping[str, np.ndarray]
    p_amb_pa: float
    t_amb_k: float
    path: Path | None = None
    sha256: str = ""
    notes: tuple[str, ...] = ()
    began: datetime | None = None
    made: Made = NOTHING
    cut_from_s: float | None = None
    standing: bool = False

    @property
    def start_s(self) -> float:
        """First time stamp of the whole recording, from which onsets and drifts count [s]."""
        return float(self.time_s[0]) if self.cut_from_s is None else self.cut_from_s

    @property
    def duration_s(self) -> float:
        """From the first to the last time stamp [s]."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def running_s(self) -> float:
        """With the engine running and no hole over 1 s [s]."""
        return sum(self._length(piece) for piece in self.pieces())

    @property
    def rows_sha256(self) -> str:
        """Hash of the rows, the same for a copy with other line ends, in another format or with further columns."""
        return columns_sha256({name: self.columns[name] for name in _KNOWN if name in self.columns})

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.columns)

    def frame(self) -> pd.DataFrame:
        """The columns as a DataFrame, time first."""
        return pd.DataFrame(dict(self.columns))

    def pieces(self) -> tuple[slice, ...]:
        """Stretches with the engine running and no hole over 1 s, as row slices in time order."""
        usable = np.asarray(self.columns["n_e_rpm"] >= CRANKING_RPM)  # False for NaN as well
        for name in INPUTS:
            if name in self.columns:
                usable &= np.isfinite(self.columns[name])
        # a row without inputs is no row of the inputs; what counts is the time between the rows that remain
        rows = np.flatnonzero(usable)
        if rows.size == 0:
            return ()
        stopped = np.cumsum(np.asarray(self.columns["n_e_rpm"] < CRANKING_RPM))
        breaks = (np.diff(self.time_s[rows]) > longest_gap(self.time_s)) | (np.diff(stopped[rows]) > 0)
        starts = np.r_[0, np.flatnonzero(breaks) + 1]
        ends = np.r_[np.flatnonzero(breaks), rows.size - 1]
        return tuple(slice(int(rows[a]), int(rows[b]) + 1) for a, b in zip(starts, ends, strict=True))

    def segments(self, duration_s: float = 60.0, minimum_s: float | None = None) -> tuple[Segment, ...]:
        """Cut every piece into windows that share their end rows (60 s at 5 Hz are 301 rows).

        Args:
            duration_s: length of a window [s].
            minimum_s: keep a shorter rest of a piece from this length on [s]; None drops the rest.

        Raises:
            InputError: no window fits.
        """
        found: list[Segment] = []
        for piece in self.pieces():
            found.extend(self._cut(piece, duration_s, duration_s if minimum_s is None else minimum_s))
        if not found:
            longest = max((self._length(piece) for piece in self.pieces()), default=0.0)
            raise InputError(
                f"{self.path or 'recording'}",
                f"{longest:.3g} s of running engine in one piece at most",
                f"at least {duration_s:g} s (rows below {CRANKING_RPM:g} rpm and gaps over {LONGEST_GAP_S:g} s split)",
                "record longer or ask for shorter segments",
            )
        return tuple(found)

    def _length(self, piece: slice) -> float:
        return float(self.time_s[piece.stop - 1] - self.time_s[piece.start])

    def _cut(self, piece: slice, duration_s: float, minimum_s: float) -> list[Segment]:
        time = self.time_s[piece]
        # Half a step of tolerance against jitter; and 300 rows at 5 Hz are a minute, though they span 59.8 s.
        slack = 0.5 * float(np.median(np.diff(time))) if time.size > 1 else 0.0
        found, start = [], 0
        while start < time.size - 1:
            end = int(np.searchsorted(time, time[start] + duration_s + slack, side="right")) - 1
            length = time[end] - time[start]
            if length >= min(minimum_s, duration_s) - 3.0 * slack and end + 1 - start >= MINIMUM_ROWS:
                found.append(self._segment(piece.start, piece.start + start, piece.start + end + 1))
            if end <= start:
                break
            start = end
        return found

    def _segment(self, piece_start: int, start: int, stop: int) -> Segment:
        time = self.time_s
        before = int(np.searchsorted(time[piece_start:start], time[start] - HISTORY_S - _ROUNDING_S)) + piece_start
        rows = slice(before, stop)
        n_e, u_delta, u_egr, u_vgt = (self.columns[name][rows].copy() for name in INPUTS)
        further = {name: values[rows].copy() for name, values in optional_inputs(self.columns).items()}
        columns = {name: values[start:stop] for name, values in self.columns.items()}
        n = stop - start
        measured = np.column_stack([columns.get(name, np.full(n, np.nan)) for name in MEASURED])
        return Segment(
            t0_s=float(time[start]),
            t1_s=float(time[stop - 1]),
            inputs=Inputs(time[rows].copy(), n_e, u_delta, u_egr, u_vgt, start - before, self.start_s, **further),
            measured=np.where(np.isfinite(measured), measured, np.nan),
            columns=Columns(columns),
        )


_ROUNDING_S = 1e-6  # time stamps are written with few digits


def _median_or(values: np.ndarray | None, otherwise: float) -> float:
    return otherwise if values is None or not np.isfinite(values).any() else float(np.nanmedian(values))


def recording(
    frame: pd.DataFrame | Mapping[str, np.ndarray],
    engine: EngineParameters | None = None,
    *,
    where: str = "recording",
    path: Path | None = None,
    sha256: str | None = None,
    sensors: Sequence[str] = SENSORS,
    any_rate: bool = False,
    made: Made = NOTHING
) -> Recording:
    """Validate columns with our names and units and make a Recording of them.

    Args:
        frame: our column names -> (n,) numbers.
        engine: gives the ambient where the columns are absent and the size of a cylinder; the published set by default.
        where: name for messages.
        sensors: columns that must be there besides time and inputs; () for inputs only.
        any_rate: accept any sampling rate (inputs of a simulation may be given at 1 s).
        made: columns that a channel map computed from others.

    Raises:
        InputError: a missing column, time that does not increase, a wrong rate or unit, the engine never running.
    """
    engine = we2011.PARAMETERS if engine is None else engine
    columns = {str(name): np.asarray(frame[name]) for name in frame}
    for name in (TIME, *INPUTS, *sensors):
        if name not in columns:
            got = f"none ({listed(list(columns))})"
            raise InputError(f"{where}: column {name}", got, "this column", foreign_hint(name, columns))
    needed = (*_KNOWN, *sensors)
    columns = {name: numbers(name, values, where, name in needed) for name, values in columns.items()
               if name in needed or np.issubdtype(values.dtype, np.number)}
    made, p_amb = made.of_recording(columns, _median_or(columns.get("p_amb_pa"), engine.p_amb))
    time = columns[TIME]
    if time.size < 2:
        raise InputError(where, f"{time.size} rows", "at least 2 rows", "record longer")
    if time.size > MOST_ROWS:
        raise InputError(where, f"{time.size} rows", f"at most {MOST_ROWS}", "cut it, or average it down to 10 Hz")
    check_time(time, where, any_rate)
    _check_running(columns["n_e_rpm"], where)
    infinite = [f"{count} infinite values of {name} count as missing" for name in needed if name in frame
                and (count := int(np.isinf(np.asarray(frame[name], dtype=np.float64)).sum()))]  # fmt: skip
    wild = mask_wild(columns)
    t_amb = _median_or(columns.get("t_amb_k"), engine.T_amb)
    check_plausible(columns, where, t_amb if t_amb > 200.0 else engine.T_amb, engine.V_d / engine.n_cyl)
    notes = [*infinite, *wild, *bridge_inputs(columns), *held_unread(columns), *stuck_unread(columns),
             *cut_off_notes(columns), *unit_notes(columns, engine.p_amb, engine.n_cyl)]  # fmt: skip
    if not any_rate and 1.0 / float(np.median(np.diff(time))) < FULL_HZ / RATE_TOLERANCE:
        notes.append(f"{1.0 / float(np.median(np.diff(time))):.3g} rows per second: {SLOW_ROWS}")
    for values in columns.values():
        values.setflags(write=False)
    return Recording(
        time_s=time,
        columns=Columns(columns),
        p_amb_pa=p_amb,
        t_amb_k=t_amb,
        path=path,
        sha256=columns_sha256(columns) if sha256 is None else sha256,
        notes=tuple(notes),
        made=made,
    )


def check_time(time: np.ndarray, where: str, any_rate: bool) -> None:
    """Refuse time stamps that are missing, don't rise, or span too long; and, unless any will do, a wrong rate.

    Raises:
        InputError: which row, and what to do.
    """
    if not np.isfinite(time).all():
        row = int(np.flatnonzero(~np.isfinite(time))[0])
        raise InputError(f"{where}: column {TIME}, data row {row + 1}", "no number", "a time in s in every row",
                         "fill in or drop this row")
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0])
        raise InputError(
            f"{where}: column {TIME}, data row {row + 2}",
            f"{time[row + 1]:.10g} after {time[row]:.10g}",
            "strictly increasing times in s",
            "export the time with more digits" if np.mean(steps == 0.0) > MANY_REPEATED else
            "sort the rows, drop repeated ones, or read runs one by one",
        )
    if time[-1] - time[0] > LONGEST_S:
        raise InputError(f"{where}: column {TIME}", f"{time[-1] - time[0]:.4g} s from first to last row",
                         f"at most {LONGEST_S:g} s", "give the unit of time in a channel map (--channels), or cut it")
    rate = 1.0 / float(np.median(steps))
    if not any_rate and not SLOWEST_HZ / RATE_TOLERANCE <= rate <= FASTEST_HZ * RATE_TOLERANCE:
        points = f", leave {TIME} out where each row is a settled point" if rate < SLOWEST_HZ else ""
        raise InputError(f"{where}: column {TIME}", f"{rate:.4g} rows per second", f"{SLOWEST_HZ:g} to {FASTEST_HZ:g}",
                         f"record at such a rate{points or ', average down'}, or give the unit of time in a channel "
                         "map (--channels)")


def _check_running(n_e: np.ndarray, where: str) -> None:
    if np.isfinite(n_e).any() and not (n_e >= CRANKING_RPM).any():
        raise InputError(
            f"{where}: column n_e_rpm",
            f"at most {np.nanmax(n_e):.4g}: the engine never runs",
            f"rows of at least {CRANKING_RPM:g} rpm",
            "record a running engine, or give the unit in a channel map (--channels) if this is not rpm",
        )


def read_recording(
    source: str | Path | pd.DataFrame | Imported,
    channels: ChannelMap | str | Path | None = None,
    engine: EngineParameters | None = None,
    *,
    sensors: Sequence[str] = SENSORS,
    any_rate: bool = False,
) -> Recording:
    """Read and validate a recording.

    Args:
        source: CSV, Parquet, Excel, MATLAB, MDF, a CAN trace or a table; or what was imported of one already.
        channels: channel map or its YAML file for foreign names and units.
        engine: gives ambient values where the columns are absent.
        sensors: columns that must be there besides time and inputs; () to read inputs only.
        any_rate: accept any sampling rate (inputs of a simulation may be given at 1 s).

    Raises:
        InputError: one line saying what is wrong with the file.
    """
    read = import_columns(source, channels)
    made = recording(read.columns, engine, where=str(read.path or "recording"), path=read.path, sha256=read.sha256,
                     sensors=sensors, any_rate=any_rate, made=read.made)
    return replace(made, notes=(*read.notes, *made.notes), began=read.began)


def write_recording(source: Recording | pd.DataFrame, path: str | Path) -> Path:
    """Write a recording (or any table) to .csv or .parquet atomically; float64 survives the round trip bit for bit.

    Raises:
        InputError: another suffix, full disk, read-only folder.
    """
    path = Path(path)
    frame = source.frame() if isinstance(source, Recording) else source
    suffix = path.suffix.lower()
    if suffix not in (known := CSV_SUFFIXES + PARQUET_SUFFIXES):
        raise InputError(str(path), f"a file ending in {suffix or 'nothing'}", listed(known), "choose another")
    with atomic_path(path) as temporary:
        if suffix in CSV_SUFFIXES:
            with temporary.open("w", encoding="utf-8", newline="") as file:  # pandas would hide the kind of failure
                frame.to_csv(file, index=False, lineterminator="\n")
        else:
            frame.to_parquet(temporary, index=False, write_page_checksum=True)
    return path


def rows_out_of_range(
    columns: Mapping[str, np.ndarray], ranges: Mapping[str, tuple[float, float]]
) -> dict[str, int]:
    """How many rows of each column lie outside the engine's input ranges (only `simulate` clips; estimators report).

    Args:
        columns: our column names -> (n,).
        ranges: column -> (low, high) in the column's unit.
    """
    counts = {
        name: int(np.count_nonzero((columns[name] < low) | (columns[name] > high)))
        for name, (low, high) in ranges.items()
        if name in columns
    }
    return {name: count for name, count in counts.items() if count}
