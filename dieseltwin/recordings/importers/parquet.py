"""Parquet tables, with units from the columns' metadata where somebody wrote them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq

from dieseltwin.recordings.importers.clock import first_stamp, with_index
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.signals import RawChannels, unreadable

UNIT_KEYS = (b"unit", b"units", b"Unit")


def read_parquet(path: Path) -> RawChannels:
    """Read a Parquet table; an index that has a name becomes a column.

    Raises:
        InputError: not readable, or date stamps that are none.
    """
    try:
        frame = pd.read_parquet(path, page_checksum_verification=True)
        schema = pq.read_schema(path)
    except (OSError, ValueError) as error:
        raise unreadable(path, "Parquet", error) from None
    frame = with_index(frame)
    units = {}
    for field in schema:
        metadata = field.metadata or {}
        unit = next((metadata[key].decode("utf-8", "replace") for key in UNIT_KEYS if key in metadata), "")
        if unit:
            units[str(field.name)] = unit
    frame.columns = [str(name) for name in frame.columns]
    began = first_stamp(frame)
    frame, stamp_units, notes = in_seconds(frame, str(path))
    return RawChannels(path, "Parquet", table=frame, units={**units, **stamp_units}, notes=tuple(notes), began=began)
