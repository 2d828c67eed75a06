"""Forms of laws: a site's unit times at most three dimensionless groups of the variables that the site touches.

A form is a product of factors. Each factor is a dimensionless function of one to three variables with one shape
number (an exponent, a threshold, a centre, a time): powers, ratios, differences and their roots and squares, the
compressible orifice, friction's sign, overflow's excess, a bump over an argument of a map, and the operators lag, dead
time and play where a quantity is an actuator or a temperature. Variables enter over a rounded reference value, so that
coefficients carry the site's unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np

from dieseltwin.discovery.laws.shapes import lagged, orifice, played, signed_power
from dieseltwin.discovery.twins.interface import Array, Point

Kind = Literal[
    "power", "signed_power", "sign", "ratio", "share", "difference", "head", "orifice", "excess", "shortage",
    "one_way", "bump", "lag", "dead_time", "play", "time", "above_one",
]  # fmt: skip

_UNIT_OF_PREFIX = (
    ("omega", "rad/s"), ("eta", "-"), ("lambda", "-"), ("phi", "-"), ("Psi", "-"), ("Pi", "-"), ("n_", "1/min"),
    ("u_delta", "mg/cycle"), ("u_", "%"), ("p_", "Pa"), ("T_", "K"), ("W_", "kg/s"), ("P_", "W"), ("A_", "m2"),
    ("M_", "N m"), ("f_", "-"), ("x_", "-"),
)  # fmt: skip
_COMMANDS = ("%", "mg/cycle")  # units of what an actuator or an injector is told
_POWERS = (0.5, 1.0, 1.5, 2.0, 3.0, -0.5, -1.0)
_SIGNED_POWERS = (0.5, 1.0, 2.0)
_THRESHOLD_QUANTILES = (0.05, 0.15, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
_COMPARABLE = ("Pa", "K", "kg/s", "W", "m", "V", "N")  # units whose differences and ratios mean something
_TIMES = {"lag": (0.08, 0.4, 2.0), "dead_time": (0.05, 0.2)}  # s (docs/discovery.md)
_SLOW_LAGS = (10.0, 30.0)  # s, of temperatures besides: walls of metal
OPERATOR_AMPLITUDE = (0.2, 3.0)  # of what an operator changes as scored: its coefficient is 1, its size not known yet
_PLAYS = (1.0, 4.0, 10.0)  # % of full stroke
_BUMP_WIDTHS = (0.06, 0.1, 0.17)  # of the range driven: narrower than what a map's tolerance follows (a third)
AMBIENT = ("p_amb", "T_amb")
TIMES = ("t", "time_s")
_EXPONENT_SPREAD = 0.5  # of an exponent about its first value, one standard deviation
_SMOOTHED = 1e-3  # of the reference: width of the smoothed sign


@dataclass(frozen=True)
class Variable:
    """A variable along the trajectory.

    Attributes:
        name, unit: as the twin says.
        reference: rounded typical size [unit].
        signed: takes both signs.
        thresholds: values between which it moves; none for a constant.
    """

    name: str
    unit: str
    reference: float
    signed: bool
    thresholds: tuple[float, ...]


def unit_of(name: str, units: Mapping[str, str]) -> str:
    """Unit of a variable: as declared, else by the paper's way of naming."""
    if name in units:
        return units[name]
    return next((unit for prefix, unit in _UNIT_OF_PREFIX if name.startswith(prefix)), "-")


def rounded(value: float) -> float:
    """To one digit, a positive number."""
    if not np.isfinite(value) or value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(f"{np.maximum(np.round(value / power), 1.0) * power:.6g}")


def describe(name: str, values: Array, unit: str, recordings: Sequence[slice] = ()) -> Variable:
    """A variable's reference and range.

    What stands still within each of several recordings (their samples (n,); ambient, charge) is a constant: two
    functions of it give two recordings two sizes, by terms that cancel but for that and are huge on another day.
    """
    finite = values[np.isfinite(values)]
    size = float(np.median(np.abs(finite)))
    spread = float(np.std(finite))
    spans = [float(np.ptp(part)) for rows in recordings if (part := values[rows][np.isfinite(values[rows])]).size]
    if spread <= 1e-9 * max(size, 1e-300) or max(spans, default=np.inf) <= 1e-9 * max(size, 1e-300):
        return Variable(name, unit, rounded(size), False, ())
    low, high = np.quantile(finite, (0.01, 0.99))
    signed = bool(low < -0.02 * spread and high > 0.02 * spread and low * high < 0)
    thresholds = tuple(float(f"{q:.3g}") for q in np.unique(np.quantile(finite, _THRESHOLD_QUANTILES)))
    return Variable(name, unit, rounded(spread if signed else max(size, 1e-12)), signed, thresholds)


