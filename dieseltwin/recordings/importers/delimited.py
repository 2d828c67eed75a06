"""Text tables of any dialect: , ; tab | or blanks between, decimal comma, UTF-8/16 or Windows, units, preambles."""

from __future__ import annotations

import csv
import io
import itertools
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.errors import InputError
from dieseltwin.recordings.importers.clock import first_stamp, with_clock
from dieseltwin.recordings.importers.decimals import clear_mark, doubtful_mark
from dieseltwin.recordings.importers.layout import (
    LOOKED_AT,
    MISSING,
    UNIT_SHARE,
    Layout,
    find_layout,
    is_data_row,
    is_date,
    is_missing,
    is_number,
    refuse_repeated,
    unit_share,
)
from dieseltwin.recordings.importers.numeric_clocks import in_seconds
from dieseltwin.recordings.importers.signals import RawChannels, unreadable
from dieseltwin.recordings.importers.text_cells import in_numbers, without_repeated_names, without_statistics

SEPARATORS = (",", ";", "\t", "|")
ROWS_BEFORE, FEWEST_BEFORE = 50, 3  # the last one: they say how long a row is, if all have as many cells,
SHORTEST_OF = 15  # and so many at least how long its last cell is
_COMMENT = re.compile(r"^[ \t]*(#|//).*\n?", re.MULTILINE)
_MARK = re.compile(r"^[ \t]*(#|//)[ \t]*", re.MULTILINE)
MOST_COLUMNS = 20_000  # the largest control units have that many labels; a million take minutes to read


@dataclass(frozen=True)
class Dialect:
    """How a text file writes its table.

    Attributes:
        separator: between cells; r"\\s+" for blanks.
        decimal: "." or ","; None where the first lines don't say it.
        layout: rows of names, units and numbers, counted without blank lines.
    """

    separator: str
    decimal: str | None
    layout: Layout


def read_delimited(path: Path, content: bytes) -> RawChannels:
    """Read a text table.

    Raises:
        InputError: no table, no names, a name twice, or rows of different lengths.
    """
    text, encoding = _decoded(path, content)
    text, skipped = _without_marks(text)
    text, figures = without_statistics(text)
    skipped.extend(figures)
    lines = _first_lines(text)
    if not lines:
        raise InputError(str(path), "no rows", "a header and rows", "record again")
    widest = max(line.count(mark) + 1 for line in lines for mark in SEPARATORS)
    if widest > MOST_COLUMNS:
        raise InputError(str(path), f"{widest} columns", f"at most {MOST_COLUMNS}", "export the channels that you need")
    dialect = _dialect(path, lines)
    notes = [] if encoding.startswith("utf-8") else [f"read as {encoding}"]
    notes.extend(skipped)
    names = dialect.layout.names
    refuse_repeated(names, f"{path}:")  # pandas would rename the second one and say nothing
    text, cut = _without_cut_row(text, dialect)
    notes.extend(cut)
    text, dropped = _without_tail(text, dialect)
    if dropped:
        notes.append(f"{dropped} lines of text at the end left out")
    decimal, doubts = _decimal(path, text, dialect)
    frame = _numbers_of(path, text, dialect, decimal)
    if len(frame) == 0:
        raise InputError(str(path), "no rows", "a header and rows", "record again")
    units = {name: unit for name, unit in zip(names, dialect.layout.units, strict=True) if name and unit}
    frame, repeated = without_repeated_names(frame)
    frame, cell_units, cleaned = in_numbers(frame, decimal, str(path))
    if not names[0]:
        frame = with_clock(frame, _nameless(0))
    notes.extend((*repeated, *cleaned, *doubts))
    began = first_stamp(frame)
    frame, stamp_units, stamp_notes = in_seconds(frame, str(path))
    words = []
    if decimal == ",":
        words.append("decimal comma")
    if units:
        words.append("a row of units")
    if dialect.layout.header:
        words.append(f"names in row {dialect.layout.header + 1}")
    if words:
        notes.append("read with " + ", ".join(words))
    units = cell_units | units | stamp_units
    return RawChannels(path, "CSV", table=frame, units=units, notes=(*notes, *stamp_notes), began=began)


def _decoded(path: Path, content: bytes) -> tuple[str, str]:
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if content.startswith(mark):
            try:
                return content.decode(encoding), encoding
            except UnicodeDecodeError as error:
                raise unreadable(path, "CSV", error) from None
    head = content[:4096].rstrip(b"\0")
    if head.count(0) > 0.2 * len(head):
        return content.decode(
            "utf-16-le" if head[1::2].count(0) > head[0::2].count(0) else "utf-16-be", "replace"
        ), "utf-16"
    try:
        return content.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace"), "Windows-1252"


