"""MDF 3 and 4 (test benches, INCA, CANape, loggers) by asammdf: channels read one by one, each on its own raster."""

from __future__ import annotations

import gc
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.can_frames import CanFrames, stacked
from dieseltwin.recordings.importers.signals import Signal, refuse_restart, unreadable
from dieseltwin.settings.extras import require

FRAMES = "CAN_DataFrame"
MASTER = 2  # asammdf's channel type of a group's time, as VIRTUAL_MASTER
VIRTUAL_MASTER = 3
TIME_SYNC = 1


def read_mdf(
    path: Path, wanted: Collection[str] | None = None
) -> tuple[str, list[Signal], CanFrames | None, list[str], datetime | None]:
    """Read the channels of an MDF file, and the raw frames of a bus log.

    Args:
        path: the file.
        wanted: names to read; None reads all. An hour of 500 channels takes long, five of them don't.

    Returns:
        The format's name, signals, the frames of a bus log (None without), notes, and when it begins [UTC].

    Raises:
        InputError: asammdf is missing, not readable, or without any channel of numbers.
    """
    require("asammdf", "formats", f"{path}: an MDF file")
    from asammdf import MDF

    problem = ""
    notes: list[str] = []
    began: datetime | None = None
    with _quiet_disposal():
        try:
            with MDF(path, memory="full", raise_on_multiple_occurrences=False) as mdf:
                kind = f"MDF {mdf.version}"
                began = mdf.start_time.astimezone(UTC)
                frames = _bus_frames(mdf, path)
                signals = list(_signals(mdf, wanted, notes))
        except InputError:
            raise
        except Exception as error:  # asammdf lets struct, zlib, mmap and its own errors through
            problem = str(error) or type(error).__name__
        if problem:
            gc.collect()  # now, while nobody hears it; half a second where much is loaded
    if problem:
        raise unreadable(path, "MDF", problem)
    if not signals and frames is None and wanted is None:
        raise InputError(
            str(path),
            f"an {kind} file without any channel of numbers",
            "a measurement with channels",
            "check the export" + (f" ({notes[0]})" if notes else ""),
        )
    return kind, signals, frames, notes, began


@contextmanager
def _quiet_disposal() -> Iterator[None]:
    """asammdf's half-made object of a broken file complains once more, on stderr, when Python throws it away."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = before


def _bus_frames(mdf: Any, path: Path) -> CanFrames | None:
    """The CAN frames of all bus-logging groups in time order, classic frames and CAN FD."""
    parts = []
    for index, group in enumerate(mdf.groups):
        if not group.channel_group.cycles_nr or not any(channel.name == FRAMES for channel in group.channels):
            continue
        events = mdf.get(FRAMES, group=index)
        rows = events.samples
        fields = {name.rsplit(".", 1)[-1]: rows[name] for name in rows.dtype.names}
        data = np.atleast_2d(fields["DataBytes"])
        identifier = fields["ID"].astype(np.uint32)
        extended = fields["IDE"].astype(bool) if "IDE" in fields else identifier > 0x7FF
        length = fields.get("DataLength", np.full(len(rows), data.shape[1]))
        refuse_restart(f"{path}: bus log, group {index}", events.timestamps)
        parts.append(CanFrames.of(events.timestamps, identifier & 0x1FFFFFFF, extended, length, data))
    return stacked(parts) if parts else None


def _signals(mdf: Any, wanted: Collection[str] | None, notes: list[str]) -> Iterator[Signal]:
    left_out: list[str] = []
    for index, group in enumerate(mdf.groups):
        if not group.channel_group.cycles_nr or any(
            channel.name.startswith(("CAN_", "LIN_")) for channel in group.channels
        ):
            continue
        for position, channel in enumerate(group.channels):
            if channel.channel_type in (MASTER, VIRTUAL_MASTER) and channel.sync_type in (TIME_SYNC, 0):
                continue
            name = str(channel.name)
            if wanted is not None and not any(entry == name or entry.startswith(f"{name} (") for entry in wanted):
                continue
            if mdf.masters_db.get(index) == position:
                continue
            signal = mdf.get(name, group=index, index=position)
            values = _numbers(signal)
            if values is None:
                left_out.append(name)
                continue
            raster = str(getattr(group.channel_group, "acq_name", "") or "").strip()
            yield Signal(
                name,
                str(signal.unit).strip() or None,
                np.asarray(signal.timestamps, dtype=np.float64),
                values,
                raster or f"group {index}",
            )
    if left_out:
        notes.append(
            f"left out, no plain numbers: {', '.join(left_out[:6])}" + (" and more" if len(left_out) > 6 else "")
        )


def _numbers(signal: Any) -> np.ndarray | None:
    """Physical values (n,) with NaN where the file marks them invalid; None for text and arrays."""
    samples = signal.samples
    if samples.ndim != 1 or samples.dtype.kind not in "fiub":
        return None
    values = samples.astype(np.float64)
    invalid = signal.invalidation_bits
    if invalid is not None:
        values[np.asarray(invalid, dtype=bool)] = np.nan
    values[~np.isfinite(values)] = np.nan
    return values