@dataclass(frozen=True)
class Factor:
    """One dimensionless group.

    Attributes:
        kind: its function.
        variables: names it depends on.
        references: of the variables [their units].
        shape: exponent, threshold [unit of the variable], time [s] or width.
        units: of the variables.
    """

    kind: Kind
    variables: tuple[str, ...] = ()
    references: tuple[float, ...] = ()
    shape: float = 1.0
    units: tuple[str, ...] = ()

    @property
    def operator(self) -> bool:
        """Needs the past, so it can't be evaluated at a moment."""
        return self.kind in ("lag", "dead_time", "play")

    @property
    def has_free_shape(self) -> bool:
        """The shape may be estimated."""
        free = ("power", "signed_power", "ratio", "difference", "excess", "shortage", "bump")
        return self.kind in free or self.operator

    @property
    def shape_spread(self) -> float:
        """What is believed of a free shape before the fit, one standard deviation about the first value [its unit]."""
        if self.kind == "bump":
            return 2.0 * self.references[0]
        return _EXPONENT_SPREAD if self.kind in ("power", "signed_power", "ratio") else 0.5 * abs(self.shape)

    @property
    def shape_step(self) -> float:
        """Size of a typical change of a free shape, for differences and step limits [its unit]."""
        return 0.3 * self.references[0] if self.kind == "bump" else 0.1 * abs(self.shape)

    def value(self, at: Mapping[str, Any], shape: Any = None) -> Any:
        """At the values of the variables, element-wise; operators need (n,) samples and `time_s`."""
        s = self.shape if shape is None else shape
        x = at[self.variables[0]]
        r = self.references[0]
        if self.kind == "power":
            return np.maximum(x / r, 1e-9) ** s
        if self.kind == "signed_power":
            return signed_power(x / r, s)
        if self.kind == "sign":
            return np.tanh(x / (_SMOOTHED * r))
        if self.kind == "time":
            return x / r
        if self.kind == "above_one":
            return signed_power(x - 1.0, s)
        if self.kind == "one_way":
            return 0.5 * (1.0 + np.tanh(s * x / (_SMOOTHED * r)))
        if self.kind == "bump":
            return np.exp(-0.5 * ((x - s) / r) ** 2)
        if self.kind == "excess":
            return np.maximum(x - s, 0.0) / r
        if self.kind == "shortage":
            return np.maximum(s - x, 0.0) / r
        if self.operator:  # replaces the quantity: a difference where signals are added (r = 1), a ratio else (r = 0)
            operated = self._operated(np.asarray(x), at["time_s"], float(s))
            return operated - x if r else operated / np.where(x == 0.0, 1.0, x) - 1.0
        y = at[self.variables[1]]
        if self.kind == "ratio":
            return np.maximum(x / y, 1e-9) ** s
        if self.kind == "share":
            return x / (x + y)
        if self.kind == "difference":
            return signed_power((x - y) / r, s)
        if self.kind == "head":
            return signed_power(x / y - 1.0, s)
        flow = x / r * orifice(x, y)
        if len(self.variables) == 3:
            flow = flow * np.sqrt(self.references[2] / at[self.variables[2]])
        return flow

    def _operated(self, x: Array, time_s: Array, shape: float) -> Array:
        if self.kind == "lag":
            return lagged(x, time_s, shape)
        if self.kind == "dead_time":
            return np.interp(time_s - shape, time_s, x)
        return played(x, shape)

    def operated(self, std: float | None = None) -> str:
        """What an operator makes of its variable, in words: "play[u_egr, 5.3 ± 0.1 %]"."""
        unit = self.units[0] if self.kind == "play" else "s"
        spread = "" if std is None else f" ± {std:.2g}"
        return f"{self.kind.replace('_', ' ')}[{self.variables[0]}, {self.shape:.3g}{spread} {unit}]"

    def text(self) -> str:
        """As printed in a law."""
        s, x = self.shape, self.variables[0]
        size = f"{self.references[0]:.3g} {self.units[0]}".replace(" -", "") if self.references else ""
        raised = "" if s == 1.0 else f"^{s:.3g}"
        if self.kind == "power":
            return f"({x}/{size}){raised}"
        if self.kind == "signed_power":
            return f"({x}/{size})" if s == 1.0 else f"sign({x}) |{x}/{size}|{raised}"
        if self.kind == "sign":
            return f"sign({x})"
        if self.kind == "time":
            return f"(t/{size})"
        if self.kind == "above_one":
            return f"({x} - 1){raised}"
        if self.kind == "one_way":
            return f"[{x} {'>' if s > 0 else '<'} 0]"
        if self.kind == "bump":
            return f"bump({x} about {s:.4g}, width {self.references[0]:.3g} {self.units[0]})".replace(" -)", ")")
        if self.kind in ("excess", "shortage"):
            inner = f"{x} - {s:.4g}" if self.kind == "excess" else f"{s:.4g} - {x}"
            return f"max(0, {inner} {self.units[0]})/({size})"
        if self.operator:
            change = f"({self.operated(s)} - {x})"
            return change if self.references[0] else f"{change}/{x}"
        y = self.variables[1]
        if self.kind == "ratio":
            return f"({y}/{x})" if s == -1.0 else f"({x}/{y}){raised}"
        if self.kind == "share":
            return f"{x}/({x} + {y})"
        if self.kind == "difference":
            inner = f"({x} - {y})/({size})"
            return inner if s == 1.0 else f"sign({x} - {y}) |{inner}|{raised}"
        if self.kind == "head":
            return f"({x}/{y} - 1){raised}"
        heat = f" sqrt({self.references[2]:.3g} K/{self.variables[2]})" if len(self.variables) == 3 else ""
        return f"({x}/{size}){heat} Psi({y}/{x})/Psi_choked"


