"""SAE J1939 without any DBC: a table of engine parameter groups, from J1939-71 and the Digital Annex (J1939DA).

The table (`data/j1939_engine.csv`) is our own writing: group, number (SPN), unit, place, scale and offset of each
parameter. `checked` says whether a reference decode of real traces agreed with it or only the standard's text does.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TypeAlias

import numpy as np

from dieseltwin.recordings.importers.can_frames import CanFrames
from dieseltwin.recordings.importers.signals import Signal

PDU2 = 240  # from this format byte on the next byte belongs to the group, below it is a destination
TRANSPORT, TRANSFER = 60416, 60160  # TP.CM and TP.DT: groups of more than eight bytes
BROADCAST = 32  # BAM
FEWEST = 2  # readings of a signal: a flood of random identifiers hits a group of the table now and then
NOT_A_NODE = (254, 255)  # null and global address send nothing
# Addresses of engine controllers by J1939-81: these come first and keep the plain name.
ENGINE_ADDRESSES = (0, 1)
ENGINE_SPEED = 190  # SPN


@dataclass(frozen=True)
class Parameter:
    """One parameter of a group.

    Attributes:
        pgn, acronym: its group.
        spn, name, unit: its number, name and unit.
        start, bits: first bit (byte 1 bit 1 is 0) and length.
        scale, offset: value = scale * raw + offset [unit].
        checked: "reference" or "standard".
    """

    pgn: int
    acronym: str
    spn: int
    name: str
    unit: str
    start: int
    bits: int
    scale: float
    offset: float
    checked: str


Found: TypeAlias = tuple[Parameter, int, np.ndarray, np.ndarray]  # parameter, source address, times [s], values


@cache
def parameters() -> tuple[Parameter, ...]:
    """The table, in the order of groups and places."""
    text = resources.files("dieseltwin").joinpath("data/j1939_engine.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return tuple(
        Parameter(
            int(row["pgn"]),
            row["acronym"],
            int(row["spn"]),
            row["name"],
            row["unit"],
            int(row["start_bit"]),
            int(row["bits"]),
            float(row["scale"]),
            float(row["offset"]),
            row["checked"],
        )
        for row in rows
    )


def parameter_group(identifier: np.ndarray) -> np.ndarray:
    """(n,) parameter group numbers of 29-bit identifiers (J1939-21, section 5.2)."""
    identifier = np.asarray(identifier, dtype=np.int64)
    group = (identifier >> 8) & 0x3FFFF
    return np.where(((identifier >> 16) & 0xFF) < PDU2, group & 0x3FF00, group)


def looks_like_j1939(frames: CanFrames) -> bool:
    """Whether at least two different groups of the table are in the trace, sent by a node."""
    known = {parameter.pgn for parameter in parameters()}
    groups = parameter_group(frames.identifier[frames.extended])
    return len(known.intersection(np.unique(groups).tolist())) >= FEWEST


def not_available(raw: int, bits: int) -> bool:
    """Whether a raw value is a code (J1939-71, table 1): not available, error, or another one above the valid range."""
    return raw > _largest_valid(bits)


def _largest_valid(bits: int) -> int:
    """Largest raw value that is a number: 0xFA.. for whole bytes; the last two of a discrete one are error and n/a."""
    if bits >= 8:
        return (0xFA << (bits - 8)) | ((1 << (bits - 8)) - 1)
    return (1 << bits) - 3 if bits >= 2 else 1


def decode(frames: CanFrames) -> tuple[list[Signal], list[str]]:
    """Decode a trace by the table.

    Returns:
        Signals, the engine's first, and notes. Readings that are not available or errors are NaN; a parameter that is
        never available from a source is no signal.
    """
    groups = parameter_group(frames.identifier)
    sources = (frames.identifier & 0xFF).astype(np.int64)
    usable = frames.extended & ~np.isin(sources, NOT_A_NODE)
    long_groups = _transported(frames.take(usable & np.isin(groups, (TRANSPORT, TRANSFER))))
    found: list[Found] = []
    silent = 0
    for pgn in dict.fromkeys(parameter.pgn for parameter in parameters()):
        wanted = [parameter for parameter in parameters() if parameter.pgn == pgn]
        rows = np.flatnonzero(usable & (groups == pgn))
        parts = [(int(source), frames.take(rows[sources[rows] == source])) for source in np.unique(sources[rows])]
        parts += [(source, part) for (group, source), part in long_groups.items() if group == pgn]
        for source, part in parts:
            for parameter in wanted:
                values = _values(part, parameter)
                if np.isfinite(values).sum() >= FEWEST:
                    found.append((parameter, source, part.time_s, values))
                else:
                    silent += 1
    notes = [f"{silent} parameters are sent but never available (or once only), and left out"] if silent else []
    signals = _named(found)
    engines = _engines(found)
    if len(engines) > 1:
        text = " and ".join(str(source) for source in engines)
        notes.append(f"engines at addresses {text}: one twin is of one engine; those of another carry its address")
    return signals, notes


def _engines(found: list[Found]) -> list[int]:
    """Addresses of the engine controllers that send an engine speed: each is an engine of its own."""
    return sorted({source for parameter, source, *_ in found
                   if parameter.spn == ENGINE_SPEED and source in ENGINE_ADDRESSES})  # fmt: skip


def _named(found: list[Found]) -> list[Signal]:
    """'SPN 190 engine_speed'; the same number from a second source or group carries it in its name."""
    found.sort(key=lambda item: (item[1] not in ENGINE_ADDRESSES, item[1]))
    others = _engines(found)[1:]
    signals, taken = [], set()
    for parameter, source, time_s, values in found:
        name = f"SPN {parameter.spn} {parameter.name}"
        if name in taken or source in others:  # another engine's is never taken for the first one's
            name = f"{name} (address {source})"
        if name in taken:
            name = f"{name[:-1]}, PGN {parameter.pgn})"
        taken.add(name)
        origin = f"PGN {parameter.pgn} {parameter.acronym} from address {source}"
        signals.append(Signal(name, parameter.unit, time_s, values, origin, parameter.spn))
    return signals


def _values(frames: CanFrames, parameter: Parameter) -> np.ndarray:
    """(n,) physical values, NaN where not available, error, or beyond the frame's end."""
    first, shift = divmod(parameter.start, 8)
    size = (shift + parameter.bits + 7) // 8
    if first + size > frames.data.shape[1]:
        return np.full(frames.size, np.nan)
    raw = np.zeros(frames.size, dtype=np.int64)
    for index in range(size):
        raw |= frames.data[:, first + index].astype(np.int64) << (8 * index)
    raw = (raw >> shift) & ((1 << parameter.bits) - 1)
    valid = (raw <= _largest_valid(parameter.bits)) & (frames.length >= first + size)
    return np.where(valid, raw * parameter.scale + parameter.offset, np.nan)


