"""A rig's formulae as people write them, without what isn't there."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator

from dieseltwin.rigs.expressions import names_in, without
from dieseltwin.rigs.parameters import RigParameters

_SUM, _PRODUCT, _POWER, _ATOM = range(4)
_SIGNS = {ast.Add: ("+", _SUM), ast.Sub: ("-", _SUM), ast.Mult: ("*", _PRODUCT), ast.Div: ("/", _PRODUCT),
          ast.Pow: ("^", _POWER)}  # fmt: skip


def equations(rig: RigParameters, effect: str) -> tuple[str, ...]:
    """Formulae of a rig that an effect enters, "q = k sqrt(h + h_0)"; effects that were not found are left out."""
    found = {term.effect for term in rig.terms}
    absent = frozenset(name for name in rig.effects if name not in found and name != effect)
    return tuple(f"{left} = {readable(formula, absent)}" for left, formula in _formulae(rig)
                 if effect in names_in(formula))  # fmt: skip


def _formulae(rig: RigParameters) -> Iterator[tuple[str, str]]:
    yield from ((name, quantity.formula) for name, quantity in rig.quantities.items())
    yield from ((f"d{name}/dt", formula) for name, formula in rig.rates.items())
    yield from rig.readings.items()


def readable(formula: str, absent: Collection[str] = ()) -> str:
    """A formula in the signs of documents' laws, with some of its names zero.

    Args:
        formula: of a rig's file.
        absent: names that are zero.
    """
    return _text(without(ast.parse(formula, mode="eval").body, absent))[0]


def _text(node: ast.expr) -> tuple[str, int]:
    """Text, and how tightly it holds together."""
    if isinstance(node, ast.BinOp):
        sign, rank = _SIGNS[type(node.op)]
        left = _bracketed(node.left, rank)
        right = _bracketed(node.right, rank if sign in "+*" else rank + 1)
        return (f"{left} {sign} {right}" if rank == _SUM else f"{left}{sign}{right}"), rank
    if isinstance(node, ast.UnaryOp):
        return f"{'-' if isinstance(node.op, ast.USub) else ''}{_bracketed(node.operand, _PRODUCT)}", _SUM
    if isinstance(node, ast.Call):
        return _called(ast.unparse(node.func), [_text(argument)[0] for argument in node.args]), _ATOM
    return ast.unparse(node), _ATOM


def _called(name: str, given: list[str]) -> str:
    if name == "abs" and "|" not in given[0]:
        return f"|{given[0]}|"
    if name in ("positive", "where_positive"):
        return f"max(0, {given[0]})" if name == "positive" else f"[{given[0]} > 0]"
    return f"{'sqrt' if name == 'root' else name}({', '.join(given)})"


def _bracketed(node: ast.expr, rank: int) -> str:
    text, own = _text(node)
    return text if own >= rank else f"({text})"
