"""Terms of one engine: effects of the catalogue with their magnitudes, and laws that were found by search."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, field_validator, model_validator

from dieseltwin.engine.array_namespace import Array, positive_power
from dieseltwin.engine.effect import Entry, Operator
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.limited import Limited
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.nozzle import choking_quotient, nozzle_flow_factor
from dieseltwin.engine.quantities import ADDED_AT, POINTS
from dieseltwin.errors import InputError
from dieseltwin.sensors import SENSORS
from dieseltwin.settings.names import close_names

LAW_VARIABLES = (
    "p_im", "p_em", "omega_t", "n_e", "u_delta", "u_egr", "u_vgt", "p_amb", "T_amb", "T_im", "T_em", "T_e", "T_c",
    "T_1", "x_r", "p_es", "p_bc", "W_c", "W_t", "W_egr", "W_ei", "W_eo", "W_f", "Pi_c", "Pi_t", "Pi_egr", "Pi_e",
    "t",
)  # fmt: skip
"""What a law may depend on: pressures [Pa], omega_t [rad/s], n_e [rpm], u_delta [mg/cycle], actuated positions u_egr,
u_vgt [%], temperatures [K], flows [kg/s], pressure quotients [-] (Pi_egr = p_im/p_em, Pi_e = p_em/p_im), time since the
recording's start t [s]."""

Power = Callable[[Array, Array], Array]
"""`positive_power` of a backend."""

Nozzle = Callable[[Array, Array, Array], Array]
"""`nozzle_flow_factor` of a backend."""

ORIFICE_GAMMA = 1.4
"""Ratio of specific heats in an orifice's shape; its value moves the shape by less than 2 % (air, exhaust gas)."""
ORIFICE_CHOKING = choking_quotient(ORIFICE_GAMMA)


