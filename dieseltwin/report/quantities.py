"""How quantities are shown: symbols and words from `dieseltwin.symbols`, units that an engineer reads (kPa, mm²).

Computations stay in SI; the factors here are applied last, where a number meets an axis or a table.
"""

from __future__ import annotations

import math
import re
from html import escape

import numpy as np
from markupsafe import Markup
from markupsafe import escape as escape_markup
from numpy.typing import ArrayLike, NDArray

from dieseltwin.symbols import BY_COLUMN, SYMBOLS, Symbol

# SI unit of symbols.py -> (unit on paper, factor)
_SHOWN: dict[str, tuple[str, float]] = {
    "Pa": ("kPa", 1e-3),
    "m2": ("mm²", 1e6),
    "W": ("kW", 1e-3),
    "W/(m2 K)": ("W/(m² K)", 1.0),
    "-": ("–", 1.0),
}
EMPTY = "–"


def known(name: str) -> Symbol | None:
    """The nomenclature's entry of a symbol ("p_im") or column ("p_im_pa"), or None for a channel of another rig."""
    return SYMBOLS.get(name) or BY_COLUMN.get(name)


def unit(name: str) -> str:
    """The unit in which ``name`` is shown; an unknown name has none."""
    entry = known(name)
    if entry is None:
        return ""
    return _SHOWN.get(entry.unit, (entry.unit, 1.0))[0]


def factor(name: str) -> float:
    """Factor from SI to the shown unit."""
    entry = known(name)
    return 1.0 if entry is None else _SHOWN.get(entry.unit, (entry.unit, 1.0))[1]


def shown(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """``values`` [SI] in the unit in which ``name`` is shown, same shape."""
    return np.asarray(values, dtype=np.float64) * factor(name)


def symbol(name: str) -> str:
    """Symbol for figures, e.g. ``$p_{im}$``; an unknown name as it is."""
    entry = known(name)
    return name if entry is None else f"${entry.latex}$"


def axis_label(name: str) -> str:
    """Axis label with unit, e.g. ``$p_{im}$ [kPa]``; always with brackets, ``[–]`` where dimensionless."""
    return f"{symbol(name)} [{unit(name)}]" if unit(name) else symbol(name)


def words(name: str) -> str:
    """The meaning in a few words."""
    entry = known(name)
    return name if entry is None else entry.meaning


def html_symbol(name: str) -> str:
    """Symbol for HTML text, e.g. ``A<sub>egrmax</sub>``, from the name itself."""
    entry = known(name)
    text = entry.name if entry is not None else name
    greek = {"eta": "η", "omega": "ω", "Phi": "Φ", "lambda": "λ"}
    head, _, tail = text.partition("_")
    head = escape(greek.get(head, head))  # a foreign channel's name may be anything
    tail = re.sub(r"[^A-Za-z0-9_ ]", "", tail).replace("_", ",")
    return f"<i>{head}</i><sub>{tail}</sub>" if tail else f"<i>{head}</i>"


def label(name: str) -> Markup:
    """Symbol for HTML text; a name that the nomenclature doesn't know as it is."""
    return Markup(html_symbol(name)) if known(name) is not None else escape_markup(name)


def decimals_for(std: float) -> int:
    """Decimals that show ``std`` with two significant digits (none for 20 and more)."""
    if not math.isfinite(std) or std <= 0:
        return 3
    return max(0, 1 - math.floor(math.log10(std)))


def value_with_std(name: str, mean: float, std: float, *, with_unit: bool = True) -> str:
    """``mean ± std`` [SI in] in the shown unit, e.g. ``300.1 ± 0.7 mm²``; two significant digits of the std."""
    if not math.isfinite(mean):
        return EMPTY
    scale = factor(name)
    digits = decimals_for(std * scale)
    known_to = math.isfinite(std)
    text = f"{mean * scale:.{digits}f} ± {std * scale:.{digits}f}" if known_to else significant(mean * scale, 4)
    return before_unit(name, text) if with_unit else text


def before_unit(name: str, text: str) -> str:
    """A number's text with the shown unit of ``name`` behind it, if it has one."""
    return f"{text} {unit(name)}" if unit(name) not in ("", "–") else text


def significant(value: float, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits and no exponent in the range of everyday numbers."""
    if not math.isfinite(value):
        return EMPTY
    if value == 0:
        return "0"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}" if places <= 6 else f"{value:.{digits - 1}e}"


def percent(value: float, *, signed: bool = False) -> str:
    """A ratio as percent: two decimals below 10 %, one below 100 %, none above."""
    if not math.isfinite(value):
        return EMPTY
    size = 100 * abs(value)
    text = f"{size:.{2 if size < 10 else (1 if size < 100 else 0)}f}"
    sign = "" if float(text) == 0 else ("−" if value < 0 else ("+" if signed else ""))
    return f"{sign}{text} %"


def probability(value: float | None) -> str:
    """A probability [-] in per cent; never 0 or 100 %."""
    if value is None:
        return EMPTY
    if value > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if value < 0.001 else f"{100 * value:.1f} %"


_CODE = re.compile(r"`([^`]*)`")
_NAMES = re.compile(r"\b(" + "|".join(sorted(map(re.escape, SYMBOLS), key=len, reverse=True)) + r")\b")


def with_symbols(text: str) -> Markup:
    """HTML of a plain sentence: the nomenclature's names (``h_tot``) as symbols, what backticks enclose as code."""
    plain = _CODE.split(text)  # every second piece stood between backticks
    pieces = (f"<code>{escape(p)}</code>" if i % 2 else _symbols_in(escape(p)) for i, p in enumerate(plain))
    return Markup("".join(pieces))


def _symbols_in(html: str) -> str:
    return _NAMES.sub(lambda found: html_symbol(found.group(1)) if "_" in found.group(1) else found.group(1), html)
