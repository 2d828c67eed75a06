"""Frames of a CAN trace: candump text (both kinds), Vector ASC and BLF, PEAK TRC; BLF, ASC and TRC by python-can."""

from __future__ import annotations

import io
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.clock import DAY_S, going_on
from dieseltwin.recordings.importers.content import Content
from dieseltwin.recordings.importers.signals import unreadable
from dieseltwin.settings.extras import require

DIFFERENCES = 0.25  # share of falling times in a trace of differences; buses written in turn have fewer
FILLER = 0xFF  # bytes beyond a frame's length: "not available" in J1939
# (000.005001)  can0  18FEDF00   [8]  8A A0 28 7D 7D FF FF F5
_COLUMNS = re.compile(
    r"^\s*\((?:(?P<date>\d{4}-\d{2}-\d{2}) )?(?P<time>[\d.:]+)\)\s+(?P<bus>\S+)\s+(?:[TRX-]+\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3,8})\s+\[(?P<length>\d+)\](?P<data>(?:\s+[0-9A-Fa-f]{2})*)"
)
# (1436509052.249713) can0 18FEDF00#8AA0287D7DFFFFF5
_COMPACT = re.compile(
    r"^\s*\((?P<time>\d+\.\d+)\)\s+(?P<bus>\S+)\s+(?P<id>[0-9A-Fa-f]{3,8})#(?P<fd>#[0-9A-Fa-f])?(?P<data>[0-9A-Fa-f.]*)"
)
_RELATIVE = re.compile(r"^(\s*base\s+(?:hex|dec)\s+timestamps\s+)relative", re.MULTILINE | re.IGNORECASE)
_EVENT = re.compile(r"\s*(\d+\.\d+)(?=\s)")
_FIRST_DAY = date(1970, 1, 1).toordinal()
_ERROR_FLAG = 0x20000000


