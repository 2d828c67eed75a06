"""Formulae of a rig's file: arithmetic on names and a few functions, checked before anything is evaluated.

A file that others wrote must not run code: what is allowed is listed here, and everything else is refused.
"""

from __future__ import annotations

import ast
import keyword
import math
import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, cast

import numpy as np

from dieseltwin.settings.names import unknown_name

LONGEST = 500  # characters of a formula
_SHORT = 100  # characters of one that is said twice

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "abs": np.abs, "exp": np.exp, "log": np.log, "tanh": np.tanh, "sin": np.sin, "cos": np.cos, "min": np.minimum,
    "max": np.maximum, "sign": np.sign, "root": lambda x: np.sqrt(np.maximum(x, 0.0)),
    "positive": lambda x: np.maximum(x, 0.0), "where_positive": lambda x: np.where(x > 0.0, 1.0, 0.0),
}  # fmt: skip
"""All are element-wise; `root` and `positive` take what is negative for zero."""

_OF_TWO = ("min", "max")  # all others are of one value
_NUMERIC: Mapping[type[ast.operator], Callable[[float, float], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}  # fmt: skip

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd, ast.Load)
_NODES = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Constant, *_OPERATORS)


def names_in(formula: str) -> tuple[str, ...]:
    """Names of a formula that are no functions.

    Raises:
        ValueError: it is no formula, or one with more than arithmetic and `FUNCTIONS`.
    """
    return _names(_checked(formula))


def _names(tree: ast.AST) -> tuple[str, ...]:
    return tuple(dict.fromkeys(node.id for node in ast.walk(tree)
                               if isinstance(node, ast.Name) and node.id not in FUNCTIONS))  # fmt: skip


def usable(name: str) -> bool:
    """Whether something may have that name: a plain identifier that is no function and nothing of the language."""
    plain = name.isascii() and name.isidentifier() and not name.startswith("_")
    return plain and not keyword.iskeyword(name) and name not in FUNCTIONS


def moment(
    held: Mapping[str, str], quantities: Mapping[str, str], results: Sequence[str], absent: Collection[str] = (),
    noted: bool = True,
) -> Callable[..., tuple[Any, ...]]:  # fmt: skip
    """One function of all formulae: `f(x, u, p, s, e)` as `discovery.twins.simple.Model` takes it.

    Args:
        held: name -> which argument has it: "x" states, "u" inputs, "p" parameters, "e" effects.
        quantities: name -> formula, in this order; each is passed through `s`.
        results: formulae of what is returned.
        absent: names that are zero, so that what they multiply needn't be computed.
        noted: whether anybody asks for quantities that no result needs.

    Raises:
        ValueError: a name or a formula that isn't allowed.
    """
    bad = [name for name in (*held, *quantities) if not usable(name)]
    if bad:
        raise ValueError(f"{bad[0]!r} can't be a name")
    gone, kept = set(absent), {}
    for name, formula in quantities.items():
        kept[name] = without(_checked(formula).body, gone)
        if not noted and _number(kept[name], 0.0):
            gone.add(name)
    ends = [without(_checked(formula).body, gone) for formula in results]
    needed = {name for end in ends for name in _names(end)}
    for name, node in reversed(kept.items()):
        if noted or name in needed:
            needed |= {name, *_names(node)}
    lines = ["def moment(_x, _u, _p, _s, _e):"]
    lines += [f"    {name} = _{holder}.{name}" for name, holder in held.items() if name in needed]
    lines += [f"    {name} = _s({name!r}, {ast.unparse(node)})" for name, node in kept.items() if name in needed]
    lines.append(f"    return ({', '.join(ast.unparse(end) for end in ends)},)")
    namespace: dict[str, Any] = {"__builtins__": {}, **FUNCTIONS}
    exec(compile("\n".join(lines), "rig", "exec"), namespace)  # every name and node was checked
    return cast(Callable[..., tuple[Any, ...]], namespace["moment"])


def _number(node: ast.expr, value: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


def without(node: ast.expr, absent: Collection[str]) -> ast.expr:
    """A formula with names zero, and sums and products without what that makes needless."""
    zero = ast.Constant(0)
    if isinstance(node, ast.Name):
        return zero if node.id in absent else node
    if isinstance(node, ast.Call):
        return ast.Call(node.func, [without(argument, absent) for argument in node.args], [])
    if isinstance(node, ast.UnaryOp):
        inner = without(node.operand, absent)
        return zero if _number(inner, 0.0) else ast.UnaryOp(node.op, inner)
    if not isinstance(node, ast.BinOp):
        return node
    left, right = without(node.left, absent), without(node.right, absent)
    if isinstance(node.op, ast.Add | ast.Sub):
        if _number(right, 0.0):
            return left
        if _number(left, 0.0):
            return right if isinstance(node.op, ast.Add) else ast.UnaryOp(ast.USub(), right)
    if isinstance(node.op, ast.Mult):
        if _number(left, 0.0) or _number(right, 0.0):
            return zero
        if _number(left, 1.0) or _number(right, 1.0):
            return right if _number(left, 1.0) else left
    if isinstance(node.op, ast.Div) and (_number(left, 0.0) or _number(right, 1.0)):
        return left
    return ast.BinOp(left, node.op, right)


def _checked(formula: str) -> ast.Expression:
    if len(formula) > LONGEST:
        raise ValueError(f"a formula of {len(formula)} characters; at most {LONGEST}")
    try:
        tree = ast.parse(formula, mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"{formula!r} is no formula") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.BitXor):
            raise ValueError(f"a power is written **, not ^, in {formula!r}")
        if not isinstance(node, _NODES):
            raise ValueError(f"{type(node).__name__} is no arithmetic, in {formula!r}")
        if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
            raise ValueError(f"{formula!r}: {node.value!r} is no number")
        if isinstance(node, ast.Call) and (node.keywords or not isinstance(node.func, ast.Name)):
            raise ValueError(f"{formula!r}: only {', '.join(FUNCTIONS)} can be called")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id not in FUNCTIONS:
            raise ValueError(unknown_name(formula, node.func.id, list(FUNCTIONS)).line(200))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            asked, text = (2, "two values, nested for more") if node.func.id in _OF_TWO else (1, "one value")
            if len(node.args) != asked:  # NumPy would write its result into one more
                raise ValueError(f"{formula!r}: {node.func.id} takes {text}; got {len(node.args)}")
    _value(tree.body, formula)
    return tree


def _value(node: ast.expr, formula: str) -> float | None:
    """Value of a part without names and functions, None of any other.

    Raises:
        ValueError: it has none that a float can hold: as integers its powers could be computed for years.
    """
    if isinstance(node, ast.Call):
        for argument in node.args:
            _value(argument, formula)
        return None
    value: Any = None
    try:
        if isinstance(node, ast.Constant):
            value = float(cast(float, node.value))
        elif isinstance(node, ast.UnaryOp):
            inner = _value(node.operand, formula)
            value = inner if inner is None or isinstance(node.op, ast.UAdd) else -inner
        elif isinstance(node, ast.BinOp):
            left, right = _value(node.left, formula), _value(node.right, formula)
            if right == 0.0 and isinstance(node.op, ast.Div):
                raise ZeroDivisionError
            value = None if left is None or right is None else _NUMERIC[type(node.op)](left, right)
        if value is None or (isinstance(value, float) and math.isfinite(value)):
            return value
    except (OverflowError, ZeroDivisionError):
        pass
    part = ast.unparse(node) if len(formula) <= _SHORT else "a part"
    raise ValueError(f"{formula!r}: {part} has no value")
