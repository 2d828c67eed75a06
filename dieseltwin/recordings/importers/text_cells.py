"""What a plain reader of numbers leaves as text in a table: grouped thousands, units in cells, repeated names."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd

from dieseltwin.recordings.importers.decimals import either, groups, writes_groups
from dieseltwin.recordings.importers.layout import BLANKS, is_number, is_stamp_text, is_unit
from dieseltwin.settings.names import listed

SAMPLE = 200  # cells that decide whether a column of text holds numbers
NUMBERS = 0.9  # of them
HEAD_ROWS = 200  # in which statistics may stand above the numbers
MOST_STATISTICS = 12  # rows of them; more are the rows of a table
HEADING = 0.5  # of a row's cells that are the names of their columns, or units

_GROUP = re.compile(rf"(?<=\d)['’{BLANKS} ](?=\d{{3}}(?!\d))")
_STATISTICS = re.compile(
    r"\s*\"?(mean|average|avg|std|std ?dev|standard deviation|stddev|min|max|minimum|maximum|median|sum|rms|range|var|"
    r"mittelwert|mittel|standardabweichung|stdabw|summe|spannweite|moyenne|[ée]cart[ -]type|media|"
    r"desv(?:iaci[oó]n)? est\w*)\.?:?\"?\s*[;,\t|]\s*\"?[-+]?[\d.,]", re.IGNORECASE)  # fmt: skip
_CELL = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*(.*)$")


def without_statistics(text: str) -> tuple[str, list[str]]:
    """A text table without the rows of statistics ("Mean;1333;130") that programs write above or below it, and a note.

    Columns of such words, as tables of points have them, stay.
    """
    below: list[str] = []
    kept = text.rstrip()
    while len(below) <= MOST_STATISTICS and (found := _STATISTICS.match(kept[kept.rfind("\n") + 1 :])):
        below.append(found.group(1))
        kept = kept[: max(kept.rfind("\n"), 0)].rstrip()
    lines = kept.split("\n", HEAD_ROWS)
    matches = [_STATISTICS.match(line) if row < HEAD_ROWS else None for row, line in enumerate(lines)]
    words = [*(found.group(1) for found in matches if found), *reversed(below)]
    if not words or len(words) > MOST_STATISTICS:
        return text, []
    kept = "\n".join(line for line, found in zip(lines, matches, strict=True) if not found)
    return kept + "\n", [f"{len(words)} rows of statistics left out ({listed(words)})"]


def without_repeated_names(frame: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The table (n, k) without rows that repeat its names and their units, as logs put together have, and a note."""
    texts = [name for name in frame.columns if frame[name].dtype == object or _is_text(frame[name])]
    if len(texts) < HEADING * len(frame.columns):
        return frame, []
    names = np.mean([frame[name].astype(str).str.strip().to_numpy() == str(name) for name in texts], axis=0) > HEADING
    if not names.any():
        return frame, []
    behind = np.flatnonzero(names) + 1
    units = [row for row in behind[behind < len(frame)]
             if np.mean([is_unit(str(frame[name].iloc[row])) for name in texts]) > HEADING]  # fmt: skip
    dropped = names.copy()
    dropped[units] = True
    note = f"{int(names.sum())} repeated rows of names left out"
    return frame[~dropped].reset_index(drop=True), [note]


def in_numbers(
    frame: pd.DataFrame, decimal: str, where: str = "the table"
) -> tuple[pd.DataFrame, dict[str, str], list[str]]:
    """Turn columns of text (n, k) that hold numbers into numbers.

    Args:
        frame: as pandas read it.
        decimal: "," or "." of the file, as far as its plain numbers say.
        where: name of the file, for messages.

    Returns:
        The table, name -> the unit that all its cells carry, and notes.

    Raises:
        InputError: a cell "12,512" among 10.25 and 11.5, which is either 12.512 or 12512.
    """
    units: dict[str, str] = {}
    texts = {str(name): frame[name].dropna().astype(str).str.strip() for name in frame.columns if _is_text(frame[name])}
    texts = {name: cells for name, cells in texts.items() if _holds_numbers(cells)}
    if not texts:
        return frame, units, []
    decimal = "," if decimal == "," or _commas_are_decimal(list(texts.values())) else "."
    frame, read = frame.copy(), []
    for name, cells in texts.items():
        found = cells.str.replace(_GROUP, "", regex=True).str.extract(_CELL)
        _refuse_doubtful(f"{where}: column {name}", found[0].dropna(), decimal)
        values = pd.to_numeric(_pointed(found[0], decimal), errors="coerce")
        behind = found[1].fillna("").unique()
        if values.isna().any() or len(behind) > 1 or not (behind[0] == "" or is_unit(behind[0])):
            continue
        if behind[0]:
            units[name] = behind[0]
        frame[name] = values.reindex(frame.index).astype("float64")
        read.append(name)
    if not read:
        return frame, units, []
    return frame, units, [f"numbers read from text with grouped thousands, decimal commas or units: {listed(read)}"]


def _is_text(column: pd.Series) -> bool:
    return bool(column.dtype == object or pd.api.types.is_string_dtype(column))


def _holds_numbers(cells: pd.Series) -> bool:
    sample = cells.head(SAMPLE)
    if sample.empty or is_stamp_text(sample.iloc[0]):
        return False
    return bool(np.mean([is_number(cell) for cell in sample]) >= NUMBERS)


def _commas_are_decimal(columns: Sequence[pd.Series]) -> bool:
    """Whether some cell has a comma that can't group thousands, and none has a point."""
    cells = pd.concat([column.head(SAMPLE) for column in columns]).str.extract(_CELL)[0].dropna()
    commas = cells[cells.str.contains(",", regex=False)]
    return not cells.str.contains(".", regex=False).any() and bool((~commas.str.match(groups(","))).any())


def _refuse_doubtful(column: str, cells: pd.Series, decimal: str) -> None:
    """Refuse a mark that may stand before three decimals among numbers whose writer didn't group thousands."""
    mark = "." if decimal == "," else ","
    doubtful = cells[cells.str.match(groups(mark)).fillna(False).astype(bool)]
    others = cells.drop(doubtful.index)
    if doubtful.empty or others.empty or writes_groups([*cells], mark, decimal):
        return
    row, cell = int(doubtful.index[0]), doubtful.iloc[0]
    raise either(f"{column}, data row {row + 1}", f"{cell} beside {others.iloc[0]}")


def _pointed(cells: pd.Series, decimal: str) -> pd.Series:
    """Numbers in text with a point before the decimals and nothing between thousands."""
    group = "." if decimal == "," else ","
    both = cells.str.contains(group, regex=False) & cells.str.contains(decimal, regex=False)
    grouped = both | cells.str.match(groups(group)).fillna(False)
    plain = cells.where(~grouped, cells.str.replace(group, "", regex=False))
    return plain.str.replace(",", ".", regex=False)
