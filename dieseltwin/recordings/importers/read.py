"""One way in for every format: the file's content chooses the importer."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers import j1939
from dieseltwin.recordings.importers.can_frames import CanFrames, read_frames
from dieseltwin.recordings.importers.content import recognise
from dieseltwin.recordings.importers.dbc import decode_by_dbc
from dieseltwin.recordings.importers.delimited import read_delimited
from dieseltwin.recordings.importers.excel import read_excel
from dieseltwin.recordings.importers.long_table import taken_apart
from dieseltwin.recordings.importers.matlab import read_hdf5, read_matlab
from dieseltwin.recordings.importers.mdf import read_mdf
from dieseltwin.recordings.importers.parquet import read_parquet
from dieseltwin.recordings.importers.signals import RawChannels, Signal, refuse_restart, unique_names

DBC_HINT = "name its DBC in the channel map (dbc: bus.dbc); `dieseltwin channels FILE --dbc bus.dbc` writes one"
TRACES = {"candump": "candump trace", "asc": "ASC trace", "blf": "BLF trace", "trc": "TRC trace"}


def read_raw(path: str | Path, database: Path | None = None, wanted: Collection[str] | None = None) -> RawChannels:
    """Read a file as it is: every channel with its name, unit and times.

    Args:
        path: CSV of any dialect, Parquet, Excel, MATLAB, MDF, or a CAN trace.
        database: DBC of a CAN trace; without one the trace is read as J1939.
        wanted: names of the channels that are needed (large MDF files); None reads all.

    Raises:
        InputError: one line saying what is wrong with the file.
    """
    path = Path(path)
    content = recognise(path)
    if content.format in TRACES:
        frames = read_frames(path, content)
        return _from_frames(path, TRACES[content.format], frames, database)
    if database is not None and content.format != "mdf":
        raise _no_frames(path, database)
    if content.format == "mdf":
        return _from_mdf(path, database, wanted)
    if content.format == "csv":
        raw = read_delimited(path, content.bytes_of(path))
    else:
        readers = {"parquet": read_parquet, "excel": read_excel, "matlab": read_matlab, "hdf5": read_hdf5}
        raw = readers[content.format](path)
    if raw.table is not None and len(raw.table) == 0:
        raise InputError(str(path), "no rows", "a header and rows", "record again")
    return taken_apart(raw)


def _no_frames(path: Path, database: Path) -> InputError:
    return InputError(f"{path} with {database.name}", "a file without CAN frames", "a DBC for a CAN trace only",
                      "leave the DBC out")  # fmt: skip


def _from_mdf(path: Path, database: Path | None, wanted: Collection[str] | None) -> RawChannels:
    kind, signals, frames, notes, began = read_mdf(path, wanted)
    if frames is None:
        if database is not None:
            raise _no_frames(path, database)
        return _in_order(RawChannels(path, kind, unique_names(signals), notes=tuple(notes), began=began))
    bus = _from_frames(path, f"{kind} bus log", frames, database)
    return _in_order(
        RawChannels(
            path, bus.kind, unique_names([*bus.signals.values(), *signals]), notes=(*notes, *bus.notes), began=began
        )
    )


def _from_frames(path: Path, kind: str, frames: CanFrames, database: Path | None) -> RawChannels:
    if database is not None:
        signals, notes = decode_by_dbc(path, frames, database)
        kind = f"{kind} by {database.name}"
        return _in_order(RawChannels(path, kind, unique_names(signals), notes=(*frames.notes, *notes)))
    if not j1939.looks_like_j1939(frames):
        count = len(np.unique(frames.identifier))
        raise InputError(
            str(path),
            f"a {kind} of {frames.size} frames, {count} identifiers, none of J1939's engine groups",
            "a J1939 trace, or any trace with its DBC",
            DBC_HINT,
        )
    signals, notes = j1939.decode(frames)
    if not signals:
        raise InputError(
            str(path), "J1939 frames without any engine signal", "a trace of the engine's bus", "check the bus"
        )
    return _in_order(RawChannels(path, f"J1939 {kind}", unique_names(signals), notes=(*frames.notes, *notes)))


def _in_order(raw: RawChannels) -> RawChannels:
    """Each channel in the order of its times, each time once: loggers of several buses write out of order.

    Raises:
        InputError: times that start again.
    """
    ordered: dict[str, Signal] = {}
    mended = 0
    for name, signal in raw.signals.items():
        time = signal.time_s
        if time is None or time.size < 2 or (np.diff(time) > 0).all():
            ordered[name] = signal
            continue
        refuse_restart(f"{raw.path}: channel {name}", time)
        mended += 1
        time, rows = np.unique(time, return_index=True)
        ordered[name] = Signal(name, signal.unit, time, signal.values[rows], signal.origin, signal.spn)
    notes = (f"{mended} channels had times that repeat or fall: sorted, each time once",) if mended else ()
    return replace(raw, signals=ordered, notes=(*raw.notes, *notes))
