"""Laws as they stand in documents ("W_leak = A p_im/sqrt(R_a T_im) Psi(p_amb/p_im)") typeset in MathML.

Every browser draws MathML without anything loaded; what can't be read as a formula is shown as the text that it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

from dieseltwin.symbols import BY_COLUMN, SYMBOLS, Symbol

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "eta": "η", "lambda": "λ", "omega": "ω", "tau": "τ",
    "rho": "ρ", "Phi": "Φ", "Pi": "Π", "Psi": "Ψ",
}  # fmt: skip
_UNITS = ("mg/cycle", "1/min", "rad/s", "kg/s", "N m s", "N m", "W/K", "m2", "Pa", "kPa", "K", "s", "W", "%", "1/s")
_UNIT_WORDS = {"m2": "m²", "1/s": "s⁻¹", "1/min": "min⁻¹"}
_NUMBER = r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
_QUANTITY = rf"{_NUMBER}(?:\s+±\s+{_NUMBER})?"
_TOKEN = re.compile(
    rf"\s*(?:(?P<quantity>{_QUANTITY})(?:\s*(?P<unit>{'|'.join(map(re.escape, _UNITS))})(?![\w^]))?"
    r"|(?P<name>[A-Za-z]\w*)|(?P<sign>[-+±*/^=<>|,()\[\]]))"
)
_PREFIX = re.compile(r"^(?P<words>relative change of|added to|reading of)\s+(?P<name>\w+):?\s*")
_NOTE = re.compile(r",\s+(?=[a-z]+ [a-z]+)|:\s+|\s+(?=(?:for|where)\s)")  # ", of the reading alone"
_SIGNS = {"-": "−", "*": "·", "<": "&lt;", ">": "&gt;"}
_WORD = 4  # letters from which the first part of a name is a word and no symbol
_CLOSING = {"(": ")", "[": "]", "|": "|"}
_FORMULA = re.compile(r"[=/^+*(|]|\d")


class _Unreadable(Exception):
    """The text is no formula of this grammar."""


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    unit: str = ""
    spaced: bool = False


def laws_markup(text: str) -> str:
    """Several laws, or a law and its numbers, between semicolons: each on a line of its own as HTML."""
    return "".join(f"<div>{law_markup(part)}</div>" for part in text.split("; "))


def law_markup(text: str) -> str:
    """A law as HTML: its formula in MathML, words around it as text."""
    text = text.replace("+-", "±")  # as older documents have it
    prefix = _PREFIX.match(text)
    words, rest = "", text
    if prefix is not None:
        words = f"{escape(prefix['words'])} {name_markup(prefix['name'])}: "
        rest = text[prefix.end() :]
    parts = _NOTE.split(rest, maxsplit=1)
    note = f'<p class="note">{escape(parts[1])}</p>' if len(parts) == 2 else ""
    try:
        if not _FORMULA.search(parts[0]):
            raise _Unreadable
        formula = _Reader(list(_tokens(parts[0]))).whole()
    except _Unreadable:
        return escape(text)
    return f'{words}<math display="block">{formula}</math>{note}'


def name_markup(name: str) -> str:
    """A symbol's name, or that of a column, in MathML within a line."""
    return f"<math>{_name(BY_COLUMN[name].name if name in BY_COLUMN else name)}</math>"


def symbols_in(text: str) -> list[Symbol]:
    """The quantities of the nomenclature that a law names, in its order."""
    names = dict.fromkeys(re.findall(r"[A-Za-z]\w*", text))
    return [SYMBOLS[name] for name in names if name in SYMBOLS]


def _tokens(text: str) -> Iterator[_Token]:
    at = 0
    while text[at:].strip():
        found = _TOKEN.match(text, at)
        if found is None:
            raise _Unreadable
        kind = found.lastgroup if found.lastgroup != "unit" else "quantity"
        start = found.start(kind or 0)
        yield _Token(kind or "", found[kind or 0], found["unit"] or "", start > at)
        at = found.end()


