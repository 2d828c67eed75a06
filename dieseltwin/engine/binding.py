"""Bind the equations to a backend: numpy, torch or numba.

An equation is written once, over the primitives of `array_namespace`, and calls other equations by their global
names. `bind` copies the functions with another globals dictionary, in which the primitives (and, if wished, single
equations) are replaced. A namespace argument would do the same for numpy and torch, but numba can't compile
functions that are passed around in an object; globals are what it understands.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, Literal

from dieseltwin.engine import (
    actuators,
    array_namespace,
    cylinder,
    effect_laws,
    egr,
    extended_model,
    manifolds,
    model,
    parameters,
    turbocharger,
)
from dieseltwin.errors import DieselTwinError

_MODULES = (manifolds, cylinder, egr, turbocharger, actuators, model, effect_laws, extended_model)
MAPS = ("eta_vol", "f_egr", "F_vgt_Pi_t", "eta_tm", "eta_c", "Phi_c")
"""The six empirical maps that a learned surrogate may replace (paper, table of surrogates)."""

COMPILED: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "forceinline": True}
"""Options of a compiled equation: without forced inlining the 80 constants travel through memory at every call."""

Backend = Literal["numpy", "torch", "numba"]


class Model(types.SimpleNamespace):
    """The bound equations as attributes, by the names of their functions; `constants` makes their last argument."""

    constants: Callable[..., Any]
    quantities: Callable[..., Any]
    quantities_extended: Callable[..., Any]
    settle_cylinder: Callable[..., Any]


def equations() -> dict[str, Callable[..., Any]]:
    """Every equation of the engine by name (the numpy functions as written)."""
    found: dict[str, Callable[..., Any]] = {}
    for module in _MODULES:
        for name, value in vars(module).items():
            if isinstance(value, types.FunctionType) and value.__module__ == module.__name__:
                if name in found:
                    raise DieselTwinError(f"equation {name} is defined twice")
                found[name] = value
    return found


def _numba_primitives() -> dict[str, Any]:
    import numba

    from dieseltwin.engine._fastmath import fast_exp, fast_positive_power, select

    options = COMPILED

    @numba.njit(**options)
    def n_root(x):  # type: ignore[no-untyped-def]
        return math.sqrt(select(x > 0.0, x, 0.0))

    @numba.njit(**options)
    def n_maximum(a, b):  # type: ignore[no-untyped-def]
        return select(a > b, a, b)

    @numba.njit(**options)
    def n_minimum(a, b):  # type: ignore[no-untyped-def]
        return select(a < b, a, b)

    @numba.njit(**options)
    def n_where(condition, a, b):  # type: ignore[no-untyped-def]
        return select(condition, a, b)

    def constructor(name: str, **changes: str) -> Any:
        # Written out: numba can't call `_replace` of a NamedTuple.
        fields = ", ".join(changes.get(field, f"c.{field}") for field in parameters.CONSTANT_NAMES)
        scope: dict[str, Any] = {"Constants": parameters.Constants, "__name__": __name__}
        exec(f"def {name}(c, {', '.join(changes.values())}):\n    return Constants({fields})\n", scope)
        return numba.njit(**options)(scope[name])

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


def bind(backend: Backend, replace: Mapping[str, Callable[..., Any]] | None = None) -> Model:
    """The model's equations over a backend, with some of them replaced.

    Args:
        backend: "numpy" (arrays), "torch" (differentiable tensors) or "numba" (compiled scalars).
        replace: equation name -> function of the same signature, for instance learned maps (`MAPS`). For "numba"
            the functions must be compiled ones.

    Raises:
        DieselTwinError: unknown backend or equation name.
    """
    functions = equations()
    replace = dict(replace or {})
    unknown = sorted(set(replace) - set(functions))
    if unknown:
        raise DieselTwinError(f"can't replace unknown equations {unknown}; the empirical maps are {MAPS}")
    if backend == "numpy":
        primitives: dict[str, Any] = {name: getattr(array_namespace, name) for name in array_namespace.PRIMITIVES}
    elif backend == "torch":
        primitives = array_namespace.torch_primitives()
    elif backend == "numba":
        primitives = _cached_numba_primitives()
    else:
        raise DieselTwinError(f"unknown backend {backend!r}; allowed: numpy, torch, numba")

    shared: dict[str, Any] = {"__builtins__": __builtins__, "__name__": __name__}  # numba's cache imports it
    for module in _MODULES:  # constants (limiters) and result types that the functions name
        for name, value in vars(module).items():
            if isinstance(value, (int, float)) or (isinstance(value, type) and issubclass(value, tuple)):
                shared[name] = value
    shared.update(primitives)
    bound: dict[str, Any] = {}
    for name, function in functions.items():
        copy = types.FunctionType(function.__code__, shared, name, function.__defaults__)
        copy.__doc__ = function.__doc__
        copy.__module__ = shared["__name__"]
        if backend == "numba":
            import numba

            copy = numba.njit(**COMPILED)(copy)
        bound[name] = replace.get(name, copy)
    shared.update(bound)
    return Model(**bound, constants=parameters.constants)