@dataclass(frozen=True)
class Form:
    """A product of factors at one point, its coefficient in the point's unit; no factors: a constant.

    Attributes:
        point: name of the insertion point.
        factors: at most three.
        fixed: the coefficient that the form demands (operators replace the quantity), None if it is free.
        since_s: from when on it acts, in the time of the twin [s]; None: always.
    """

    point: str
    factors: tuple[Factor, ...] = ()
    fixed: float | None = None
    since_s: float | None = None

    @property
    def operator(self) -> bool:
        """Holds an operator with memory."""
        return any(factor.operator for factor in self.factors)

    @property
    def amount(self) -> bool:
        """A change of the quantity by the same amount always, at a point where changes are shares of it."""
        return self.fixed is None and [(f.kind, f.variables, f.references, f.shape) for f in self.factors] == [
            ("power", (self.point,), (1.0,), -1.0)
        ]

    @property
    def complexity(self) -> int:
        """Groups, and one more for each shape number that isn't 1."""
        return sum(1 + (f.kind in ("excess", "shortage") or f.shape not in (1.0, -1.0)) for f in self.factors)

    @property
    def key(self) -> tuple[Any, ...]:
        """Same for forms that differ in the order of factors alone."""
        return (self.point, tuple(sorted((f.kind, f.variables, f.shape) for f in self.factors)), self.since_s or 0.0)

    def with_shape(self, shape: float) -> Form:
        """The form with another shape of its first factor."""
        return replace(self, factors=(replace(self.factors[0], shape=shape), *self.factors[1:]))

    def value(self, at: Mapping[str, Any], shape: Any = None) -> Any:
        """Shape of the signal, coefficient 1; `shape` replaces the first factor's. A form with an onset needs
        `time_s`."""
        total: Any = 1.0 if self.since_s is None else np.where(np.asarray(at["time_s"]) >= self.since_s, 1.0, 0.0)
        for i, factor in enumerate(self.factors):
            total = total * factor.value(at, shape if i == 0 else None)
        return total

    def text(self) -> str:
        """Without the coefficient; empty for a constant."""
        return " ".join(factor.text() for factor in self.factors)


def operators(point: Point, unit: str) -> list[Factor]:
    """Lags, dead times and play of the quantity of a point itself: of actuators (%) and temperatures (K).

    They replace the quantity, so that their coefficient is 1 [unit] and their time or width is what is estimated.
    Of a quantity whose clock isn't known only its play shows.

    Args:
        point: of which the quantity is; unit: of the quantity itself, whatever a signal there is measured in.
    """
    out: list[Factor] = []
    one = ((point.name,), (0.0 if point.relative else 1.0,))
    if unit in (*_COMMANDS, "K") and point.timed:
        for kind, times in _TIMES.items():
            if kind == "lag" or unit in _COMMANDS:
                slow = _SLOW_LAGS if kind == "lag" and unit == "K" else ()
                out += [Factor(kind, *one, t, (unit,)) for t in (*times, *slow)]  # type: ignore[arg-type]
    if unit in _COMMANDS:
        out += [Factor("play", *one, w, (unit,)) for w in _PLAYS]
    return out


