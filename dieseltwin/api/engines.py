"""Engines by name, file or parameters; effects added to them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from dieseltwin.engine import EngineParameters, load_engine, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError, shortened
from dieseltwin.petrol.parameters import KIND as PETROL
from dieseltwin.petrol.parameters import PetrolParameters, is_petrol, load_petrol
from dieseltwin.rigs.parameters import KIND as RIG
from dieseltwin.rigs.parameters import RigParameters, load_rig
from dieseltwin.settings.names import listed, unknown_name
from dieseltwin.settings.strict import read_mapping, validate

Engine: TypeAlias = EngineParameters | PetrolParameters | RigParameters
"""Parameters of an engine of either kind, or of a machine that is none."""


class HasEngine(Protocol):
    """What `learn`, `calibrate` and `discover` give: an engine, and what is known of it."""

    @property
    def engine(self) -> Engine:
        """The engine."""


AnyEngine: TypeAlias = Engine | str | Path | HasEngine
"""An engine by its parameters, its name, its file, or what another function gave."""

PUBLISHED = "we2011"
NAMED: Mapping[str, EngineParameters | PetrolParameters] = {
    PUBLISHED: we2011.PARAMETERS, "liu_petrol": PetrolParameters(),
}  # fmt: skip
"""Engines that have a name: the published diesel engine, and a petrol engine that is still to be calibrated."""


def engine(source: AnyEngine = PUBLISHED, /, **changes: Any) -> Engine:
    """An engine, by name, from a file, or from parameters; named parameters changed.

    Args:
        source: a name of `NAMED`, a YAML file of parameters (what it leaves out is that of the published set),
            parameters, or what `learn`, `calibrate` or `discover` gave.
        changes: parameters by name [unit as in `dieseltwin engine show`], e.g. `V_d=0.0128`.

    Raises:
        InputError: an unknown name, a file that can't be used, a value out of range.
    """
    given = _parameters(source)
    if given is not None:
        found = given
    elif not isinstance(source, str | Path):
        raise InputError("engine", f"a {type(source).__name__}", f"{listed(list(NAMED))}, a file or parameters",
                         'change parameters by name: engine("we2011", V_d=0.0128)')  # fmt: skip
    elif str(source) in NAMED:
        found = NAMED[str(source)]
    else:
        found = _read(source)
    if not changes:
        return found
    if isinstance(found, EngineParameters):
        return found.replace(**changes)
    return validate(type(found), {**found.model_dump(), **changes}, "engine")


def _parameters(source: object) -> Engine | None:
    """Parameters as they are, or those of what another function gave; None where it is a name or a file."""
    found = getattr(source, "engine", source)
    return found if isinstance(found, Engine) else None


def _read(path: str | Path) -> Engine:
    if len(Path(path).parts) == 1 and not Path(path).suffix and not os.path.exists(path):
        raise unknown_name("engine", str(path), [*NAMED, "a file (.yaml)"])
    kind = read_mapping(path).get("kind")
    return load_petrol(path) if kind == PETROL else load_rig(path) if kind == RIG else load_engine(path)


def rig_of(source: AnyEngine | None) -> RigParameters | None:
    """The rig that is meant, None for an engine."""
    found = None if source is None else engine(source)
    return found if isinstance(found, RigParameters) else None


def petrol_base(source: AnyEngine) -> PetrolParameters | None:
    """The petrol engine that is meant, calibrated or not; None for any other machine."""
    given = _parameters(source)
    if given is not None:
        return given if isinstance(given, PetrolParameters) else None
    named = NAMED.get(str(source))
    if isinstance(named, PetrolParameters):
        return named
    if isinstance(source, str | Path) and os.path.isfile(source) and is_petrol(source):
        return validate(PetrolParameters, read_mapping(source), str(source))
    return None


def named(source: AnyEngine | None, parameters: PetrolParameters) -> str:
    """A petrol engine as the user named it: by its file, else by its own name."""
    return str(source) if isinstance(source, str | Path) else parameters.name


def diesel_engine(source: AnyEngine | None) -> EngineParameters:
    """A diesel engine as `engine` takes it; None is the published one.

    Raises:
        InputError: as `engine`, or a petrol engine.
    """
    found = NAMED[PUBLISHED] if source is None else engine(source)
    if isinstance(found, EngineParameters):
        return found
    kind = "a petrol engine" if isinstance(found, PetrolParameters) else f"{found.name}, no engine"
    raise InputError("engine", kind, "a diesel engine", "use `discover` or `simulate` with this one")


def with_effects(parameters: EngineParameters, effects: Mapping[str, float | str] | None) -> EngineParameters:
    """The engine with effects added to its terms; an effect that it has is replaced.

    Args:
        effects: name in `dieseltwin effects` -> magnitude [unit there], as a number or its text.

    Raises:
        InputError: an unknown name, a value that is no number or impossible.
    """
    if not isinstance(effects, Mapping | None):
        raise InputError("effects", f"a {type(effects).__name__}", "a mapping of names to sizes",
                         'write {"boost_leak": 3e-5}')  # fmt: skip
    terms = {name: Term(effect=name, magnitude=_magnitude(name, value)) for name, value in (effects or {}).items()}
    if not terms:
        return parameters
    kept = [term for term in parameters.terms if not (isinstance(term, Term) and term.effect in terms)]
    return parameters.replace(terms=[*kept, *terms.values()])


def _magnitude(name: str, value: float | str) -> float:
    if name not in EFFECTS:
        raise unknown_name("--effect", name, list(EFFECTS))
    effect = EFFECTS[name]
    low, high = effect.limits
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not low <= number <= high:
        raise InputError(
            f"--effect {name}", repr(value), f"a number from {low:g} to {high:g} {effect.unit}", "correct the value"
        )
    return number


def parameter_changes(engine: Engine) -> list[tuple[str, str, str, str]]:
    """Where an engine differs from the published diesel engine: name, its value, the published one, unit; all of them
    where it is of another kind."""
    here, there = engine.model_dump(mode="json"), NAMED[PUBLISHED].model_dump(mode="json")
    fields = type(engine).model_fields
    for values in (here, there):  # a learned engine's corrections are of maps, and their numbers say nothing by eye
        terms = values.get("terms") or []
        values["terms"] = [{"corrections": "of maps"} if "coefficients" in term else term for term in terms]
    return [(name, _in_words(value), _in_words(there.get(name)), fields[name].description or "")
            for name, value in here.items() if value != there.get(name)]


def _in_words(value: Any) -> str:
    """A value of an engine file on one line, long ones shortened."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return shortened(", ".join(map(_in_words, value)) or "none", 200)
    if isinstance(value, dict):
        return " ".join(f"{key} {_in_words(item)}" for key, item in value.items() if item is not None)
    return "none" if value is None else str(value)
