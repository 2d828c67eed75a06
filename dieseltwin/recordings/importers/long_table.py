"""Tables with a reading a row, as phone apps write them: time, name, value, unit. Each name becomes a channel."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from dieseltwin.recordings.importers.layout import is_unit, told_unit
from dieseltwin.recordings.importers.signals import RawChannels, Signal, refuse_restart
from dieseltwin.recordings.time_units import SECONDS

MOST_COLUMNS, MOST_NAMES, LEAST_NAMES = 6, 2000, 3
READINGS = 10  # of each name, on average: a column of states has fewer names or a column of comments fewer rows
_TIME = re.compile(r"\b(time|seconds?|zeit|sekunden?|timestamp|temps|tiempo|tempo|t)\b", re.IGNORECASE)
_VALUE = re.compile(r"\b(value|wert|reading|messwert|valeur|valor|valore)\b", re.IGNORECASE)


@dataclass(frozen=True)
class Parts:
    """The columns of a table of one reading a row; `unit` is None where it has none."""

    clock: str
    label: str
    value: str
    unit: str | None


def parts_of(table: pd.DataFrame) -> Parts | None:
    """What the columns of a table with a reading a row are, its times being numbers; None of any other table."""
    if not 3 <= len(table.columns) <= MOST_COLUMNS or len(table) < LEAST_NAMES * READINGS:
        return None
    numbers = [str(name) for name in table.columns if pd.api.types.is_numeric_dtype(table[name])]
    clocks = [name for name in numbers if _TIME.search(name.replace("_", " "))]
    values = [name for name in numbers if _VALUE.search(name.replace("_", " "))]
    texts = [str(name) for name in table.columns if str(name) not in numbers]
    labels = [name for name in texts if _labels(table[name])]
    if len(clocks) != 1 or len(values) != 1 or not labels:
        return None
    units = [name for name in texts if name not in labels or table[name].dropna().map(lambda u: is_unit(str(u))).all()]
    labels = [name for name in labels if name not in units]
    return Parts(clocks[0], labels[0], values[0], units[0] if units else None) if len(labels) == 1 else None


def taken_apart(raw: RawChannels) -> RawChannels:
    """A table of one reading a row as channels, each on its own times [s]; any other table as it is.

    Raises:
        InputError: times that start again.
    """
    table = raw.table
    parts = None if table is None else parts_of(table)
    if table is None or parts is None:
        return raw
    unit_s = told_unit(parts.clock, raw.units.get(parts.clock))
    times = table[parts.clock].to_numpy(dtype=np.float64) * (SECONDS["s"] if unit_s is None else unit_s)
    signals = {}
    for name, rows in table.groupby(parts.label, sort=False).indices.items():
        refuse_restart(f"{raw.path}: {name} of column {parts.label}", times[rows])
        order = rows[np.argsort(times[rows], kind="stable")]
        order = order[np.append(np.diff(times[order]) > 0.0, True)]
        unit = "" if parts.unit is None else str(table[parts.unit].iloc[order[0]])
        signals[str(name)] = Signal(str(name), unit if unit not in ("", "nan") else None, times[order],
                                    table[parts.value].to_numpy(dtype=np.float64)[order])  # fmt: skip
    note = f"a reading a row: {len(signals)} names of column {parts.label} became channels"
    return replace(raw, signals=signals, table=None, notes=(*raw.notes, note))


def _labels(column: pd.Series) -> bool:
    count = column.nunique()
    return LEAST_NAMES <= count <= MOST_NAMES and column.notna().sum() >= READINGS * count
