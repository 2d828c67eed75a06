"""What an importer returns: channels as the file has them, each with its own times, name and unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError

_OBJECT = re.compile(r"<[\w.]+ [^<>]*>")  # a library's object, as Python prints it
MOST_DISORDER_S = 1.0  # by which times of one channel may fall: buffers of several buses are written in turn


@dataclass(frozen=True)
class Signal:
    """One channel on its own raster.

    Attributes:
        name: as the file calls it (unique in the file).
        unit: as the file writes it; None where the file says none.
        time_s: (n,) times of the readings [s], in the order of the file; None where no clock is known (steady points).
        values: (n,) float64 [unit], NaN where the file says missing, not available or error.
        origin: where in the file it stands ("SPN 102 in PGN 65270 from address 0", "sheet Messung").
        spn: its number in SAE J1939, None for other files.
    """

    name: str
    unit: str | None
    time_s: np.ndarray | None
    values: np.ndarray
    origin: str = ""
    spn: int | None = None


@dataclass(frozen=True)
class RawChannels:
    """Everything that a file holds, before any channel map.

    Attributes:
        path: the file.
        kind: its format in words ("CSV", "MDF 4.10", "J1939 trace").
        signals: name -> channel. Empty where `table` holds the content.
        table: the rows of a file that is one table, in the file's own names; None for files of several rasters.
        units: name -> unit, where the file says it.
        notes: what the importer did or left out, one sentence each.
        began: date of the first row [UTC], where the file says it.
    """

    path: Path
    kind: str
    signals: Mapping[str, Signal] = field(default_factory=dict)
    table: pd.DataFrame | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    began: datetime | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels as the file calls them."""
        return tuple(self.signals) if self.table is None else tuple(str(name) for name in self.table.columns)


def unique_names(signals: Sequence[Signal]) -> dict[str, Signal]:
    """Name -> signal; a name met again gets its origin added, so that each can be told in a channel map."""
    found: dict[str, Signal] = {}
    for signal in signals:
        name = signal.name if signal.name not in found else f"{signal.name} ({signal.origin})"
        count = 2
        while name in found:
            name, count = f"{signal.name} ({signal.origin}, {count})", count + 1
        found[name] = replace(signal, name=name)
    return found


def refuse_restart(where: str, time_s: np.ndarray) -> None:
    """Refuse times (n,) [s], in the order of the file, of a clock that starts again: two drives would be mingled.

    Raises:
        InputError: the reading at which they fall by more than loggers of several buses write out of order.
    """
    falls = np.flatnonzero(np.diff(time_s) < -MOST_DISORDER_S)
    if falls.size:
        row = int(falls[0])
        raise InputError(f"{where}, reading {row + 2}", f"{time_s[row + 1]:.10g} s after {time_s[row]:.10g} s",
                         "increasing times", "the clock starts again: read runs one by one (cut the file there)")


def unreadable(
    path: Path, kind: str, error: object, do: str = "copy or export it again (is it truncated?)"
) -> InputError:
    """The one line for a file of a known format that its library cannot read."""
    text = " ".join(_OBJECT.sub("its content", str(error)).split())[:120]
    return InputError(
        str(path), f"no readable {kind} ({text})" if text else f"no readable {kind}", f"a whole {kind} file", do
    )