class _Reader:
    """Recursive descent: sums of products of factors; a quotient takes the factors beside its stroke."""

    def __init__(self, tokens: list[_Token]) -> None:
        self.tokens, self.at = tokens, 0

    def whole(self) -> str:
        text = self._sum()
        while self.at < len(self.tokens):
            token = self._next()
            if token.text not in ("=", "<", ">", ","):
                raise _Unreadable
            text += _operator(token.text) + self._sum()
        return f"<mrow>{text}</mrow>"

    def _peek(self) -> _Token | None:
        return self.tokens[self.at] if self.at < len(self.tokens) else None

    def _next(self) -> _Token:
        token = self._peek()
        if token is None:
            raise _Unreadable
        self.at += 1
        return token

    def _sees(self, *signs: str) -> bool:
        token = self._peek()
        return token is not None and token.kind == "sign" and token.text in signs

    def _sum(self) -> str:
        text = _operator(self._next().text) if self._sees("-", "+") else ""
        text += self._product()
        while self._sees("+", "-", "±"):
            text += _operator(self._next().text) + self._product()
        return text

    def _product(self) -> str:
        parts = [self._power()]
        while True:
            token = self._peek()
            if token is None or not self._continues(token):
                return "".join(parts)
            if self._sees("*"):
                self._next()
                parts.append(_operator("*") + self._power())
            elif self._sees("/"):
                self._next()
                parts[-1] = f"<mfrac><mrow>{_bare(parts[-1])}</mrow><mrow>{_bare(self._power())}</mrow></mfrac>"
            else:
                parts.append('<mspace width="0.17em"/>' + self._power())

    def _continues(self, token: _Token) -> bool:
        """Whether a product goes on: by a stroke, a bracket, a bar that opens, or anything that is no sign."""
        if token.kind != "sign" or token.text in "*/([":
            return True
        return token.text == "|" and sum(t.text == "|" for t in self.tokens[: self.at]) % 2 == 0

    def _power(self) -> str:
        base = self._factor()
        if not self._sees("^"):
            return base
        self._next()
        sign = _operator(self._next().text) if self._sees("-", "+") else ""
        return f"<msup><mrow>{base}</mrow><mrow>{sign}{self._factor()}</mrow></msup>"

    def _factor(self) -> str:
        token = self._next()
        if token.kind == "quantity":
            return _quantity(token)
        if token.kind == "name":
            following = self._peek()
            if following is not None and following.text in "([" and following.kind == "sign" and not following.spaced:
                return self._function(token.text)
            return _name(token.text)
        if token.text in _CLOSING:
            return self._group(token.text)
        raise _Unreadable

    def _function(self, name: str) -> str:
        inner = self._group(self._next().text)
        if name == "sqrt":
            return f"<msqrt>{_bare(inner)}</msqrt>"
        return f"{_name(name)}<mo>&#x2061;</mo>{inner}"

    def _group(self, opening: str) -> str:
        text = self._sum()
        while self._sees(",", "<", ">", "="):
            text += _operator(self._next().text) + self._sum()
        closing = self._next()
        if closing.text != _CLOSING[opening]:
            raise _Unreadable
        return f'<mrow><mo fence="true">{opening}</mo>{text}<mo fence="true">{closing.text}</mo></mrow>'


_FENCED = re.compile(r'^<mrow><mo fence="true">\(</mo>(?P<inner>.*)<mo fence="true">\)</mo></mrow>$')


def _bare(markup: str) -> str:
    """A part of a quotient or a root without the brackets that its stroke makes needless."""
    found = _FENCED.match(markup)
    return found["inner"] if found is not None and found["inner"].count("<mrow><mo fence") == found["inner"].count(
        '<mo fence="true">)</mo></mrow>') else markup  # fmt: skip


def _operator(sign: str) -> str:
    return f"<mo>{_SIGNS.get(sign, sign)}</mo>"


def _quantity(token: _Token) -> str:
    value, _, std = (part.strip() for part in token.text.partition("±"))
    text = _number(value)
    if std:
        text = f'<mo fence="true">(</mo>{text}<mo>±</mo>{_number(std)}<mo fence="true">)</mo>'
    unit = _UNIT_WORDS.get(token.unit, token.unit)
    return f"<mrow>{text}" + (f'<mspace width="0.2em"/><mtext>{escape(unit)}</mtext>' if unit else "") + "</mrow>"


def _number(text: str) -> str:
    mantissa, _, power = text.lower().partition("e")
    if not power:
        return f"<mn>{mantissa}</mn>"
    raised = f"<msup><mn>10</mn><mn>{str(int(power)).replace('-', '−')}</mn></msup>"
    return raised if mantissa == "1" else f"<mn>{mantissa}</mn><mo>·</mo>{raised}"


def _name(name: str) -> str:
    if re.match(r"^d(t$|u$|[A-Z])", name):
        return f'<mrow><mi mathvariant="normal">d</mi>{_name(name[1:])}</mrow>'
    head, _, tail = name.partition("_")
    head = _GREEK.get(head, head)
    if tail and len(head) >= _WORD:
        return f"<mtext>{escape(name)}</mtext>"
    letter = f"<mi>{escape(head)}</mi>" if len(head) == 1 else f'<mi mathvariant="normal">{escape(head)}</mi>'
    return f"<msub>{letter}<mtext>{escape(_GREEK.get(tail, tail).replace('_', ','))}</mtext></msub>" if tail else letter
