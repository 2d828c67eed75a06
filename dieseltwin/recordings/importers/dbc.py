"""Signals of a CAN trace by a DBC file (cantools). J1939 databases match by parameter group, whatever the source."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.can_frames import CanFrames
from dieseltwin.recordings.importers.j1939 import not_available, parameter_group
from dieseltwin.recordings.importers.signals import Signal
from dieseltwin.settings.extras import require


def decode_by_dbc(path: Path, frames: CanFrames, database: Path) -> tuple[list[Signal], list[str]]:
    """Decode frames by a DBC (or any other database that cantools reads: ARXML, KCD, SYM); and notes.

    Raises:
        InputError: cantools is missing, the database is not readable, or none of its messages is in the trace.
    """
    require("cantools", "formats", f"{path}: a CAN trace with a DBC")
    import cantools

    if not database.is_file():
        raise InputError(str(database), "no such file", "a DBC file", "check the path")
    try:
        content = cantools.database.load_file(database, strict=False)
    except Exception as error:  # cantools raises its own, parse and decoding errors
        raise InputError(
            str(database),
            f"no readable DBC ({' '.join(str(error).split())[:120]})",
            "a DBC file",
            "check or export it again",
        ) from None
    groups = parameter_group(frames.identifier)
    signals: list[Signal] = []
    notes: list[str] = []

    def add(message: Any, rows: np.ndarray, origin: str, j1939: bool) -> None:
        found, unknown = _message_signals(message, frames.take(rows), origin, j1939)
        signals.extend(found)
        if unknown:
            notes.append(f"{unknown} frames of {origin} can't be decoded by {database.name} and count as missing "
                         "(a multiplexed page that it doesn't describe?)")  # fmt: skip

    for message in content.messages:
        if message.protocol == "j1939":
            group = int(parameter_group(np.array([message.frame_id], dtype=np.uint32))[0])
            rows = frames.extended & (groups == group)
            for source in np.unique(frames.identifier[rows] & 0xFF):
                chosen = rows & ((frames.identifier & 0xFF) == source)
                add(message, chosen, f"{message.name} from address {source}", True)
        else:
            rows = (frames.identifier == message.frame_id) & (frames.extended == message.is_extended_frame)
            if rows.any():
                add(message, rows, message.name, False)
    if not signals:
        raise InputError(
            str(path),
            f"no message of {database.name} ({len(content.messages)} messages)",
            "frames that this database describes",
            "give the DBC of this bus, or none for plain J1939",
        )
    return signals, notes


def _message_signals(message: Any, frames: CanFrames, origin: str, j1939: bool) -> tuple[list[Signal], int]:
    """The signals of one message, and the number of frames that the database can't decode.

    Each distinct payload is decoded once, for a bus repeats itself.
    """
    from cantools.database import DecodeError

    width = min(message.length or frames.data.shape[1], frames.data.shape[1])
    whole = frames.length >= width
    frames = frames if whole.all() else frames.take(whole)
    if not frames.size:
        return [], 0
    payloads, back = np.unique(frames.data[:, :width], axis=0, return_inverse=True)
    names = [signal.name for signal in message.signals]
    table = np.full((len(payloads), len(names)), np.nan)
    unknown = np.zeros(len(payloads), dtype=bool)
    for row, payload in enumerate(payloads):
        try:
            raw = message.decode(payload.tobytes(), decode_choices=False, scaling=False, allow_truncated=True)
        except DecodeError:
            unknown[row] = True
            continue
        for column, signal in enumerate(message.signals):
            value = raw.get(signal.name)
            if value is None:  # of another multiplexed page
                continue
            if j1939 and not signal.is_float and not signal.is_signed and not_available(int(value), signal.length):
                continue
            table[row, column] = signal.conversion.raw_to_scaled(value, decode_choices=False)
    values = table[back.ravel()]
    lacking = int(np.count_nonzero(unknown[back.ravel()]))
    found = []
    for column, signal in enumerate(message.signals):
        readings = values[:, column]
        # a page of a multiplexed message comes now and then: the other frames are no readings of it
        rows = np.isfinite(readings) if signal.multiplexer_ids else np.ones(len(readings), dtype=bool)
        if not np.isfinite(readings).any():
            continue
        found.append(Signal(signal.name, signal.unit or None, frames.time_s[rows], readings[rows], origin, signal.spn))
    return found, lacking
