"""Excel workbooks (.xlsx, .xlsm) by openpyxl: the sheet with the most numbers, its names and units."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.clock import first_stamp, with_clock
from dieseltwin.recordings.importers.decimals import clear_mark, doubtful_mark
from dieseltwin.recordings.importers.layout import LOOKED_AT, Layout, find_layout, is_missing, refuse_repeated
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.signals import RawChannels, unreadable
from dieseltwin.recordings.importers.text_cells import in_numbers
from dieseltwin.settings.extras import require

Cell = object  # what a workbook may hold: numbers, text, dates, booleans, nothing


def read_excel(path: Path) -> RawChannels:
    """Read the sheet of a workbook that holds the most rows of numbers.

    Raises:
        InputError: openpyxl is missing, not readable, no sheet with names above numbers, a name twice.
    """
    require("openpyxl", "formats", f"{path}: an Excel workbook")
    from openpyxl import load_workbook

    try:
        book = load_workbook(path, read_only=True, data_only=True)
        sheets = {sheet.title: [tuple(row) for row in sheet.iter_rows(values_only=True)] for sheet in book.worksheets}
        book.close()
    except Exception as error:  # openpyxl lets errors of zip, XML and its own classes through
        raise unreadable(path, "Excel", error) from None
    tables = {title: (rows, layout) for title, rows in sheets.items() if (layout := _layout(rows)) is not None}
    if not tables:
        raise InputError(
            str(path),
            f"no table in {len(sheets)} sheets",
            "a sheet with names above rows of numbers",
            "check the workbook",
        )
    title = max(tables, key=lambda name: _size(*tables[name]))
    rows, layout = tables[title]
    names = layout.names
    where = f"{path}: sheet {title}"
    refuse_repeated(names, f"{where},")
    frame, cell_units, read = _read_texts(_frame(rows, layout), where)
    units = {name: unit for name, unit in zip(names, layout.units, strict=True) if name and unit}
    began = first_stamp(frame)
    frame, stamp_units, notes = in_seconds(frame, where)
    notes = [*read, *notes]
    others = [name for name in tables if name != title]
    if others:
        notes.append(f"sheet {title} is read; {', '.join(others[:3])} also holds a table")
    units = cell_units | units | stamp_units
    return RawChannels(path, "Excel", table=frame, units=units, notes=tuple(notes), began=began)


def _layout(rows: list[tuple[Cell, ...]]) -> Layout | None:
    return find_layout([[_text(cell) for cell in row] for row in rows[:LOOKED_AT]])


def _text(cell: Cell) -> str:
    return "" if cell is None else str(cell)


def _size(rows: list[tuple[Cell, ...]], layout: Layout) -> int:
    return (len(rows) - layout.first_data) * len(layout.names)


def _frame(rows: list[tuple[Cell, ...]], layout: Layout) -> pd.DataFrame:
    """The cells below the names as a table, columns of numbers, dates and spans of time as such; words for 'no reading'
    are missing."""
    data = [row for row in rows[layout.first_data :] if any(cell is not None for cell in row)]
    columns = {}
    for index, name in enumerate(layout.names):
        if not name and index > 0:
            continue
        cells = [row[index] if index < len(row) else None for row in data]
        columns[name] = _column([None if isinstance(cell, str) and is_missing(cell) else cell for cell in cells])
    return with_clock(pd.DataFrame(columns), "").drop(columns="", errors="ignore")


def _column(cells: list[Cell]) -> pd.Series:
    series = pd.Series(cells, dtype=object)
    there = [cell for cell in cells if cell is not None]
    if there and all(isinstance(cell, timedelta) for cell in there):
        return pd.to_timedelta(series)
    if there and all(isinstance(cell, datetime) for cell in there):
        return pd.to_datetime(series)
    numbers = all(isinstance(cell, int | float) for cell in there)  # pandas would count dates as numbers as well
    return series.astype("float64") if numbers else series


def _read_texts(frame: pd.DataFrame, where: str) -> tuple[pd.DataFrame, dict[str, str], list[str]]:
    """The table with numbers that a column holds as text, name -> the unit that they carry, and notes.

    Raises:
        InputError: nothing tells decimals from thousands.
    """
    texts = frame[[name for name in frame.columns if frame[name].map(lambda cell: isinstance(cell, str)).any()]]
    if texts.empty:
        return frame, {}, []
    words = texts.where(texts.map(lambda cell: isinstance(cell, str)), None)
    mark = clear_mark(cell.strip() for name in words for cell in words[name].dropna())
    doubts: list[str] = []
    if mark is None:
        rows = [[_text(cell) for cell in row] for row in texts.itertuples(index=False)]
        mark, doubts = doubtful_mark(where, list(texts.columns), rows)
    read, units, notes = in_numbers(words, mark, where)
    for name in texts.columns:
        if pd.api.types.is_float_dtype(read[name]):  # beside the text there may be numbers
            others = texts[name].where(words[name].isna(), None)
            if not others.dropna().map(lambda cell: isinstance(cell, int | float)).all():
                continue
            frame = frame.assign(**{name: read[name].fillna(others.astype("float64"))})
    return frame, units, [*notes, *doubts]
