"""The equations with their derivatives as straight-line text, from one run on symbols that write down what is done.

A symbol knows its value and its derivative in each direction, both as names in the text (forward mode). What is zero
in a direction is not written, and what was written once is named again. The text is over the primitives of the
compiled engine (`binding`), so that one formula serves simulator and derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dieseltwin.engine.array_namespace import with_ambient_pressure, with_charge
from dieseltwin.engine.binding import bind
from dieseltwin.engine.model_constants import CONSTANT_NAMES, Constants
from dieseltwin.engine.parameters import HEALTH
from dieseltwin.errors import DieselTwinError
from dieseltwin.sensors import READ

ARGUMENTS = ("p_im", "p_em", "omega_t", "x_r", "T_1", "n_e", "u_delta", "u_egr", "u_vgt")
"""Of `model.quantities`, before the constants."""
DIRECTIONS = ("p_im", "p_em", "omega_t", *HEALTH)
"""Derivatives are with respect to these states and the logarithms of these health values."""
FIXED_POINT = ("x_r", "T_1")
VALUES = ("dp_im", "dp_em", "domega_t", *READ)
"""What is differentiated: the rates of the states, then the readings that are not states."""


@dataclass
class Text:
    """Lines of a straight-line program; an expression that stands there already keeps its name."""

    lines: list[str] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)

    def name(self, expression: str) -> str:
        """The name under which an expression's value is known."""
        if expression not in self.names:
            self.names[expression] = f"v{len(self.names)}"
            self.lines.append(f"{self.names[expression]} = {expression}")
        return self.names[expression]


@dataclass(frozen=True, eq=False)
class Symbol:
    """A number that is known at run time only.

    Attributes:
        text: where lines are written.
        name: of its value.
        by: its derivatives by direction; a direction that is missing has none.
    """

    text: Text
    name: str
    by: Mapping[str, Symbol | float] = field(default_factory=dict)

    @property
    def plain(self) -> Symbol:
        """The value alone."""
        return Symbol(self.text, self.name)

    def __str__(self) -> str:
        return self.name

    def __add__(self, other: Symbol | float) -> Symbol:
        return self if _is(other, 0.0) else self._of(f"{self} + {_spelled(other)}", (self, 1.0), (other, 1.0))

    def __sub__(self, other: Symbol | float) -> Symbol:
        return self if _is(other, 0.0) else self._of(f"{self} - {_spelled(other)}", (self, 1.0), (other, -1.0))

    def __rsub__(self, other: float) -> Symbol:
        return self._of(f"{_spelled(other)} - {self}", (self, -1.0))

    def __neg__(self) -> Symbol:
        return self._of(f"-{self}", (self, -1.0))

    def __mul__(self, other: Symbol | float) -> Any:
        if _is(other, 1.0) or _is(other, 0.0):
            return self if other else 0.0
        return self._of(f"{self} * {_spelled(other)}", (self, _plain(other)), (other, self.plain))

    def __truediv__(self, other: Symbol | float) -> Symbol:
        if not self.by and not _directions(other):
            return self._of(f"{self} / {_spelled(other)}")
        inverse = 1.0 / _plain(other)
        value = self._of(f"{self} / {_spelled(other)}")
        return self._of(f"{self} / {_spelled(other)}", (self, inverse), (other, 0.0 - value * inverse))

    def __rtruediv__(self, other: float) -> Symbol:
        value = self._of(f"{_spelled(other)} / {self}")
        return value if not self.by else self._of(f"{_spelled(other)} / {self}", (self, 0.0 - value / self.plain))

    __radd__ = __add__
    __rmul__ = __mul__

    def __gt__(self, other: Symbol | float) -> str:  # type: ignore[override]
        return f"{self} > {_spelled(other)}"

    def _of(self, expression: str, *parts: tuple[Symbol | float, Symbol | float]) -> Symbol:
        """The value of an expression, whose derivative is a sum over (operand, partial derivative)."""
        by: dict[str, Symbol | float] = {}
        for operand, partial in parts:
            for direction, tangent in _directions(operand).items():
                term = tangent * partial
                by[direction] = by[direction] + term if direction in by else term
        return Symbol(self.text, self.text.name(expression), by)