def _without_marks(text: str) -> tuple[str, list[str]]:
    """The text without Excel's 'sep=;' line, comment lines and zero bytes."""
    notes: list[str] = []
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    if "\0" in text:
        text = text.replace("\0", "")
        notes.append("zero bytes left out (the logger lost power?)")
    if re.match(r"\s*\"?sep=.\"?\n", text, re.IGNORECASE):
        text = text.split("\n", 1)[1]
    names = _names_in_comments(text[:100_000].split("\n"))
    before, found, behind = text.partition(names) if names else (text, "", "")
    comments = sum(len(_COMMENT.findall(part)) for part in (before, behind))
    if comments or names:
        text = _COMMENT.sub("", before) + _MARK.sub("", found) + _COMMENT.sub("", behind)
    if comments:
        notes.append(f"{comments} comment lines left out")
    return text, notes


def _names_in_comments(head: Sequence[str]) -> str | None:
    """'# time;n_e;...' right above the numbers is the row of names, with one of units below it or not; None where no
    comment is."""
    above: list[str] = []
    for line in filter(str.strip, head):
        if _COMMENT.match(line):
            above.append(line)
            continue
        for mark in SEPARATORS:
            fitting = [comment for comment in above[-2:] if comment.count(mark) == line.count(mark) > 0]
            if above and fitting and fitting[-1] is above[-1]:
                in_two = len(fitting) == 2 and unit_share(fitting[1].lstrip("#/ ").split(mark)) >= UNIT_SHARE
                return "\n".join(fitting if in_two else fitting[-1:])
        above = []
    return None


def _first_lines(text: str) -> list[str]:
    lines = []
    for line in io.StringIO(text):
        if line.strip():
            lines.append(line.rstrip("\n"))
        if len(lines) >= LOOKED_AT:
            break
    return lines


def _cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    if separator == r"\s+":
        return [line.split() for line in lines]
    return [list(row) for row in csv.reader(lines, delimiter=separator)]


def _dialect(path: Path, lines: Sequence[str]) -> Dialect:
    best: tuple[float, str, Layout, list[list[str]]] | None = None
    for separator in (*SEPARATORS, r"\s+"):
        try:
            rows = _cells(lines, separator)
        except csv.Error:
            continue
        layout = find_layout(rows)
        if layout is None or (
            separator == r"\s+" and any(len(row) != len(layout.names) for row in rows[layout.first_data :])
        ):
            continue
        data = [row for row in rows[layout.first_data :] if is_data_row(row)]
        width = sum(1 for name in layout.names if name)
        told = [cell for row in data for cell in row if not is_missing(cell)]
        share = sum(is_number(cell) for cell in told) / max(len(told), 1)
        ragged = sum(len(row) != len(data[0]) for row in data) / max(len(data), 1)
        score = min(width, 50) * (share - ragged) - (0.5 if separator == r"\s+" else 0.0)
        if width >= 2 and (best is None or score > best[0]):
            best = (score, separator, layout, rows)
    if best is None:
        raise _no_table(path, lines)
    _, separator, layout, rows = best
    return Dialect(separator, clear_mark(cell.strip() for row in rows[layout.first_data :] for cell in row), layout)


def _decimal(path: Path, text: str, dialect: Dialect) -> tuple[str, list[str]]:
    """What stands before decimals, by all rows where the first ones don't say it, and notes."""
    if dialect.decimal is not None:
        return dialect.decimal, []
    if "." not in text and (dialect.separator == "," or "," not in text):
        return ".", []
    lines = [line for line in text.split("\n") if line.strip()][dialect.layout.first_data :]
    rows = _cells(lines, dialect.separator)
    mark = clear_mark(cell.strip() for row in rows for cell in row)
    return (mark, []) if mark is not None else doubtful_mark(str(path), dialect.layout.names, rows)


def _no_table(path: Path, lines: Sequence[str]) -> InputError:
    for separator in SEPARATORS:
        try:
            rows = _cells(lines, separator)
        except csv.Error as error:  # one cell of more than 128 KiB
            raise unreadable(path, "CSV", error, "is this a table?") from None
        if len(rows[0]) >= 2 and is_data_row(rows[0]):
            return InputError(
                str(path), "numbers in the first row", "names in the first row", "put the column names in the first row"
            )
        if len(rows) == 1 and len(rows[0]) >= 2:
            return InputError(str(path), "no rows", "a header and rows", "record again")
    for names, numbers in itertools.permutations(SEPARATORS, 2):
        if lines[0].count(names) > 1 and all(line.count(numbers) == lines[0].count(names) for line in lines[1:]):
            return InputError(str(path), f"names with {names!r} between them above numbers with {numbers!r}",
                              "the same separator in all rows", "mend the row of names")  # fmt: skip
    return InputError(
        str(path),
        "no readable CSV (no row of names above rows of numbers)",
        "a table of two columns or more",
        "export it again as CSV",
    )


