"""Which mark a text file writes before its decimals, and which one groups its thousands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from dieseltwin.errors import InputError

MARKS = (",", ".")
LEAST_PLAIN, MOST_PLAIN = 100.0, 999.0
"""Whole numbers between the two beside 1.013 in one column: the next one above may be 1,013."""

_GOES_ON = 10.0  # times the largest number without a mark, within which one with it goes on


def _clear(mark: str, other: str) -> re.Pattern[str]:
    """Numbers in which the mark can't group thousands: 0,5 and 1011,346 and 1.234,567, but not 1,013."""
    m, o = re.escape(mark), re.escape(other)
    return re.compile(rf"[+-]?(?:\d{{1,3}}(?:{o}\d{{3}})+{m}\d+|\d+{m}\d{{0,2}}|\d*{m}\d{{4,}}|{m}\d+"
                      rf"|(?:0\d*|\d{{4,}}){m}\d{{3}}|\d+{m}\d+[eE][+-]?\d+)(?:[eE][+-]?\d+)?$")  # fmt: skip


def groups(mark: str) -> re.Pattern[str]:
    """Whole numbers whose thousands the mark may group: 1,013 and 26,621, but not 0,013."""
    return re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:{re.escape(mark)}\d{{3}})+$")


_CLEAR = {",": _clear(",", "."), ".": _clear(".", ",")}
_GROUPS = {mark: groups(mark) for mark in MARKS}


def clear_mark(cells: Iterable[str]) -> str | None:
    """The mark that stands before decimals in most numbers that leave no doubt; None where there is none."""
    counts = dict.fromkeys(MARKS, 0)
    for cell in cells:
        for mark in MARKS:
            counts[mark] += mark in cell and bool(_CLEAR[mark].match(cell))
    if not any(counts.values()):
        return None
    return "," if counts[","] > counts["."] else "."


def doubtful_mark(where: str, names: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, list[str]]:
    """The mark of a file in which every number with one could have grouped thousands, and a note.

    A column in which 990 and 1.013 stand holds whole numbers, if zeros at the end are kept: who leaves out the
    decimals of 990 would have left out the last zero of 1.010 as well.

    Args:
        where: name of the file, for messages.
        names: of the columns.
        rows: cells of all rows of numbers.

    Raises:
        InputError: nothing tells decimals from thousands.
    """
    doubtful: dict[str, list[str]] = {}
    for column, name in enumerate(names):
        cells = [row[column].strip() for row in rows if column < len(row)]
        for mark in MARKS:
            marked = [cell for cell in cells if mark in cell and _GROUPS[mark].match(cell)]
            if not marked:
                continue
            if any(cell.count(mark) > 1 for cell in marked):
                return _other(mark), []
            plain = [float(cell) for cell in cells if re.fullmatch(r"[+-]?\d+", cell)]
            if any(abs(value) > MOST_PLAIN for value in plain) or not any(abs(v) >= LEAST_PLAIN for v in plain):
                doubtful.setdefault(mark, []).append(name)
            elif any(cell.endswith("0") for cell in marked):
                return _other(mark), []
            else:
                raise either(f"{where}: column {name}", f"{max(plain):.0f} and {marked[0]}")
    if len(doubtful) > 1:
        raise either(where, f"column {doubtful[','][0]} with commas and column {doubtful['.'][0]} with points")
    if not doubtful:
        return ".", []
    mark, columns = next(iter(doubtful.items()))
    shown = "commas" if mark == "," else "points"
    return mark, [f"the {shown} of {', '.join(columns)} are read as decimal ones, though they might group thousands: "
                  "check their values"]  # fmt: skip


def _other(mark: str) -> str:
    return "." if mark == "," else ","


def writes_groups(cells: Sequence[str], mark: str, decimal: str) -> bool:
    """Whether the numbers of a column leave no doubt that a mark groups its thousands: one has two of them or decimals
    behind (1,200.5), or all others are whole and end below a thousand, where the first mark comes (990 and 1,013, but
    not 180 and 181,549)."""
    marked = [cell for cell in cells if mark in cell]
    if any(cell.count(mark) > 1 or decimal in cell for cell in marked):
        return True
    plain = [cell for cell in cells if mark not in cell]
    if any(decimal in cell or not re.fullmatch(r"[+-]?\d+", cell) for cell in plain):
        return False
    largest = max(abs(float(cell)) for cell in plain)
    least = min(abs(float(cell.replace(mark, ""))) for cell in marked)
    return LEAST_PLAIN <= largest <= MOST_PLAIN and least <= _GOES_ON * largest


def either(where: str, got: str) -> InputError:
    """For a number that may have three decimals or thousands."""
    return InputError(where, f"{got}: decimals or thousands?", "numbers that tell them apart",
                      "export it without grouping of thousands")  # fmt: skip
