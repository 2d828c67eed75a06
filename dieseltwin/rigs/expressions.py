"""Formulae of a rig's file: arithmetic on names and a few functions, checked before anything is evaluated.

A file that others wrote must not run code: what is allowed is listed here, and everything else is refused.
"""

from __future__ import annotations

import ast
import keyword
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from dieseltwin.settings.names import unknown_name

LONGEST = 500  # characters of a formula

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "abs": np.abs, "exp": np.exp, "log": np.log, "tanh": np.tanh, "sin": np.sin, "cos": np.cos, "min": np.minimum,
    "max": np.maximum, "sign": np.sign, "root": lambda x: np.sqrt(np.maximum(x, 0.0)),
    "positive": lambda x: np.maximum(x, 0.0), "where_positive": lambda x: np.where(x > 0.0, 1.0, 0.0),
}  # fmt: skip
"""All are element-wise; `root` and `positive` take what is negative for zero."""

_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd, ast.Load)
_NODES = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Constant, *_OPERATORS)


def names_in(formula: str) -> tuple[str, ...]:
    """Names of a formula that are no functions.

    Raises:
        ValueError: it is no formula, or one with more than arithmetic and `FUNCTIONS`.
    """
    return tuple(dict.fromkeys(node.id for node in ast.walk(_checked(formula))
                               if isinstance(node, ast.Name) and node.id not in FUNCTIONS))  # fmt: skip


def usable(name: str) -> bool:
    """Whether something may have that name: a plain identifier that is no function and nothing of the language."""
    plain = name.isascii() and name.isidentifier() and not name.startswith("_")
    return plain and not keyword.iskeyword(name) and name not in FUNCTIONS


def moment(
    held: Mapping[str, str], quantities: Mapping[str, str], results: Sequence[str]
) -> Callable[..., tuple[Any, ...]]:
    """One function of all formulae: `f(x, u, p, s, e)` as `discovery.twins.simple.Model` takes it.

    Args:
        held: name -> which argument has it: "x" states, "u" inputs, "p" parameters, "e" effects.
        quantities: name -> formula, in this order; each is passed through `s`.
        results: formulae of what is returned.

    Raises:
        ValueError: a name or a formula that isn't allowed.
    """
    bad = [name for name in (*held, *quantities) if not usable(name)]
    if bad:
        raise ValueError(f"{bad[0]!r} can't be a name")
    lines = ["def moment(_x, _u, _p, _s, _e):"]
    lines += [f"    {name} = _{holder}.{name}" for name, holder in held.items()]
    lines += [f"    {name} = _s({name!r}, {ast.unparse(_checked(formula))})" for name, formula in quantities.items()]
    lines.append(f"    return ({', '.join(ast.unparse(_checked(formula)) for formula in results)},)")
    namespace: dict[str, Any] = {"__builtins__": {}, **FUNCTIONS}
    exec(compile("\n".join(lines), "rig", "exec"), namespace)  # every name and node was checked
    return cast(Callable[..., tuple[Any, ...]], namespace["moment"])


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
    return tree