def _numbers_of(path: Path, text: str, dialect: Dialect, decimal: str) -> pd.DataFrame:
    layout = dialect.layout
    names = [name or _nameless(i) for i, name in enumerate(layout.names)]
    missing = sorted({spelling for word in MISSING for spelling in (word, word.upper(), word.capitalize())})
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # more cells than names: pandas would drop them
            frame = pd.read_csv(
                io.BytesIO(text.encode()), sep=dialect.separator, header=None, names=names, index_col=False,
                skiprows=_text_row(text, layout.first_data), decimal=_of_cells(dialect, decimal),
                float_precision="round_trip", na_values=missing, skipinitialspace=True, low_memory=False,
            )  # fmt: skip
    except pd.errors.ParserWarning:
        raise InputError(f"{path}: first row of numbers", f"more than {len(names)} cells",
                         f"{len(names)}, as in the row of names", "mend the row of names, or separate the columns by "
                         "semicolons if the numbers have decimal commas") from None  # fmt: skip
    except (ValueError, pd.errors.ParserError) as error:
        raise unreadable(path, "CSV", error) from None
    for name in [name for name, given in zip(names, layout.names, strict=True) if not given]:
        frame = frame.drop(columns=name) if frame[name].isna().all() or _is_count(frame[name]) else frame
    return frame


def _nameless(index: int) -> str:
    """What a column without a name is called."""
    return f"column {index + 1}"


def _of_cells(dialect: Dialect, decimal: str) -> str:
    """The decimal mark for the plain reader: commas in quotes between commas are read from text (`text_cells`)."""
    return "." if dialect.separator == "," else decimal


def _is_count(column: pd.Series) -> bool:
    """A column without a name that counts the rows: somebody's index."""
    values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64)
    return bool(len(values) > 1 and np.all(np.diff(values) == 1.0))


def _text_row(text: str, filled_rows: int) -> int:
    """Line number of the text at which `filled_rows` lines that are not blank have passed."""
    seen = 0
    for number, line in enumerate(io.StringIO(text)):
        if line.strip():
            if seen == filled_rows:
                return number
            seen += 1
    return 0


def _without_cut_row(text: str, dialect: Dialect) -> tuple[str, list[str]]:
    """The text without a last row that was cut off while it was written, and a note.

    Such a row has no line end, and fewer cells than those before it or a last cell that is shorter than all of theirs:
    its last number may be the beginning of another one. A short row with a line end stays, without what it lacks.
    """
    rest, *lines = text.rstrip("\n").rsplit("\n", ROWS_BEFORE + 1)
    if len(lines) <= ROWS_BEFORE:  # the whole file is that short
        lines = [line for line in [rest, *lines] if line.strip()][dialect.layout.first_data :]
    if len(lines) <= FEWEST_BEFORE or not _like_row(lines[-2], lines[-1], dialect):
        return text, []
    *before, last = (_cell_count(line, dialect.separator) for line in lines)
    usual = before[-1]
    if last > usual or any(count != usual for count in before):
        return text, []
    ends = text.endswith("\n")
    if last < usual and ends:
        return text, [f"the last row has only {last} of {usual} cells: the others count as missing"]
    if ends or (last == usual and not _shorter_than_all(lines, dialect.separator)):
        return text, []
    note = f"the last row ends in cell {last} of {usual}, without a line end, and is left out: the file seems cut off"
    return text[: len(text) - len(lines[-1])], [note]


def _shorter_than_all(lines: Sequence[str], separator: str) -> bool:
    """Whether the last line's last cell is shorter than that of every line before it; not told by a few lines."""
    if len(lines) <= SHORTEST_OF:
        return False
    *before, last = (len(line.rsplit(None if separator == r"\s+" else separator, 1)[-1].strip()) for line in lines)
    return last < min(before)


def _cell_count(line: str, separator: str) -> int:
    if separator == r"\s+":
        return len(line.split())
    return line.count(separator) + 1 if '"' not in line else len(_cells([line], separator)[0])


def _like_row(whole: str, line: str, dialect: Dialect) -> bool:
    """Whether a line begins as a row of numbers does: words below the table are no row."""
    firsts = [next((cell.strip() for cell in _cells([row], dialect.separator)[0] if cell.strip()), "")
              for row in (whole, line)]  # fmt: skip
    of_numbers, begun = (is_number(cell) or is_date(cell) for cell in firsts)
    return begun or not of_numbers


def _without_tail(text: str, dialect: Dialect) -> tuple[str, int]:
    """The text without lines of words at its end ('End of measurement'), and how many there were."""
    dropped = 0
    text = text.rstrip()
    while "\n" in text:
        rest, _, last = text.rpartition("\n")
        filled = [cell for cell in _cells([last], dialect.separator)[0] if cell.strip()]
        if len(filled) != 1 or is_number(filled[0]) or is_date(filled[0]):
            break
        text, dropped = rest.rstrip(), dropped + 1
    return text + "\n", dropped
