"""Where a table begins: rows of preamble, names, units, then numbers. Shared by text files and spreadsheets."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from dieseltwin.errors import InputError
from dieseltwin.recordings.time_units import in_s

LOOKED_AT = 200  # rows from the top: loggers write up to about a hundred lines before the names
NUMERIC_SHARE = 0.5  # of the filled cells of a row of data; comment columns and states are text
UNIT_SHARE = 0.5  # of the filled cells of a row of units

BLANKS = "\u00a0\u2009\u202f"  # that don't break a line: grouping of thousands by Excel and by French loggers
MONTHS = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec|mae?r|mrz|mai|okt|dez"
ZONES = {"UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3,
         "EST": -5, "EDT": -4, "CST": -6, "CDT": -5, "MST": -7, "MDT": -6, "PST": -8, "PDT": -7, "JST": 9}  # fmt: skip
"""Names of time zones in stamps, and their hours before UTC: Europe's and North America's, and Japan's."""

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")
_GROUPED = re.compile(rf"[+-]?\d{{1,3}}([.,'’{BLANKS} ]\d{{3}})+([.,]\d+)?$")
_ZONE = rf"( ?({'|'.join(ZONES)})([+-]\d{{1,2}}(:?\d{{2}})?)?| ?Z| ?[+-]\d{{2}}:?\d{{2}})"
_DATE = re.compile(
    r"(\d{4}[-/]\d{1,2}[-/]\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{2,4}"
    rf"|\d{{1,2}}[-. ]+({MONTHS})[a-z]*[-., ]+\d{{4}})"
    rf"([ T,]+\d{{1,2}}:\d{{2}}(:\d{{2}}([.,]\d+)?)?( ?[AP]M)?{_ZONE}?)?$"
    rf"|([a-z]{{3}} )?({MONTHS})[a-z]* \d{{1,2}},? (\d{{4}},? )?\d{{1,2}}:\d{{2}}:\d{{2}}([.,]\d+)?{_ZONE}?( \d{{4}})?$"
    rf"|\d{{1,2}}:\d{{2}}:\d{{2}}([.,:]\d+)?( ?[AP]M)?{_ZONE}?$"
    r"|\d{1,3}:\d{2}[.,]\d+$",  # minutes and seconds, as Excel shows them
    re.IGNORECASE,
)
_CLOCK_LIKE = re.compile(r"\d{1,2}:\d{2}(:|\b)|\d{4}-\d{2}-\d{2}T")
_MISSING_WORDS = """nan na n/a #n/a #n/v #nv null none nil - -- --- inf -inf +inf 1.#qnan -1.#ind 1.#inf #wert!
#value! #div/0! #ref! #bezug! invalid ungültig error err snv nodata ?"""
MISSING = frozenset(_MISSING_WORDS.split()) | {"", "no data"}
_UNIT_LIST = """s sec ms us µs min h 1/min min-1 rpm u/min 1/s hz rad/s krpm kpa pa hpa mbar bar psi mpa degc °c c k
degf °f grdc mg/hub mg/cyc mg/cycle mg/stroke mg/str mg/h mg/inj mm3 mm3/hub mm³ mm3/stroke kg/h kg/s g/s g/h l/h lph
l/min gph kg/min % pct percent prozent - [-] 1 nm n.m n*m n·m kw w ps hp v mv a km/h m/s mph ppm g/kwh g km m deg °ca
degca kelvin celsius state bool none enum mm mg ratio lambda -- count date time text string kg/hr lb/min lb/hr bar_a
bar_g kpa_a kpa_g kpaa kpag barg bara bar(a) bar(g) psia psig mg/asp m3/h m³/h nm3/h mg/r mg/rev
lb/s lbm/h lbm/hr lbm/min lbm/s lbs/h lbs/hr t/h mg/s g/min ml/min cc/min ml/s mmhg torr inhg kgf/cm2 kg/cm2 inh2o mmh2o
scfm cfm slpm ‰ permille mm^3/st mm3/st mg/st mm³/st mm³/hub mm^3/hub kpa(a) kpa(g) psi(a) psi(g) 1000/min"""
_UNIT_WORDS = frozenset(_UNIT_LIST.split())
# units that also end ordinary names (p_c, T_k, flow_min), so that they say nothing there
_AMBIGUOUS_LIST = "1 - c h k s a m g v w time date none state count text string min ratio lambda mm enum bool"
_AMBIGUOUS = frozenset(_AMBIGUOUS_LIST.split())