def _transported(frames: CanFrames) -> dict[tuple[int, int], CanFrames]:
    """Groups of more than eight bytes that were broadcast in pieces (BAM, J1939-21 section 5.10), put together."""
    groups = parameter_group(frames.identifier)
    open_messages: dict[int, tuple[int, int, float, dict[int, bytes]]] = {}
    whole: dict[tuple[int, int], list[tuple[float, bytes]]] = {}
    for row in range(frames.size):
        source, payload = int(frames.identifier[row] & 0xFF), frames.data[row, :8].tobytes()
        if groups[row] == TRANSPORT:
            if payload[0] == BROADCAST:
                pgn = payload[5] | payload[6] << 8 | payload[7] << 16
                open_messages[source] = (pgn, payload[1] | payload[2] << 8, float(frames.time_s[row]), {})
            continue
        if source not in open_messages:
            continue
        pgn, length, _, pieces = open_messages[source]
        pieces[payload[0]] = payload[1:]
        if len(pieces) * 7 >= length:
            data = b"".join(pieces[key] for key in sorted(pieces))[:length]
            whole.setdefault((pgn, source), []).append((float(frames.time_s[row]), data))
            del open_messages[source]
    return {key: _as_frames(messages) for key, messages in whole.items()}


def _as_frames(messages: list[tuple[float, bytes]]) -> CanFrames:
    width = max(8, max(len(data) for _, data in messages))
    data = np.array([list(data.ljust(width, b"\xff")) for _, data in messages], dtype=np.uint8)
    n = len(messages)
    return CanFrames.of(
        np.array([time for time, _ in messages]),
        np.zeros(n),
        np.ones(n),
        np.array([len(data) for _, data in messages]),
        data,
    )