class Term(Limited):
    """An effect of the catalogue in one engine."""

    effect: str = Field(description="name in the catalogue (`dieseltwin effects`)")
    magnitude: float = Field(description="in the effect's unit")
    shape: dict[str, float] = Field({}, description="of its law beside the magnitude; nominal where not given")

    @field_validator("effect")
    @classmethod
    def _known_effect(cls, name: str) -> str:
        if name not in EFFECTS:
            raise ValueError(f"unknown effect {name!r}; {close_names(name, EFFECTS)}")
        return name

    @model_validator(mode="after")
    def _possible(self) -> Term:
        effect = EFFECTS[self.effect]
        low, high = effect.limits
        if not low <= self.magnitude <= high:  # not so for NaN either
            raise ValueError(f"{self.effect}: magnitude {self.magnitude:g} outside {low:g} to {high:g} {effect.unit}")
        for name, value in self.shape.items():
            if name not in effect.coefficients or not math.isfinite(value):
                near = close_names(name, effect.coefficients)
                raise ValueError(f"{self.effect}: coefficient {name} = {value:g}; {near}")
        return self

    @property
    def slot(self) -> str:
        """Where it acts: its own name."""
        return self.effect

    def factor(self, time_s: np.ndarray, start_s: float, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """As of every term, times what an input or the time makes of the magnitude; a drift's is that of a rate [s].

        Raises:
            InputError: the input isn't among the conditions.
        """
        factor, effect = super().factor(time_s, start_s, conditions), EFFECTS[self.effect]
        for column in effect.needs:
            if column not in conditions:
                raise InputError(f"inputs: column {column}", "none", f"this column: the engine has {self.effect}",
                                 "add it, or take the term out of the engine file")
        if effect.follows is not None:
            factor = factor * effect.follows(conditions, {**effect.coefficients, **self.shape})
        return factor * np.maximum(time_s - start_s, 0.0) if effect.drifts else factor

    @property
    def law(self) -> str:
        """The law in symbols."""
        return EFFECTS[self.effect].law

    @property
    def unit(self) -> str:
        """Unit of the magnitude."""
        return EFFECTS[self.effect].unit


SENSOR_UNITS = {sensor.column: sensor.symbol.unit for sensor in SENSORS}
"""Columns that a fault of a sensor can change, with their units."""

LARGEST_GAIN = 10.0  # of a sensor's reading [-]; beyond it the column is in another unit

_BY_ENTRY = {effect.enters: name for name, effect in EFFECTS.items() if effect.enters.through in ("reading", "command")}


def sensor_slot(sensor: str, fault: Operator) -> str:
    """Where a fault of a sensor acts: the catalogue's effect that does the same, else `<column>:<fault>`."""
    return _BY_ENTRY.get(Entry("reading", sensor, fault), f"{sensor}:{fault}")


SENSOR_SLOTS = tuple(
    dict.fromkeys(
        sensor_slot(sensor, fault)
        for fault in ("lag", "gain", "offset")
        for sensor in SENSOR_UNITS
    )
)
"""All slots of faults of sensors, in the order in which they act."""


class SensorTerm(Limited):
    """A found fault of a sensor, whether or not the catalogue has a name for it.

    reading (1 + magnitude) for a gain, reading + magnitude for an offset, a first-order lag of the reading (a sheathed
    thermocouple, a long or sooted line to a pressure sensor); the lag acts first, then gains, then offsets.
    """

    sensor: str = Field(description="column of the reading")
    fault: Literal["gain", "offset", "lag"] = Field(description="what is wrong with it")
    magnitude: float = Field(description="gain [-], offset [unit of the column], lag [s]")

    @model_validator(mode="after")
    def _possible(self) -> SensorTerm:
        if self.sensor not in SENSOR_UNITS:
            raise ValueError(f"unknown sensor {self.sensor!r}; {close_names(self.sensor, SENSOR_UNITS)}")
        if self.fault == "gain" and not -1.0 < self.magnitude <= LARGEST_GAIN:
            raise ValueError(f"gain {self.magnitude:g}; allowed: above -1 (no reading is left) to {LARGEST_GAIN:g}")
        if self.fault == "lag" and self.magnitude < 0.0:
            raise ValueError(f"a lag of {self.sensor} of {self.magnitude:g} s; allowed: 0 or more")
        return self

    @property
    def slot(self) -> str:
        """Where it acts."""
        return sensor_slot(self.sensor, self.fault)

    @property
    def law(self) -> str:
        """The law in symbols."""
        return {"gain": "reading (1 + g)", "offset": "reading + b", "lag": "tau dy/dt = true - y"}[self.fault]

    @property
    def unit(self) -> str:
        """Unit of the magnitude."""
        return {"gain": "-", "offset": SENSOR_UNITS[self.sensor], "lag": "s"}[self.fault]


class ActuatorTerm(Limited):
    """A found fault with a memory between command and actuator; offsets and gains are laws at `u_egr`, `u_vgt`."""

    actuator: Literal["egr", "vgt"] = Field(description="which")
    fault: Literal["dead_time", "backlash"] = Field(description="further dead time, or play")
    magnitude: float = Field(ge=0, description="dead time [s], full width of the play [%]")

    @model_validator(mode="after")
    def _possible(self) -> ActuatorTerm:
        _, high = EFFECTS[self.slot].limits
        if self.magnitude > high:
            raise ValueError(f"{self.fault}: magnitude {self.magnitude:g} outside 0 to {high:g} {self.unit}")
        return self

    @property
    def slot(self) -> str:
        """Where it acts."""
        return _BY_ENTRY[Entry("command", self.actuator, self.fault if self.fault == "dead_time" else "play")]

    @property
    def law(self) -> str:
        """The law in symbols."""
        return EFFECTS[self.slot].law

    @property
    def unit(self) -> str:
        """Unit of the magnitude."""
        return EFFECTS[self.slot].unit


class LawGroup(BaseModel):
    """A dimensionless group of a law that is no power: a difference, a share, a bump, or the shape of a nozzle's flow.

    `signed(z)` is sign(z) |z|**exponent. With x, y the variables: "difference" signed((x - y)/reference), "head"
    signed(x/y - 1), "above_one" signed(x - 1), "share" x/(x + y), "orifice" the flow from x to y over its choked value
    at the same upstream state, negative the other way, "bump" exp(-((x - centre)/reference)^2/2).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: Literal["difference", "head", "above_one", "share", "orifice", "bump"]
    variables: tuple[str, ...] = Field(description="x, or x and y")
    reference: float = Field(
        1.0, gt=0, allow_inf_nan=False, description="of a difference, or width of a bump [its unit]"
    )
    centre: float = Field(0.0, allow_inf_nan=False, description="of a bump [unit of the variable]")
    exponent: float = Field(1.0, gt=0, allow_inf_nan=False, description="of signed powers")

    @model_validator(mode="after")
    def _possible(self) -> LawGroup:
        if len(self.variables) != (1 if self.kind in ("above_one", "bump") else 2):
            raise ValueError(f"{self.kind} of {len(self.variables)} variables")
        for variable in self.variables:
            if variable not in LAW_VARIABLES:
                raise ValueError(f"unknown variable {variable!r}; {close_names(variable, LAW_VARIABLES)}")
        return self

    def value(
        self, variables: Mapping[str, Array], power: Power = positive_power, nozzle: Nozzle = nozzle_flow_factor
    ) -> Array:
        """At arrays or tensors by name; `power`, `nozzle` (`positive_power`, `nozzle_flow_factor`): their backend's."""
        x = variables[self.variables[0]]
        if self.kind == "above_one":
            return self._signed(x - 1.0, power)
        if self.kind == "bump":
            return power(math.e, -0.5 * ((x - self.centre) / self.reference) ** 2)
        y = variables[self.variables[1]]
        if self.kind == "difference":
            return self._signed((x - y) / self.reference, power)
        if self.kind == "head":
            return self._signed(x / y - 1.0, power)
        if self.kind == "share":
            return x / (x + y)
        gamma, choking = ORIFICE_GAMMA, ORIFICE_CHOKING
        choked = nozzle_flow_factor(choking, gamma, choking)
        return (nozzle(y / x, gamma, choking) - nozzle(x / y, gamma, choking)) / choked

    def _signed(self, z: Array, power: Power) -> Array:
        return z if self.exponent == 1.0 else z * power(abs(z) + 1e-12, self.exponent - 1.0)


class LawTerm(Limited):
    """A found law that isn't in the catalogue: coefficient times powers and groups of variables, at one point.

    Its signal is coefficient * prod((variable/reference)**exponent) * prod(groups); relative or added as the point is
    (`ADDED_AT`).
    """

    point: str = Field(description="insertion point")
    coefficient: float = Field(description="signal where every variable is at its reference")
    unit: str = Field(description="of the coefficient: '-' at a relative point, else the point's unit")
    factors: tuple[tuple[str, float, float], ...] = Field((), description="(variable, reference, exponent)")
    groups: tuple[LawGroup, ...] = Field((), description="differences, shares, nozzles")
    text: str = Field("", description="the law for people")

    @field_validator("point")
    @classmethod
    def _known_point(cls, name: str) -> str:
        if name not in POINTS:
            raise ValueError(f"unknown insertion point {name!r}; {close_names(name, POINTS)}")
        return name

    @model_validator(mode="after")
    def _possible(self) -> LawTerm:
        expected = ADDED_AT.get(self.point, "-")
        if self.unit != expected:
            raise ValueError(f"unit {self.unit!r} at point {self.point}; allowed {expected!r}")
        for variable, reference, exponent in self.factors:
            if variable not in LAW_VARIABLES:
                raise ValueError(f"unknown variable {variable!r}; {close_names(variable, LAW_VARIABLES)}")
            if not (reference > 0 and math.isfinite(reference) and math.isfinite(exponent)):
                raise ValueError(f"{variable}: reference must be positive, exponent finite")
        return self

    def signal(
        self, variables: Mapping[str, Array], power: Power = positive_power, nozzle: Nozzle = nozzle_flow_factor
    ) -> Array:
        """Value at arrays or tensors by name; `power` (0 where a valve overshoots), `nozzle`: of their backend."""
        value: Array = self.coefficient
        for variable, reference, exponent in self.factors:
            value = value * power(variables[variable] / reference, exponent)
        for group in self.groups:
            value = value * group.value(variables, power, nozzle)
        return value


class CorrectionTerm(BaseModel):
    """Learned corrections of all empirical maps: smooth relative functions of each map's own arguments."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    coefficients: tuple[float, ...] = Field(description="of the functions of `map_corrections.basis` [-]")

    @field_validator("coefficients")
    @classmethod
    def _one_each(cls, coefficients: tuple[float, ...]) -> tuple[float, ...]:
        wanted = len(basis().names)
        if len(coefficients) != wanted or not all(map(math.isfinite, coefficients)):
            raise ValueError(f"{len(coefficients)} coefficients; allowed: {wanted} finite numbers")
        return coefficients


# The name of an effect comes first: effects have coefficients too.
_MARKS = {
    "effect": "effect", "point": "law", "sensor": "sensor", "actuator": "actuator", "coefficients": "corrections",
}  # fmt: skip


def _kind_of_term(value: Any) -> str:
    for mark, kind in _MARKS.items():
        if mark in value if isinstance(value, dict) else hasattr(value, mark):
            return kind
    return "effect"


AnyTerm = Annotated[
    Annotated[Term, Tag("effect")] | Annotated[LawTerm, Tag("law")] | Annotated[SensorTerm, Tag("sensor")]
    | Annotated[ActuatorTerm, Tag("actuator")] | Annotated[CorrectionTerm, Tag("corrections")],
    Discriminator(_kind_of_term),
]  # fmt: skip
"""A term of any kind; in a file a law is what has a `point`, a fault of a sensor or actuator what has such a field."""

EffectTerm = Term | SensorTerm | ActuatorTerm
"""A term with a magnitude."""

OneTerm = EffectTerm | LawTerm | CorrectionTerm


def effect_terms(terms: Sequence[OneTerm]) -> tuple[EffectTerm, ...]:
    """Those with a magnitude: effects of the catalogue, and faults of sensors and actuators that act like them."""
    return tuple(term for term in terms if not isinstance(term, LawTerm | CorrectionTerm))


def corrections_in(terms: Sequence[OneTerm]) -> np.ndarray | None:
    """Coefficients (K,) of the maps' corrections among the terms, all of them added up; None without any."""
    found = [np.array(term.coefficients) for term in terms if isinstance(term, CorrectionTerm)]
    return np.sum(found, axis=0) if found else None


def without_corrections(terms: Sequence[OneTerm]) -> tuple[EffectTerm | LawTerm, ...]:
    """Effects and laws: all terms but corrections of the maps."""
    return tuple(term for term in terms if not isinstance(term, CorrectionTerm))


def with_corrections(terms: Sequence[OneTerm], coefficients: np.ndarray) -> tuple[OneTerm, ...]:
    """The terms with these corrections (K,) of the maps in the place of others [-]."""
    return (*without_corrections(terms), CorrectionTerm(coefficients=tuple(float(value) for value in coefficients)))


def as_later(terms: Sequence[OneTerm]) -> tuple[OneTerm, ...]:
    """The terms on a later recording, without those that went again."""
    later = (term if isinstance(term, CorrectionTerm) else term.later() for term in terms)
    return tuple(term for term in later if term is not None)


def law_terms(terms: Sequence[OneTerm]) -> tuple[LawTerm, ...]:
    """Those that are found laws."""
    return tuple(term for term in terms if isinstance(term, LawTerm))


def amounts(
    terms: Sequence[OneTerm], names: Sequence[str], time_s: np.ndarray, start_s: float,
    conditions: Mapping[str, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Magnitude in each slot at the samples, onset and region applied, (len(names), n) [its unit].

    Args:
        terms: of an engine; laws and terms in other slots are not looked at.
        names: of slots: effects of the catalogue, or `SENSOR_SLOTS`.
        time_s: sample times [s], (n,); start_s: the recording's start.
        conditions: the input columns of `INPUT_COLUMNS`, (n,) each.
    """
    out = np.zeros((len(names), time_s.size))
    for term in effect_terms(terms):
        if term.slot in names:
            out[list(names).index(term.slot)] += term.magnitude * term.factor(time_s, start_s, conditions)
    return out
