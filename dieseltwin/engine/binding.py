"""Bind the equations to a backend: numpy, torch or numba.

An equation is written once, over the primitives of `array_namespace`, and calls other equations by their global
names. `bind` copies the functions with another globals dictionary, in which the primitives (and, if wished, single
equations) are replaced. A namespace argument would do the same for numpy and torch, but numba can't compile
functions that are passed around in an object; globals are what it understands.

The composition (`model`) is bound twice: with the laws of the effects in its hooks, and without them, as the published
model.
"""

from __future__ import annotations

import inspect
import math
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal, get_type_hints

from dieseltwin.engine import (
    actuators,
    array_namespace,
    cylinder,
    effects,
    egr,
    hooks,
    manifolds,
    model,
    model_constants,
    nozzle,
    parameters,
    quantities,
    turbocharger,
    unrestricted,
    without_effects,
)
from dieseltwin.engine.effect import Effect
from dieseltwin.errors import DieselTwinError

LEAVES = (manifolds, cylinder, egr, turbocharger, actuators, nozzle)
MAPS = ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c")
"""The six empirical maps that a learned surrogate may replace (paper, table of surrogates)."""

COMPILED: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}
"""Options of a compiled equation: without forced inlining the 80 constants travel through memory at every call."""

Backend = Literal["numpy", "torch", "numba"]
Function = Callable[..., Any]
Scope = dict[str, Any]


class Model(types.SimpleNamespace):
    """The bound equations as attributes, by the names of their functions; `constants` makes their last argument."""

    constants: Callable[..., Any]
    quantities: Callable[..., Any]
    quantities_extended: Callable[..., Any]
    settle_cylinder: Callable[..., Any]


def functions_of(module: types.ModuleType) -> dict[str, types.FunctionType]:
    """The functions that a module defines."""
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, types.FunctionType) and value.__module__ == module.__name__
    }


def effect_modules() -> tuple[types.ModuleType, ...]:
    """The modules of the effects that have a law."""
    return tuple(sys.modules[effect.change.__module__] for effect in effects.EFFECTS.values() if effect.change)


def equations() -> dict[str, Function]:
    """Every equation of the engine by name (the numpy functions as written)."""
    found: dict[str, Function] = {}
    for module in (*LEAVES, model, *effect_modules()):
        for name, value in functions_of(module).items():
            if name in found:
                raise DieselTwinError(f"equation {name} is defined twice")
            found[name] = value
    return found


def hook_source(hook: Function, entering: Sequence[Effect]) -> str:
    """Text of a hook's function that applies the laws of effects.

    Raises:
        DieselTwinError: a law that names what the hook doesn't know.
    """
    quantity, *known = inspect.signature(hook).parameters
    expressions = {name: f"c.{name}" for name in model_constants.CONSTANT_NAMES}
    for name, kind in get_type_hints(hook).items():
        if isinstance(kind, type) and issubclass(kind, tuple) and kind is not model_constants.Constants:
            expressions |= {field: f"{name}.{field}" for field in kind._fields}  # type: ignore[attr-defined]
    expressions |= {name: name for name in known}
    lines = [f"def {hook.__name__}({', '.join((quantity, *known))}):"]
    for effect in entering:
        if effect.change is None:
            raise DieselTwinError(f"effect {effect.name} enters at {effect.enters.name} without a law")
        unknown = [name for name in effect.arguments if name not in expressions]
        if unknown:
            raise DieselTwinError(f"effect {effect.name}: its law names {unknown}; at {quantity} there are "
                                  f"{sorted(set(expressions) - set(model_constants.CONSTANT_NAMES))}")  # fmt: skip
        arguments = ", ".join((quantity, f"m.{effect.name}", *(expressions[name] for name in effect.arguments)))
        lines.append(f"    {quantity} = {effect.change.__name__}({arguments})")
    return "\n".join((*lines, f"    return {quantity}\n"))


def hook_sources() -> dict[str, str]:
    """Name -> text of all hooks with the laws of the effects that enter there.

    Raises:
        DieselTwinError: an effect that enters where there is no hook.
    """
    names = functions_of(hooks)
    for effect in effects.EFFECTS.values():
        if effect.enters.through == "quantity" and f"at_{effect.enters.name}" not in names:
            raise DieselTwinError(f"effect {effect.name} enters at {effect.enters.name!r}; known: {', '.join(names)}")
    return {
        name: hook_source(hook, [effects.EFFECTS[n] for n in effects.effects_at(name.removeprefix("at_"))])
        for name, hook in names.items()
    }


