"""Excel workbooks (.xlsx, .xlsm) by openpyxl: the sheet with the most numbers, its names and units."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.clock import first_stamp
from dieseltwin.recordings.importers.layout import LOOKED_AT, Layout, find_layout, is_missing
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.signals import RawChannels, unreadable
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
    twice = [name for name in dict.fromkeys(names) if name and names.count(name) > 1]
    if twice:
        raise InputError(
            f"{path}: sheet {title}, column {twice[0]}", "a column given twice", "each name once", "drop one"
        )
    frame = _frame(rows, layout)
    units = {name: unit for name, unit in zip(names, layout.units, strict=True) if name and unit}
    began = first_stamp(frame)
    frame, stamp_units, notes = in_seconds(frame, f"{path}: sheet {title}")
    others = [name for name in tables if name != title]
    if others:
        notes.append(f"sheet {title} is read; {', '.join(others[:3])} also holds a table")
    return RawChannels(path, "Excel", table=frame, units={**units, **stamp_units}, notes=tuple(notes), began=began)


def _layout(rows: list[tuple[Cell, ...]]) -> Layout | None:
    return find_layout([[_text(cell) for cell in row] for row in rows[:LOOKED_AT]])


def _text(cell: Cell) -> str:
    return "" if cell is None else str(cell)


def _size(rows: list[tuple[Cell, ...]], layout: Layout) -> int:
    return (len(rows) - layout.first_data) * len(layout.names)


def _frame(rows: list[tuple[Cell, ...]], layout: Layout) -> pd.DataFrame:
    """The numbers as a table; words for 'no reading' are missing, decimal commas in text are read."""
    data = [row for row in rows[layout.first_data :] if any(cell is not None for cell in row)]
    columns = {}
    for index, name in enumerate(layout.names):
        if not name:
            continue
        cells = [row[index] if index < len(row) else None for row in data]
        cells = [None if isinstance(cell, str) and is_missing(cell) else cell for cell in cells]
        columns[name] = _column(cells)
    return pd.DataFrame(columns)


def _column(cells: list[Cell]) -> pd.Series:
    series = pd.Series(cells, dtype=object)
    numbers = pd.to_numeric(series, errors="coerce")
    if not (numbers.isna() & series.notna()).any():
        return numbers.astype("float64")
    texts = series.map(lambda cell: cell.strip().replace(",", ".") if isinstance(cell, str) else cell)
    numbers = pd.to_numeric(texts, errors="coerce")
    return numbers.astype("float64") if not (numbers.isna() & series.notna()).any() else series
