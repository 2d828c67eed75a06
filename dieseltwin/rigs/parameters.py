"""The file of a rig: its equations as formulae, what may be missing in it, its parameters, and what was found."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, field_validator, model_validator

from dieseltwin.atomic import write_text
from dieseltwin.discovery.laws.grammar import Factor, Form, Kind
from dieseltwin.discovery.laws.twin import Placed
from dieseltwin.rigs.expressions import names_in, usable
from dieseltwin.sealed import sealed_text
from dieseltwin.settings.names import close_names, listed
from dieseltwin.settings.strict import StrictModel, read_mapping, validate, where_told

KIND = "rig"


class State(StrictModel):
    """A state: size of a typical change, where an unmeasured one starts, the reading that is nearly it."""

    scale: PositiveFloat
    unit: str = "-"
    first: float = 0.0
    nearest: str | None = None


class RigParameter(StrictModel):
    """A free parameter: value, what is believed beforehand (one standard deviation), size of a typical change."""

    value: float
    prior_std: PositiveFloat
    unit: str = "-"
    scale: PositiveFloat
    std: NonNegativeFloat | None = Field(None, description="of the value, where a recording has told it")


class Quantity(StrictModel):
    """A named quantity; with a site it is a place where something may be missing."""

    formula: str
    unit: str = "-"
    site: str | None = None
    relative: bool = Field(True, description="what is missing multiplies it by (1 + x), else it adds in its unit")
    ports: tuple[str, ...] = Field((), description="variables that a law here may depend on")
    scale: PositiveFloat = Field(1.0, description="size of what may be missing [unit]; 1 for a relative one")


class RigEffect(StrictModel):
    """What may be missing, by name: the formulae use the name for its size, 0 where it is absent."""

    site: str
    law: str
    unit: str
    tolerance: PositiveFloat = Field(description="smallest size of interest")
    limits: tuple[float, float]
    sizes: tuple[float, ...] = Field((), description="where a fit begins that has no slope at zero")
    sensor: bool = False


class RigTerm(StrictModel):
    """An effect that was found; in every other recording than `found_in` it acts from the first row on: not at all if
    it was gone again."""

    effect: str
    magnitude: float
    std: NonNegativeFloat | None = None
    onset_s: float | None = Field(None, description="time stamp since when it acts in `found_in`; None: always")
    until_s: float | None = where_told(description="before when it acts there; None: to the end")
    grown_s: float | None = where_told(description="until when it grows evenly there, from nothing; None: at once")
    found_in: str = Field("", description="SHA-256 of the recording that it was found in")


class LawFactor(StrictModel):
    """A dimensionless factor of a law, see `discovery.laws.grammar.Factor`."""

    kind: Kind
    variables: tuple[str, ...]
    references: tuple[float, ...]
    shape: float = 1.0
    units: tuple[str, ...] = ()


class RigLaw(StrictModel):
    """A law that was found where no name fits: a coefficient times factors, inserted at a quantity. In every other
    recording than `found_in` it acts from the first row on."""

    at: str
    coefficient: float
    factors: tuple[LawFactor, ...] = ()
    text: str = ""
    onset_s: float | None = where_told(description="time stamp since when it acts in `found_in`; None: always")
    found_in: str = Field("", description="SHA-256 of the recording that it was found in")

    def placed_in(self, sha256: str) -> Placed:
        """As the searches have it, in a recording with that hash."""
        factors = tuple(Factor(f.kind, f.variables, f.references, f.shape, f.units) for f in self.factors)
        since_s = self.onset_s if self.found_in == sha256 else None
        return Placed(Form(self.at, factors, since_s=since_s), self.coefficient)


class RigParameters(StrictModel):
    """One machine."""

    kind: Literal["rig"] = "rig"
    name: str
    source: str = ""
    states: dict[str, State]
    inputs: dict[str, str] = Field(description="column -> unit")
    parameters: dict[str, RigParameter]
    quantities: dict[str, Quantity] = Field(description="evaluated in this order")
    rates: dict[str, str] = Field(description="formula of the derivative of every state")
    readings: dict[str, str] = Field(description="column -> formula of what the sensor shows")
    effects: dict[str, RigEffect] = Field(default_factory=dict)
    terms: tuple[RigTerm, ...] = ()
    laws: tuple[RigLaw, ...] = ()
    every: PositiveInt = Field(1, description="rows of a recording that one sample stands for: inputs are averaged")
    hold: Literal["held", "linear"] = Field("linear", description="inputs between samples")
    sub_steps: PositiveInt = Field(1, description="of the integration (Heun), per sample")
    window_s: PositiveFloat | None = Field(None, description="of a fit: states start anew in each; null: one run")
    run_s: PositiveFloat | None = Field(None, description="of a simulation and of what is judged; null: one run")
    first_rows: PositiveInt | None = Field(None, description="of a run, that its first states are fitted to; null: all")
    floors: dict[str, PositiveFloat] = Field(
        default_factory=dict, description="least noise of a reading: its resolution [unit]"
    )

    @field_validator("states", "parameters", "readings")
    @classmethod
    def _some(cls, given: dict[str, object]) -> dict[str, object]:
        if not given:
            raise ValueError("none; a rig needs one at least")
        return given

    @model_validator(mode="after")
    def _closed(self) -> RigParameters:
        """Every name in a formula is known, before it where it is a quantity; every state has a rate."""
        if set(self.rates) != set(self.states):
            raise ValueError(f"rates of {', '.join(self.rates)}, states {', '.join(self.states)}: one rate a state")
        known = [*self.states, *self.inputs, *self.parameters, *self.effects]
        every = [*known, *self.quantities]
        if twice := [name for name in dict.fromkeys(every) if every.count(name) > 1]:
            raise ValueError(f"{listed(twice)} stands for two things; every state, input, parameter, quantity and "
                             "effect has a name of its own")
        for name in (*known, *self.quantities):
            if not usable(name):
                raise ValueError(f"{name!r} can't be a name: letters, digits and _ after a letter, and no function's")
        earlier: list[str] = []
        for name, quantity in self.quantities.items():
            _check(name, _names(name, quantity.formula), known)
            _check(f"ports of {name}", quantity.ports, [*self.states, *self.inputs, *earlier])
            known.append(name)
            earlier.append(name)
        for name, formula in [*self.rates.items(), *self.readings.items()]:
            _check(name, _names(name, formula), known)
        named = [term.effect for term in self.terms]
        _check("term", named, self.effects)
        if twice := [name for name in dict.fromkeys(named) if named.count(name) > 1]:
            raise ValueError(f"terms: {listed(twice)} twice; each effect once: drop one of the two, or add them up")
        _check("law at", [law.at for law in self.laws], self.quantities)
        _check("floors", self.floors, self.readings)
        for name, state in self.states.items():
            _check(f"{name}: nearest", [] if state.nearest is None else [state.nearest], self.readings)
        return self

    @model_validator(mode="after")
    def _findable(self) -> RigParameters:
        """Every effect, parameter and place acts on what is simulated; an effect may be absent."""
        used = self._acting()
        for name in self.parameters:
            if name not in used:
                raise ValueError(f"parameter {name}: {_NOWHERE}, so that no recording could tell it; use it, or "
                                 "drop it")
        for name, quantity in self.quantities.items():
            if quantity.site is not None and name not in used:
                raise ValueError(f"quantity {name}: {_NOWHERE}, so that nothing could be missing there; use it, or "
                                 "drop its site")
        for name, effect in self.effects.items():
            if name not in used:
                raise ValueError(f"effect {name}: {_NOWHERE}, so that it could never be found")
            low, high = effect.limits
            if not low <= 0.0 <= high or low == high:
                raise ValueError(f"effect {name}: limits {low:g} to {high:g}; the lower first, and 0, absent, in them")
            if effect.tolerance > max(-low, high):
                raise ValueError(f"effect {name}: tolerance {effect.tolerance:g} beyond its limits, {low:g} to "
                                 f"{high:g}, so that it could never be found")
            column = effect.site.removeprefix("sensor:")
            if column != effect.site:
                _check(f"effect {name}: site sensor", [column], self.readings)
            if not all(low <= size <= high for size in effect.sizes):
                raise ValueError(f"effect {name}: sizes {listed([f'{s:g}' for s in effect.sizes])} beyond its limits")
        return self

    def _acting(self) -> set[str]:
        """Names that a rate or a reading depends on, through quantities or by itself."""
        used = {name for formula in (*self.rates.values(), *self.readings.values()) for name in names_in(formula)}
        for name in reversed(self.quantities):  # each holds earlier ones only
            if name in used:
                used |= set(names_in(self.quantities[name].formula))
        return used


_NOWHERE = "in no rate and no reading"


def _names(where: str, formula: str) -> tuple[str, ...]:
    try:
        return names_in(formula)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _check(where: str, names: Iterable[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"{where}: unknown name {name!r}; {close_names(name, known)}")


def is_rig(path: str | Path) -> bool:
    """Whether a file is of this kind (`kind: rig`)."""
    return read_mapping(path).get("kind") == KIND


def load_rig(path: str | Path) -> RigParameters:
    """Read a rig's file.

    Raises:
        InputError: not readable, an unknown key or name, a formula that is more than arithmetic.
    """
    return validate(RigParameters, read_mapping(path), str(path))


def save_rig(rig: RigParameters, path: str | Path) -> Path:
    """Write a rig's file atomically."""
    plain = rig.model_dump(mode="json", exclude_defaults=True)
    text = yaml.safe_dump({"kind": KIND, **plain}, sort_keys=False, allow_unicode=True, width=118)
    return write_text(path, sealed_text(text))