@dataclass(frozen=True)
class Layout:
    """Where names, units and numbers stand.

    Attributes:
        header: row of the names, from 0.
        first_data: first row of numbers.
        names: as they stand there, stripped.
        units: one for each name, "" where none; all "" without a row of units.
    """

    header: int
    first_data: int
    names: tuple[str, ...]
    units: tuple[str, ...]


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no reading."""
    return cell.strip().lower() in MISSING


def is_number(cell: str) -> bool:
    """Whether a cell is a number with a decimal point or comma, thousands grouped or not."""
    text = cell.strip()
    if _NUMBER.match(text) or _GROUPED.match(text):
        return True
    number, _, unit = text.replace("%", " %").rpartition(" ")  # "12.5 %", "1200 rpm"
    return bool(unit) and bool(_NUMBER.match(number.strip()) or _GROUPED.match(number.strip())) and is_unit(unit)


def is_date(cell: str) -> bool:
    """Whether a cell is a date, a time of day, or both."""
    return bool(_DATE.match(cell.strip()))


def is_stamp_text(cell: str) -> bool:
    """Whether a cell has the colons of a time of day, readable or not."""
    return bool(_CLOCK_LIKE.search(cell))


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit, in brackets or not."""
    text = cell.strip().lower()
    bare = text.strip("[]() ") if text[:1] in "[(" else text
    return bare in _UNIT_WORDS or (text[:1] == "[" and text[-1:] == "]")


def is_data_row(cells: Sequence[str]) -> bool:
    """Whether most filled cells of a row are numbers or date stamps."""
    filled = [cell for cell in cells if cell.strip()]
    good = sum(is_number(cell) or is_date(cell) for cell in filled)
    told = sum(not is_missing(cell) for cell in filled)
    return told > 0 and good >= NUMERIC_SHARE * told


def find_layout(rows: Sequence[Sequence[str]]) -> Layout | None:
    """The layout of a table, or None where no row of names stands above numbers.

    Args:
        rows: cells of the first rows of the file.
    """
    first = _first_data_row(rows)
    if first is None or first == 0:
        return None
    width = _width(rows[first])
    above = [row for row in range(first) if _is_heading(rows[row], width)]
    # headings stand in one block on top of the numbers; a gap ends the block
    block: list[int] = []
    for row in reversed(above):
        if block and block[-1] - row > 1 and any(cell.strip() for cell in rows[row + 1]):
            break
        block.append(row)
    if not block:
        return None
    header = max(block, key=lambda row: (_name_score(rows[row]), -row))
    names = [cell.strip().lstrip("#").strip() for cell in rows[header]]
    units = [""] * len(names)
    candidates = [row for row in block if row != header and unit_share(rows[row]) >= UNIT_SHARE]
    if candidates:
        best = max(candidates, key=lambda row: unit_share(rows[row]))
        cells = [cell.strip() for cell in rows[best]]
        units = [_bare(cells[i]) if i < len(cells) else "" for i in range(len(names))]
    while names and not names[-1] and not any(_cell(rows[row], len(names) - 1) for row in range(first, len(rows))):
        names.pop()  # a separator at the end of every line
        units.pop()
    return Layout(header, first, tuple(names), tuple(units))


def refuse_repeated(names: Sequence[str], where: str) -> None:
    """Each name of a table stands once.

    Raises:
        InputError: one doesn't.
    """
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{where} column {twice}", "a column given twice", "each name once", "drop one")


def _first_data_row(rows: Sequence[Sequence[str]]) -> int | None:
    """The first row of numbers after which the numbers go on."""
    for index, cells in enumerate(rows):
        if not is_data_row(cells) or _is_preamble(cells):
            continue
        again = rows[:index]  # a heading that comes once more
        following = [row for row in rows[index + 1 : index + 4]
                     if row not in again and sum(bool(cell.strip()) for cell in row) > 1]  # fmt: skip
        if all(is_data_row(row) for row in following):
            return index
    return None