@dataclass(frozen=True)
class CanFrames:
    """n data frames in the order of the trace.

    Attributes:
        time_s: (n,) [s] as in the trace.
        identifier: (n,) 11 or 29 bits.
        extended: (n,) whether it has 29 bits.
        length: (n,) bytes of data.
        data: (n, width) bytes, 0xFF beyond the length.
        notes: what was left out.
    """

    time_s: np.ndarray
    identifier: np.ndarray
    extended: np.ndarray
    length: np.ndarray
    data: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of frames."""
        return int(self.time_s.size)

    @classmethod
    def of(
        cls,
        time_s: np.ndarray,
        identifier: np.ndarray,
        extended: np.ndarray,
        length: np.ndarray,
        data: np.ndarray,
        notes: Sequence[str] = (),
    ) -> CanFrames:
        """Frames with everything beyond their length filled up."""
        length = np.minimum(np.asarray(length, dtype=np.int64), data.shape[1])
        filled = np.where(np.arange(data.shape[1])[None, :] < length[:, None], data, FILLER).astype(np.uint8)
        return cls(
            np.asarray(time_s, dtype=np.float64),
            np.asarray(identifier, dtype=np.uint32),
            np.asarray(extended, dtype=bool),
            length,
            filled,
            tuple(notes),
        )

    def take(self, chosen: np.ndarray) -> CanFrames:
        """The frames of a mask or index array."""
        return CanFrames(
            self.time_s[chosen], self.identifier[chosen], self.extended[chosen], self.length[chosen], self.data[chosen]
        )


def stacked(parts: Sequence[CanFrames]) -> CanFrames:
    """Several buses or groups as one trace in time order."""
    width = max(part.data.shape[1] for part in parts)
    data = np.vstack(
        [np.pad(part.data, ((0, 0), (0, width - part.data.shape[1])), constant_values=FILLER) for part in parts]
    )
    joined = CanFrames(
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([part.identifier for part in parts]),
        np.concatenate([part.extended for part in parts]),
        np.concatenate([part.length for part in parts]),
        data,
    )
    return joined.take(np.argsort(joined.time_s, kind="stable"))


def read_frames(path: Path, content: Content) -> CanFrames:
    """Read the frames of a trace.

    Raises:
        InputError: no frame in it, no time stamps, or python-can is missing for a format that needs it.
    """
    if content.format == "candump":
        text = content.bytes_of(path).decode("latin-1")
        frames = _from_text(path, text.splitlines())
    else:
        frames = _from_python_can(path, content)
    if frames.size == 0:
        raise InputError(str(path), "a CAN trace without any data frame", "frames with time stamps", "record again")
    return frames


def _from_text(path: Path, lines: Iterable[str]) -> CanFrames:
    times: list[float] = []
    identifiers: list[int] = []
    extended: list[bool] = []
    payloads: list[bytes] = []
    other = broken = 0
    of_day = False
    for line in lines:
        found = _COLUMNS.match(line) or _COMPACT.match(line)
        payload = None if found is None else _payload(found["data"])
        if found is None or payload is None:
            broken += bool(line.strip()) and not line.lstrip().startswith("#")
            continue
        if "#R" in line or "remote request" in line or int(found["id"], 16) & _ERROR_FLAG:
            other += 1
            continue
        stamp = found.groupdict().get("date")
        day = 0 if stamp is None else date.fromisoformat(stamp).toordinal() - _FIRST_DAY
        of_day = of_day or ":" in found["time"]
        times.append(DAY_S * day + _seconds(found["time"]))
        identifiers.append(int(found["id"], 16))
        extended.append(len(found["id"]) > 3)
        payloads.append(payload)
    if not times:
        raise InputError(
            str(path),
            "a CAN trace without times",
            "a time in brackets in every line",
            "record with `candump -L` or `candump -t a`",
        )
    if times[0] == 0.0 and np.mean(np.diff(times) < 0.0) > DIFFERENCES:
        raise InputError(str(path), "times that fall again and again, as the times since the last frame do",
                         "times since the beginning", "record with `candump -t a`")  # fmt: skip
    notes = [f"{other} remote and error frames left out"] if other else []
    if of_day:
        times, changed = _past_midnight(times)
        notes.extend(changed)
    if broken:
        notes.append(f"{broken} lines that are no frame left out")
    return _packed(times, identifiers, extended, payloads, notes)


def _payload(digits: str) -> bytes | None:
    """The bytes of a frame; None where the line ends in the middle of one."""
    digits = "".join(digits.split()).replace(".", "")
    return None if len(digits) % 2 else bytes.fromhex(digits)


def _past_midnight(times: Sequence[float]) -> tuple[list[float], list[str]]:
    """Times of day [s] that go on after midnight and where the clock is put back or forward, and notes."""
    seconds = np.array(times)
    seconds += DAY_S * np.cumsum(np.r_[0.0, np.diff(seconds) < -0.5 * DAY_S])
    since, notes = going_on(seconds - seconds[0], float(seconds[0] % DAY_S))
    return (since + seconds[0]).tolist(), notes


def _seconds(stamp: str) -> float:
    """'029.997509' or '12:30:01.25' in s."""
    total = 0.0
    for part in stamp.split(":"):
        total = 60.0 * total + float(part)
    return total


def _packed(
    times: Sequence[float],
    identifiers: Sequence[int],
    extended: Sequence[bool],
    payloads: Sequence[bytes],
    notes: Sequence[str],
) -> CanFrames:
    width = max(8, max((len(payload) for payload in payloads), default=8))
    joined = b"".join(payload.ljust(width, bytes([FILLER])) for payload in payloads)
    data = np.frombuffer(joined, dtype=np.uint8).reshape(len(payloads), width)
    return CanFrames.of(
        np.array(times),
        np.array(identifiers, dtype=np.uint32),
        np.array(extended, dtype=bool),
        np.array([len(payload) for payload in payloads], dtype=np.int64),
        data,
        notes,
    )


def _from_python_can(path: Path, content: Content) -> CanFrames:
    kind = {"blf": "BLF trace", "asc": "ASC trace", "trc": "TRC trace"}[content.format]
    require("can", "formats", f"{path}: a {kind}")
    import can

    readers = {"blf": can.BLFReader, "asc": can.ASCReader, "trc": can.TRCReader}
    times: list[float] = []
    identifiers: list[int] = []
    extended: list[bool] = []
    payloads: list[bytes] = []
    other, notes = 0, []
    try:
        for message in _messages(readers[content.format], path, content):
            if message.is_error_frame or message.is_remote_frame:
                other += 1
                continue
            times.append(message.timestamp)
            identifiers.append(message.arbitration_id)
            extended.append(message.is_extended_id)
            payloads.append(bytes(message.data))
    except Exception as error:  # python-can lets struct, zlib and its own errors through
        if not times:
            raise unreadable(path, kind, error) from None
        notes.append(f"the trace ends broken after {times[-1] - times[0]:.6g} s ({' '.join(str(error).split())[:60]})")
    if other:
        notes.append(f"{other} remote and error frames left out")
    return _packed(times, identifiers, extended, payloads, notes)


def _messages(reader: type, path: Path, content: Content) -> Iterator:
    if content.format == "asc":
        yield from reader(io.StringIO(_since_the_beginning(content.bytes_of(path).decode("latin-1"))))
    elif content.data is None:
        with reader(str(path)) as messages:
            yield from messages
    else:
        with tempfile.NamedTemporaryFile(suffix=f".{content.format}") as unpacked:
            unpacked.write(content.data)
            unpacked.flush()
            with reader(unpacked.name) as messages:
                yield from messages


def _since_the_beginning(text: str) -> str:
    """An ASC trace with times since its beginning, where it has the times since the event before, of whatever kind."""
    if not _RELATIVE.search(text):
        return text
    lines, now = _RELATIVE.sub(r"\1absolute", text).splitlines(), 0.0
    for number, line in enumerate(lines):
        event = _EVENT.match(line)
        if event:
            now += float(event.group(1))
            lines[number] = f"{now:.9f}{line[event.end():]}"
    return "\n".join(lines) + "\n"
