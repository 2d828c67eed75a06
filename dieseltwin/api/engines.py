"""Engines by name, file or parameters; effects added to them."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from dieseltwin.engine import EngineParameters, load_engine, we2011
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.terms import Term
from dieseltwin.errors import InputError
from dieseltwin.petrol.parameters import PetrolParameters, is_petrol, load_petrol
from dieseltwin.settings.names import unknown_name
from dieseltwin.settings.strict import validate

Engine: TypeAlias = EngineParameters | PetrolParameters
"""Parameters of an engine of either kind."""

PUBLISHED = "we2011"
NAMED: Mapping[str, Engine] = {PUBLISHED: we2011.PARAMETERS, "liu_petrol": PetrolParameters()}
"""Engines that have a name: the published diesel engine, and a petrol engine that is still to be calibrated."""


def engine(source: Engine | str | Path = PUBLISHED, /, **changes: Any) -> Engine:
    """An engine, by name, from a file, or from parameters; named parameters changed.

    Args:
        source: a name of `NAMED`, a YAML file of parameters (what it leaves out is that of the published set), or
            parameters.
        changes: parameters by name [unit as in `dieseltwin engine show`], e.g. `V_d=0.0128`.

    Raises:
        InputError: an unknown name, a file that can't be used, a value out of range.
    """
    if isinstance(source, EngineParameters | PetrolParameters):
        found = source
    elif isinstance(source, str) and source in NAMED:
        found = NAMED[source]
    else:
        found = _read(source)
    if not changes:
        return found
    if isinstance(found, EngineParameters):
        return found.replace(**changes)
    return validate(PetrolParameters, {**found.model_dump(), **changes}, "engine")


def _read(path: str | Path) -> Engine:
    if isinstance(path, str) and not Path(path).suffix and not os.path.exists(path):
        raise unknown_name("engine", path, list(NAMED))
    return load_petrol(path) if is_petrol(path) else load_engine(path)


def diesel_engine(source: Engine | str | Path | None) -> EngineParameters:
    """A diesel engine as `engine` takes it; None is the published one.

    Raises:
        InputError: as `engine`, or a petrol engine.
    """
    found = NAMED[PUBLISHED] if source is None else engine(source)
    if isinstance(found, EngineParameters):
        return found
    raise InputError("engine", "a petrol engine", "a diesel engine", "use `discover` or `calibrate` with this one")


def with_effects(parameters: EngineParameters, effects: Mapping[str, float | str] | None) -> EngineParameters:
    """The engine with effects added to its terms; an effect that it has is replaced.

    Args:
        effects: name in `dieseltwin effects` -> magnitude [unit there], as a number or its text.

    Raises:
        InputError: an unknown name, a value that is no number or impossible.
    """
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
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        raise InputError(
            f"--effect {name}", repr(value), f"a number from {low:g} to {high:g} {effect.unit}", "correct the value"
        )
    return number
