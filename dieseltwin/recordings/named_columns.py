"""From a file to columns in our names: the importer reads, the channel map names and converts, rasters are joined."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.notes import Note, of_reading
from dieseltwin.paths import file_sha256
from dieseltwin.recordings.channels import TIME, ChannelMap, channel_map, known_columns, read_channel_map
from dieseltwin.recordings.derived import NOTHING, Made
from dieseltwin.recordings.importers.clock import first_stamp, with_index
from dieseltwin.recordings.importers.layout import told_unit
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.recordings.raster import on_one_raster, quantities
from dieseltwin.recordings.stated_units import against_stated

LIKE_TIME = ("time", "t_s", "t [", "zeit", "uhrzeit", "sekunden", "seconds")
"""Beginnings of names that a column of time may have in a file that nobody mapped."""
LIKE_DATE = ("date", "datum")
"""The same of dates, which settled points have as well."""
_RISING = 0.9  # of the steps: a clock may start again, or stand still, and the reader tells where
_APART_S = 60.0  # rows of a recording are nearer to each other, settled points farther apart


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a file that is one table (CSV of any dialect, Parquet, Excel, MATLAB vectors) in its own names.

    Raises:
        InputError: no such file, not readable, truncated, empty, or channels on several rasters.
    """
    raw = read_raw(path)
    if raw.table is None:
        raise InputError(
            str(path), f"{raw.kind} with channels on their own rasters", "one table", "give a recording's table"
        )
    return raw.table


@dataclass(frozen=True)
class Imported:
    """Columns of a file or of a table in our names, not yet checked.

    Attributes:
        columns: our names (and the file's own where nobody maps them) -> (n,).
        notes: what was done to get there, one sentence each.
        began: date of the first row [UTC], where the file says it.
        path, sha256: of the file; None for a table.
        made: which columns were computed from others.
        units: of the columns that keep the file's own names, where it says them.
    """

    columns: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()
    began: datetime | None = None
    path: Path | None = None
    sha256: str | None = None
    made: Made = NOTHING
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def timed(self) -> bool:
        """Whether it is a recording over time (`time_s`, or a column that is called so) rather than settled points.

        Those may have the time of day too, and how long a point took to settle.
        """
        return TIME in map(str.lower, self.columns) or any(
            _ticks(values, told_unit(name, self.units.get(name))) for name, values in self.columns.items()
            if name.lower().startswith((*LIKE_TIME, *LIKE_DATE))
        )  # fmt: skip


def _ticks(values: np.ndarray, unit_s: float | None) -> bool:
    """Whether times (n,) are those of rows over time: they rise, and by little where their unit is known [s]."""
    if values.size < 2 or not np.issubdtype(np.asarray(values).dtype, np.number):
        return False
    steps = np.diff(values.astype(np.float64))
    rising = steps[steps > 0.0]
    return bool(rising.size > _RISING * steps.size and (unit_s is None or np.median(rising) * unit_s < _APART_S))


def import_columns(
    source: str | Path | pd.DataFrame | Imported, channels: ChannelMap | str | Path | None = None
) -> Imported:
    """Take a table, or read a file of any format, and name the columns by a channel map; rasters are put onto one.

    Args:
        source: what was imported already is given back.

    Raises:
        InputError: one line saying what is wrong with the file or the map.
    """
    mapping = _map(channels)
    if isinstance(source, Imported):
        return source
    if isinstance(source, pd.DataFrame):
        table = with_index(source)
        by_seconds, units, notes = in_seconds(table, "table")
        stated = against_stated(units, mapping, "the table")
        columns, coded = _renamed(by_seconds, mapping, "the table")
        return Imported(columns, (*notes, *stated, *coded), first_stamp(table), made=mapping.made, units=units)
    path = Path(source)
    wanted = {*mapping.entries, *known_columns()} if mapping.entries else None
    raw = read_raw(path, mapping.database, wanted)
    if raw.table is None and any(name not in raw.signals for name in mapping.entries):
        raw = read_raw(path, mapping.database)  # for the message: every name that the file has
    if raw.table is None:
        stated = against_stated({name: signal.unit for name, signal in raw.signals.items()}, mapping, str(path))
        signals, coded = quantities(raw, mapping)
        columns, notes = on_one_raster(signals, str(path))
        said = (*raw.notes, *stated, *coded, *notes)
        return Imported(columns, said, raw.began, path, file_sha256(path), mapping.made)
    stated = against_stated(raw.units, mapping, str(path))
    columns, coded = _renamed(raw.table, mapping, str(path))
    return Imported(columns, (*raw.notes, *stated, *coded), raw.began, path, file_sha256(path), mapping.made, raw.units)


def named_columns(
    source: str | Path | pd.DataFrame | Imported, channels: ChannelMap | str | Path | None = None
) -> tuple[dict[str, np.ndarray], str, str, tuple[Note, ...]]:
    """Columns of a file or of a table in our names, its name for messages, its hash, and what was done to read it.

    Raises:
        InputError: one line saying what is wrong with the file or the map.
    """
    read = import_columns(source, channels)
    columns, notes = dict(read.columns), tuple(map(of_reading, read.notes))
    if read.path is not None and read.sha256 is not None:
        return columns, str(read.path), read.sha256, notes
    rows = pd.util.hash_pandas_object(pd.DataFrame(columns), index=False).to_numpy()
    return columns, "the table", hashlib.sha256(rows.tobytes()).hexdigest(), notes


def _renamed(table: pd.DataFrame, mapping: ChannelMap, where: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """The columns of a table in our names, and notes.

    Raises:
        InputError: text in a channel that the map names, or a map that names what isn't there.
    """
    columns = {str(name): table[name].to_numpy() for name in table.columns}
    if not mapping.entries:
        return columns, []
    return mapping.apply({
        name: numbers(name, values, where, True) if name in mapping.entries else values
        for name, values in columns.items()
    }, where)  # fmt: skip


def _map(channels: ChannelMap | str | Path | None) -> ChannelMap:
    if channels is None:
        return channel_map({})
    if not isinstance(channels, ChannelMap | str | Path):
        raise InputError("channels", f"a {type(channels).__name__}", "a channel map's file or a ChannelMap",
                         "write the map into a file: their name, a colon, ours")  # fmt: skip
    return channels if isinstance(channels, ChannelMap) else read_channel_map(channels)


def numbers(name: str, values: np.ndarray, where: str, needed: bool) -> np.ndarray:
    """A column (n,) as float64; with `needed` every infinity is missing, too.

    Raises:
        InputError: text in it, with its row.
    """
    try:
        found = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):  # text, or a missing value of pandas
        found = pd.to_numeric(pd.Series(values), errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        bad = np.flatnonzero(np.isnan(found) & ~pd.isna(values))
        if bad.size:
            row = int(bad[0])
            raise InputError(f"{where}: column {name}, data row {row + 1}", repr(values[row]),
                             "numbers with a decimal point", "mend or empty this cell") from None
    return np.where(np.isfinite(found), found, np.nan) if needed else found


def columns_sha256(columns: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of columns (n,) with their names, in their order, as hex digits."""
    digest = hashlib.sha256()
    for name in columns:
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(columns[name]).tobytes())
    return digest.hexdigest()
