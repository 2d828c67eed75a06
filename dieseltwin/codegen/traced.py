"""Found laws as C: their own Python is run on symbols that write down what is done to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dieseltwin.codegen.transpile import number, spelled
from dieseltwin.engine.extended_terms import law_variables
from dieseltwin.engine.terms import LawTerm


@dataclass(frozen=True, eq=False)
class Traced:
    """A number that is known in C only: its expression, complete in itself."""

    text: str

    def _with(self, other: Traced | float, sign: str, swapped: bool = False) -> Traced:
        pair = (str(self), written(other))
        return Traced(f"({pair[1]} {sign} {pair[0]})" if swapped else f"({pair[0]} {sign} {pair[1]})")

    def __str__(self) -> str:
        return self.text

    def __add__(self, other: Traced | float) -> Traced:
        return self._with(other, "+")

    def __radd__(self, other: float) -> Traced:
        return self._with(other, "+", swapped=True)

    def __sub__(self, other: Traced | float) -> Traced:
        return self._with(other, "-")

    def __rsub__(self, other: float) -> Traced:
        return self._with(other, "-", swapped=True)

    def __mul__(self, other: Traced | float) -> Traced:
        return self._with(other, "*")

    def __rmul__(self, other: float) -> Traced:
        return self._with(other, "*", swapped=True)

    def __truediv__(self, other: Traced | float) -> Traced:
        return self._with(other, "/")

    def __rtruediv__(self, other: float) -> Traced:
        return self._with(other, "/", swapped=True)

    def __pow__(self, other: float) -> Traced:
        return Traced(f"pow({self}, {number(other)})")

    def __abs__(self) -> Traced:
        return Traced(f"fabs({self})")


@dataclass(frozen=True)
class TracedFields:
    """A struct that is known in C only: its fields are symbols."""

    text: str

    def __getattr__(self, name: str) -> Traced:
        return Traced(f"{self.text}.{spelled(name)}")


def written(value: Traced | float) -> str:
    """A symbol or a number as C writes it."""
    return str(value) if isinstance(value, Traced) else number(value)


def traced_power(base: Traced | float, exponent: Traced | float) -> Traced:
    """`array_namespace.positive_power`, which stands in C under its own name."""
    return Traced(f"positive_power({written(base)}, {written(exponent)})")


def traced_nozzle(Pi: Traced, gamma: float, choking: float) -> Traced | float:
    """`nozzle.nozzle_flow_factor`, which stands in C under its own name."""
    return Traced(f"nozzle_flow_factor({written(Pi)}, {number(gamma)}, {number(choking)})")


def law_text(law: LawTerm, states: tuple[str, ...]) -> str:
    """A law's signal in C, of quantities `q`, operating point `x` (its fields: states), constants `c` and time `t`."""
    named = {name: Traced(f"x.{name}") for name in states} | {"t": Traced("t")}
    variables = law_variables(TracedFields("q"), named, TracedFields("c"))  # type: ignore[arg-type]
    power: Callable[..., Traced] = traced_power
    return written(law.signal(variables, power, traced_nozzle))