def _numba_primitives() -> dict[str, Any]:
    from dieseltwin.engine._fastmath import fast_exp, fast_positive_power, select
    from dieseltwin.inner import inner

    options = COMPILED

    @inner(**options)
    def n_root(x):  # type: ignore[no-untyped-def]
        return math.sqrt(select(x > 0.0, x, 0.0))

    @inner(**options)
    def n_maximum(a, b):  # type: ignore[no-untyped-def]
        return select(a > b, a, b)

    @inner(**options)
    def n_minimum(a, b):  # type: ignore[no-untyped-def]
        return select(a < b, a, b)

    @inner(**options)
    def n_where(condition, a, b):  # type: ignore[no-untyped-def]
        return select(condition, a, b)

    def constructor(name: str, **changes: str) -> Any:
        # Written out: numba can't call `_replace` of a NamedTuple.
        fields = ", ".join(changes.get(field, f"c.{field}") for field in model_constants.CONSTANT_NAMES)
        scope: dict[str, Any] = {"Constants": model_constants.Constants, "__name__": __name__}
        exec(f"def {name}(c, {', '.join(changes.values())}):\n    return Constants({fields})\n", scope)
        return inner(**options)(scope[name])

    return {
        "with_ambient_pressure": constructor("with_ambient_pressure", p_amb="pressure"),
        "with_charge": constructor("with_charge", T_im="T_im", eta_sc="eta_sc"),
        "exp": fast_exp,
        "root": n_root,
        "positive_power": fast_positive_power,
        "maximum": n_maximum,
        "minimum": n_minimum,
        "where": n_where,
    }


@lru_cache(maxsize=1)
def _cached_numba_primitives() -> dict[str, Any]:
    return _numba_primitives()


def primitives_of(backend: Backend | Mapping[str, Any]) -> dict[str, Any]:
    """The primitives of a backend by name; a backend of one's own is given by them (`array_namespace.PRIMITIVES`)."""
    if not isinstance(backend, str):
        return dict(backend)
    if backend == "numpy":
        return {name: getattr(array_namespace, name) for name in array_namespace.PRIMITIVES}
    if backend == "torch":
        return array_namespace.torch_primitives()
    if backend == "numba":
        return _cached_numba_primitives()
    raise DieselTwinError(f"unknown backend {backend!r}; allowed: numpy, torch, numba")


def _named_values(module: types.ModuleType) -> Scope:
    """Constants (limiters), result types and tuples of numbers that a module's functions name."""
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, (int, float)) or (isinstance(value, type) and issubclass(value, tuple))
        or (isinstance(value, tuple) and hasattr(value, "_fields"))
    }  # fmt: skip


def _in_scope(function: Any, scope: Scope, backend: Backend | Mapping[str, Any]) -> Function:
    copy = types.FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
    copy.__doc__ = function.__doc__
    copy.__module__ = scope["__name__"]
    if backend == "numba":
        from dieseltwin.inner import inner

        return inner(**COMPILED)(copy)  # type: ignore[no-any-return]
    return copy


def bind(backend: Backend | Mapping[str, Any], replace: Mapping[str, Function] | None = None) -> Model:
    """The model's equations over a backend, with some of them replaced.

    Args:
        backend: "numpy" (arrays), "torch" (differentiable tensors), "numba" (compiled scalars), or primitives by name.
        replace: equation name -> function of the same signature, for instance learned maps (`MAPS`). For "numba"
            the functions must be compiled ones.

    Raises:
        DieselTwinError: unknown backend or equation name.
    """
    replace = dict(replace or {})
    unknown = sorted(set(replace) - set(equations()))
    if unknown:
        raise DieselTwinError(f"can't replace unknown equations {unknown}; the empirical maps are {MAPS}")
    shared: Scope = {"__builtins__": __builtins__, "__name__": __name__}  # numba's cache imports it
    for module in (*LEAVES, quantities, model_constants, model):
        shared |= _named_values(module)
    shared |= primitives_of(backend)

    def bound(module: types.ModuleType, scope: Scope) -> Scope:
        """The module's functions in a scope, which then holds them too."""
        own = {name: replace.get(name) or _in_scope(f, scope, backend) for name, f in functions_of(module).items()}
        scope.update(own)
        return own

    leaves: Scope = {}
    for module in LEAVES:
        leaves |= bound(module, shared)
    for module in effect_modules():  # constants of an effect are its own
        laws = bound(module, {**shared, **_named_values(module)})
        leaves |= laws
    full, plain = {**shared, **leaves}, dict(shared)
    for name, text in hook_sources().items():
        exec(compile(text, f"<{name}>", "exec"), full)
        full[name] = _in_scope(full[name], full, backend)
    composed = bound(model, full)
    bound(hooks, plain)
    published = bound(model, plain)
    plain.update({
        name: _in_scope(function, plain, backend) for name, function in functions_of(without_effects).items()
    })
    composed["quantities"] = published["quantities"]
    return Model(**leaves, **composed, constants=parameters.constants)


@lru_cache(maxsize=2)
def numpy_model(restricted: bool = True) -> Model:
    """The equations over numpy arrays; `restricted`: with what the effects of `effects.IMPLICIT` need."""
    return bind("numpy", None if restricted else functions_of(unrestricted))