def factors(names: Iterable[str], variables: Mapping[str, Variable]) -> list[Factor]:
    """Every single factor of the given variables.

    Args:
        names: the ports of a point; nothing else may enter.
        variables: descriptions by name.
    """
    known = [variables[name] for name in dict.fromkeys(names) if name in variables]
    out: list[Factor] = []
    for v in known:
        one = ((v.name,), (v.reference,))
        if not v.thresholds:  # constant: enters in pairs only
            continue
        if v.name in TIMES:
            out.append(Factor("time", *one, 1.0, ("s",)))
            continue
        if v.signed:
            out.append(Factor("sign", *one, 1.0, (v.unit,)))
            out += [Factor("signed_power", *one, s, (v.unit,)) for s in _SIGNED_POWERS]
            out += [Factor("one_way", *one, s, (v.unit,)) for s in (1.0, -1.0)]
        else:
            out += [Factor("power", *one, s, (v.unit,)) for s in _POWERS]
        if v.name.startswith("Pi_"):
            out.append(Factor("above_one", *one, 1.0, (v.unit,)))
        out += [Factor("excess", *one, t, (v.unit,)) for t in v.thresholds[1:]]
        out += [Factor("shortage", *one, t, (v.unit,)) for t in v.thresholds[:-1]]
    for a, b in combinations(known, 2):
        if a.unit == b.unit and a.unit in _COMPARABLE and not (a.signed or b.signed):
            out += list(_of_pair(a, b, known))
    return out


def bumps(
    values: Mapping[str, Array], units: Mapping[str, str], widths: Sequence[float] = _BUMP_WIDTHS
) -> list[Factor]:
    """Bumps over each of some variables, centres a width apart over the range driven.

    Args:
        values: name -> (n,) along the trajectory.
        units: name -> unit.
        widths: standard deviations of the bumps, as shares of the range.
    """
    out: list[Factor] = []
    for name, along in values.items():
        low, high = np.nanquantile(along, (0.01, 0.99))
        span = float(high - low)
        if span <= 1e-6 * max(abs(float(high)), 1e-300):
            continue
        for share in widths:
            for centre in np.linspace(low, high, round(1.0 / share) + 1):
                shape, width = float(f"{centre:.4g}"), float(f"{share * span:.3g}")
                out.append(Factor("bump", (name,), (width,), shape, (unit_of(name, units),)))
    return out


def _of_pair(a: Variable, b: Variable, known: Sequence[Variable]) -> Iterator[Factor]:
    if not a.thresholds and not b.thresholds:
        return
    both, units = (a.name, b.name), (a.unit, b.unit)
    reference = rounded(0.5 * abs(a.reference - b.reference) or 0.3 * a.reference)
    for s in (0.5, 1.0, 2.0):
        yield Factor("difference", both, (reference, reference), s, units)
    both_move = bool(a.thresholds and b.thresholds)
    for s in (1.0, -1.0) if both_move or a.unit == "Pa" else ():  # over a constant a ratio is a power of the other
        yield Factor("ratio", both, (1.0, 1.0), s, units)
    for pair in (both, both[::-1]):
        yield Factor("head", pair, (1.0, 1.0), 1.0, units)
        if a.unit == "kg/s":
            yield Factor("share", pair, (1.0, 1.0), 1.0, units)
        if a.unit == "Pa":
            up = a if pair[0] == a.name else b
            yield Factor("orifice", pair, (up.reference, 1.0), 1.0, units)
            for t in (v for v in known if v.unit == "K" and v.thresholds):
                yield Factor("orifice", (*pair, t.name), (up.reference, 1.0, t.reference), 1.0, (*units, "K"))


def arguments(point: Point) -> tuple[str, ...]:
    """Variables that a law at a point may depend on: its ports, and ambient, to which everything can leak or lose."""
    return (*point.ports, *(name for name in AMBIENT if name not in point.ports))


def map_arguments(point: Point) -> tuple[str, ...]:
    """The arguments of the map at a point, in all the ways in which it may be thought of."""
    return tuple(dict.fromkeys((*point.tolerance_over, *point.tolerance_also)))