def _is_preamble(cells: Sequence[str]) -> bool:
    """'Serial number;4711': a word and a number, no row of data."""
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) <= 2 and not (is_number(filled[0]) or is_date(filled[0]) or is_missing(filled[0]))


def _is_heading(cells: Sequence[str], width: int) -> bool:
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) >= max(1, width // 2) and not is_data_row(cells)


def _width(cells: Sequence[str]) -> int:
    return max((i + 1 for i, cell in enumerate(cells) if cell.strip()), default=0)


def _name_score(cells: Sequence[str]) -> float:
    """How many cells look like names: each once, and no units."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    return len({cell for cell in filled if not is_unit(cell) and not is_number(cell)}) + 0.1 * len(set(filled))


def unit_share(cells: Sequence[str]) -> float:
    """Share of the filled cells that are units [-]."""
    filled = [cell for cell in cells if cell.strip()]
    return sum(is_unit(cell) for cell in filled) / len(filled) if filled else 0.0


def _cell(cells: Sequence[str], index: int) -> str:
    return cells[index].strip() if index < len(cells) else ""


def _bare(unit: str) -> str:
    """A unit without brackets: '[1/min]' -> '1/min', '-' -> '-'."""
    text = unit.strip()
    return text[1:-1].strip() if text[:1] in "[(" and text[-1:] in "])" else text


_IN_NAME = re.compile(r"(?:\[\s*([^\[\]]{1,16}?)\s*\]|[\[(]\s*([^\[\]()]{1,16}?)\s*[\])])\s*$")  # [bar(g)], (bar)
_AFTER_NAME = re.compile(r"(?:[ _/,]|\bin\b)\s*([A-Za-z%°µ/0-9^³·*-]{1,10})\s*$")

_QUOTIENT = re.compile(r"[ _](kg|g|mg|lb|l|rad)_(s|sec|h|hr|min|hub|stroke|cycle|cyc)$", re.IGNORECASE)
_DEGREES = re.compile(r"[ _]([CKF])$")
_OF_HEAT = re.compile(r"(?i:t|\w*temp\w*)")


def unit_in_name(name: str) -> str | None:
    """The unit that a name carries: 'Drehzahl [1/min]', 'T_exh (degC)', 'p2 in mbar', 'boost_kPa', 'HFM_kg_h',
    'Umg_T_C' ('T_C' is a symbol); None without one."""
    found = _IN_NAME.search(name)
    if found:
        return (found.group(1) or found.group(2) or "").strip()
    found = _AFTER_NAME.search(name)
    if found and found.group(1).lower() in _UNIT_WORDS - _AMBIGUOUS:
        return found.group(1)
    found = _QUOTIENT.search(name)
    if found:
        return f"{found.group(1)}/{found.group(2)}"
    found = _DEGREES.search(name)
    return f"deg{found.group(1)}".replace("degK", "K") if found and _says_heat(name[: found.start()]) else None


def told_unit(name: str, unit: str | None) -> float | None:
    """Size [s] of a clock's unit, by what the file says besides or by its name ('Time [ms]', 't_min'); None without.

    Args:
        name: of a column of times: in another one, 'min' may be the smallest.
        unit: as the file gives it beside the name.
    """
    last = re.split(r"[\s_]+", name.strip())[-1]
    return next((size for text in (unit, unit_in_name(name), last) if (size := in_s(text)) is not None), None)


def without_unit(name: str) -> str:
    """A name without the unit behind it that `unit_in_name` reads: 'HFM_kg_h' -> 'HFM'."""
    found = _QUOTIENT.search(name) or _AFTER_NAME.search(name)
    return name[: found.start()] if found and unit_in_name(name) is not None else name


def _says_heat(before: str) -> bool:
    words = re.split(r"[ _]", before)
    return any(_OF_HEAT.fullmatch(word) and (len(words) > 1 or len(word) > 1) for word in words)
