"""What an effect is: one object that says where it enters, by which law, how large it may be and how it is told.

An effect stands in one file of `effects/`, as the module's `EFFECT`. The simulator's arguments, the candidates of
discovery, tables, curves and sentences are made from these objects (`effects.EFFECTS`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from inspect import signature
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dieseltwin.engine.array_namespace import Array
from dieseltwin.engine.model_constants import Constants
from dieseltwin.sensors import MEASURED

Kind = Literal["physics", "actuator", "input", "sensor"]
Through = Literal["quantity", "gas", "command", "input", "reading"]
Operator = Literal["", "gain", "offset", "lag", "play", "dead_time", "stuck"]
Law = Callable[..., Array]
_FUNCTIONS = ("change", "follows")

SITES = (
    "intake_mass_balance", "exhaust_mass_balance", "cylinder_flow", "compressor_flow", "compressor_power",
    "turbine_flow", "turbine_power", "shaft_power", "cylinder_out_temperature", "exhaust_temperature",
    "intake_temperature", "egr_flow", "egr_actuator", "vgt_actuator", "fuel_injection",
    *(f"sensor:{column}" for column in MEASURED),
)  # fmt: skip
"""Where the twin and the engine may differ."""


@dataclass(frozen=True)
class Entry:
    """Where an effect enters.

    Attributes:
        through: "quantity": a quantity of the model graph, changed by the law (a hook of `hooks`). "gas": the
            temperature in the exhaust manifold, which lags. "command": of an actuator, before its lags. "input": of the
            engine. "reading": of a sensor.
        name: of the quantity ("T_im"), actuator ("egr", "vgt"), input ("u_delta") or column ("p_im_pa").
        operator: what it does there; "" for a quantity, whose law says it.
    """

    through: Through
    name: str
    operator: Operator = ""


@dataclass(frozen=True)
class Curve:
    """How an effect is drawn.

    Attributes:
        over: its main argument, a variable or a quotient of two ("p_im/p_amb").
        unit: of the change that the law makes to its quantity; None: drawn as its magnitude.
        sign: of the drawn change: -1 for what is taken away.
    """

    over: str
    unit: str | None = None
    sign: float = 1.0

    def argument(self, variables: Mapping[str, Array]) -> Array:
        """The main argument from variables by name."""
        upper, _, lower = self.over.partition("/")
        return variables[upper] / variables[lower] if lower else variables[upper]


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: as in terms, tables and on the command line; also its module's name.
        site: one of `SITES`.
        enters: where.
        law: formula in words and symbols.
        symbol: of the magnitude; unit: of the magnitude ("-" where dimensionless).
        tolerance: smallest magnitude of interest [unit].
        limits: physically possible magnitudes [unit]; a lower limit of 0 is a one-sided effect.
        phrase: for people, with {m} where the magnitude goes.
        source: where the law comes from.
        change: the law as a function of the quantity, the magnitude and whatever further it depends on, by the names of
            `hooks` and of `Constants`, over the primitives of `array_namespace`; gives the changed quantity. None where
            the entry's operator is the law.
        sizes: magnitudes for first differences [unit]: one for a smooth effect (its tolerance), several where it isn't.
        smooth: the response is differentiable at 0.
        kind: "physics", "actuator", "input", or "sensor" (changes readings alone).
        confused_with: effects that look alike once the health parameters are fitted.
        drifts: the magnitude grows with the time since the recording's start: it is a rate [unit/s].
        curve: how it is drawn; None: not at all.
        plain: a dimensionless magnitude that is no share: told as it is, not in per cent.
        at_flow: flow at which a quadratic restriction is also told as a pressure [kg/s].
        needs: optional input columns without which the effect can't act.
        coefficients: of the law beside the magnitude, with nominal values; a term may give its own.
        about: what it is in a sentence; of a file, the first of its docstring.
        follows: factor (n,) of the magnitude that the inputs (column -> (n,)) make with these coefficients; None: 1.
    """

    name: str
    site: str
    enters: Entry
    law: str
    symbol: str
    unit: str
    tolerance: float
    limits: tuple[float, float]
    phrase: str
    source: str
    change: Law | None = None
    sizes: tuple[float, ...] = ()
    smooth: bool = True
    kind: Kind = "physics"
    confused_with: tuple[str, ...] = ()
    drifts: bool = False
    curve: Curve | None = None
    plain: bool = False
    at_flow: float | None = None
    needs: tuple[str, ...] = ()
    coefficients: Mapping[str, float] = field(default_factory=dict)
    about: str = ""
    follows: Callable[..., NDArray[np.float64]] | None = None

    def __post_init__(self) -> None:
        if not self.sizes:
            object.__setattr__(self, "sizes", (self.tolerance,))

    @property
    def varies(self) -> bool:
        """Whether its magnitude isn't the same all the time, by itself."""
        return self.drifts or self.follows is not None

    @property
    def arguments(self) -> tuple[str, ...]:
        """What the law depends on besides its quantity and the magnitude, by name."""
        return () if self.change is None else tuple(signature(self.change).parameters)[2:]

    def document(self) -> dict[str, Any]:
        """All attributes that are words and numbers, for JSON."""
        found = {part.name: getattr(self, part.name) for part in fields(self) if part.name not in _FUNCTIONS}
        found["enters"] = {part.name: getattr(self.enters, part.name) for part in fields(Entry)}
        if self.curve is not None:
            found["curve"] = {part.name: getattr(self.curve, part.name) for part in fields(Curve)}
        return found


def unchanged(name: str, c: Constants) -> Array:
    """What a quantity of `hooks` is in the published model, where that is a constant: the start of a drawn change."""
    return {"p_bc": c.p_amb, "p_es": c.p_amb, "T_im": c.T_im}.get(name, 0.0)