def symbolic_primitives(text: Text) -> dict[str, Any]:
    """The primitives of `array_namespace` over symbols, with the derivatives that the torch ones have."""

    def written(expression: str, *parts: tuple[Symbol | float, Symbol | float]) -> Symbol:
        return Symbol(text, "")._of(expression, *parts)

    def exp(x: Symbol) -> Symbol:
        value = written(f"exp({x})")
        return written(f"exp({x})", (x, value))

    def root(x: Symbol) -> Symbol:
        value = written(f"root({x})")
        return written(f"root({x})", (x, where(f"{x} > 0.0", 0.5 / where(f"{x} > 0.0", value, 1.0), 0.0)))

    def positive_power(x: Symbol, exponent: Symbol | float) -> Symbol:
        if _directions(exponent):
            raise DieselTwinError(f"derivative with respect to the exponent {exponent}")
        value = written(f"positive_power({x}, {_spelled(exponent)})")
        slope = value * exponent / where(f"{x} > 0.0", x.plain, 1.0)
        return written(f"positive_power({x}, {_spelled(exponent)})", (x, slope))

    def where(condition: str, a: Symbol | float, b: Symbol | float) -> Symbol:
        chosen = {
            direction: where(condition, _directions(a).get(direction, 0.0), _directions(b).get(direction, 0.0))
            for direction in {**_directions(a), **_directions(b)}
        }
        return Symbol(text, text.name(f"where({condition}, {_spelled(a)}, {_spelled(b)})"), chosen)

    return {
        "exp": exp,
        "root": root,
        "positive_power": positive_power,
        "maximum": lambda a, b: where(f"{_spelled(a)} > {_spelled(b)}", a, b),
        "minimum": lambda a, b: where(f"{_spelled(a)} < {_spelled(b)}", a, b),
        "where": where,
        "with_ambient_pressure": with_ambient_pressure,
        "with_charge": with_charge,
    }


def point_text(function: str) -> str:
    """Text of a function of `ARGUMENTS` and the constants: `VALUES` and their total derivatives, one row a value.

    x_r and T_1 are taken for the fixed point of A.9 and A.10. Their derivatives follow from the implicit function
    theorem, (I - dg/d(x_r, T_1))^-1 dg/d(states, parameters), so that the derivatives returned are those of the
    equations with x_r and T_1 eliminated: (V,) values, then (V, 7) derivatives, as one tuple.
    """
    text = Text()

    def known(name: str, value: str) -> Symbol:
        if name in HEALTH:  # a health value moves by itself in the direction of its logarithm
            return Symbol(text, value, {name: Symbol(text, value)})
        return Symbol(text, value, {name: 1.0} if name in (*DIRECTIONS, *FIXED_POINT) else {})

    c = Constants(*(known(name, text.name(f"c.{name}")) for name in CONSTANT_NAMES))
    q = bind(symbolic_primitives(text)).quantities(*(known(name, name) for name in ARGUMENTS), c)
    rows = [getattr(q, name) for name in VALUES]
    inner = _eliminated(q.x_r_next, q.T_1_next)
    derivatives = [_total(row, inner, direction) for row in rows for direction in DIRECTIONS]
    lines = [f"def {function}({', '.join(ARGUMENTS)}, c):", *text.lines]
    return "\n    ".join([*lines, f"return {', '.join([_spelled(v) for v in (*rows, *derivatives)])}"]) + "\n"


def _eliminated(x_r_next: Symbol, T_1_next: Symbol) -> dict[str, tuple[Symbol | float, Symbol | float]]:
    """Direction -> derivatives of the fixed point's x_r and T_1."""
    (g_xx, g_xt), (g_tx, g_tt) = ([_directions(q).get(name, 0.0) for name in FIXED_POINT] for q in (x_r_next, T_1_next))
    a, d = 1.0 - g_xx, 1.0 - g_tt
    inverse = 1.0 / (a * d - g_xt * g_tx)
    found = {}
    for direction in DIRECTIONS:
        x, t = (_directions(q).get(direction, 0.0) for q in (x_r_next, T_1_next))
        if isinstance(x, Symbol) or isinstance(t, Symbol):
            found[direction] = ((d * x + g_xt * t) * inverse, (a * t + g_tx * x) * inverse)
    return found


def _total(row: Symbol | float, inner: Mapping[str, Sequence[Symbol | float]], direction: str) -> Symbol | float:
    """Total derivative of a quantity, x_r and T_1 eliminated."""
    result = _directions(row).get(direction, 0.0)
    for name, moved in zip(FIXED_POINT, inner.get(direction, ()), strict=False):
        if name in _directions(row):
            result = moved * _directions(row)[name] + result
    return result


def _directions(value: Symbol | float) -> Mapping[str, Symbol | float]:
    return value.by if isinstance(value, Symbol) else {}


def _plain(value: Symbol | float) -> Symbol | float:
    return value.plain if isinstance(value, Symbol) else value


def _is(value: Symbol | float, number: float) -> bool:
    return not isinstance(value, Symbol) and value == number


def _spelled(value: Symbol | float) -> str:
    return str(value) if isinstance(value, Symbol) else repr(float(value))
