"""Learned maps in compiled code: a simulator with maps.

It runs eight lanes in one vector register, which a loop over neurons would break. The maps of one hidden
layer are therefore written out, neuron by neuron, and their weights travel like the engine's constants: as further
rows of the parameter batch. One kernel serves all trainings and members of equal sizes.
"""

from __future__ import annotations

import hashlib
import inspect
import linecache
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from dieseltwin.engine import Actuation, Observations, ParameterBatch, _compiled, simulate_states
from dieseltwin.engine.binding import COMPILED, MAPS, bind
from dieseltwin.engine.parameters import CONSTANT_NAMES
from dieseltwin.errors import InputError
from dieseltwin.inner import inner, kernel
from dieseltwin.surrogates import empirical_forms
from dieseltwin.surrogates.empirical_forms import bound_forms

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps

Sizes = tuple[tuple[str, int, int], ...]
"""Name, number of inputs and number of neurons of each map."""

_N_ARGUMENTS = {"eta_vol": 2, "f_egr": 1, "F_vgt_Pi_t": 2, "eta_tm": 3, "eta_c": 2, "Phi_c": 3}


def compiled_simulator(
    maps: EmpiricalMaps, member: int | Mapping[str, int] | None = None
) -> Callable[..., Observations]:
    """`engine.simulate_states` with learned maps in place of the formulae: the same arguments and results.

    Args:
        maps: maps of one hidden layer (kind "improved").
        member: see `EmpiricalMaps.layers`; one for all lanes. A mapping names the maps that take a member; the others
            are nominal.

    Raises:
        InputError: deeper networks.
    """
    kernels = _kernels(_sizes(maps))
    weights = flat_weights(maps, member)[:, None]

    def simulate(
        actuation: Actuation | Sequence[Actuation],
        batch: ParameterBatch,
        initial: np.ndarray,
        *,
        threads: int | None = None,
    ) -> Observations:
        rows = np.broadcast_to(weights, (weights.shape[0], batch.size))
        extended = ParameterBatch(np.concatenate([batch.values, rows]))
        return simulate_states(actuation, extended, initial, threads=threads, kernels=kernels)

    return simulate


def _sizes(maps: EmpiricalMaps) -> Sizes:
    sizes = []
    for name in MAPS:
        network = maps.maps[name].network
        if len(network.hidden) != 1 or network.activation != "algebraic" or maps.kind != "improved":
            raise InputError(
                "compiled simulator", f"{maps.kind} maps with hidden layers {network.hidden} in {name}",
                "improved maps of one hidden layer", "use the improved maps",
            )  # fmt: skip
        sizes.append((name, network.widths[0], network.hidden[0]))
    return tuple(sizes)


def _weight_names(sizes: Sizes) -> list[str]:
    """Names of the further constants, in the order of `flat_weights`."""
    names = []
    for name, n_inputs, n_neurons in sizes:
        names += [f"{name}_low{i}" for i in range(n_inputs)] + [f"{name}_high{i}" for i in range(n_inputs)]
        names += [f"{name}_w{i}_{k}" for i in range(n_inputs) for k in range(n_neurons)]
        names += [f"{name}_b{k}" for k in range(n_neurons)] + [f"{name}_v{k}" for k in range(n_neurons)] + [f"{name}_v"]
    return names


def flat_weights(maps: EmpiricalMaps, member: int | Mapping[str, int] | None = None) -> np.ndarray:
    """All limits and weights of one member of maps of one hidden layer in a row, input scaling folded in."""
    _sizes(maps)
    parts = []
    for name in MAPS:
        item = maps.maps[name]
        one = member.get(name) if isinstance(member, Mapping) else member
        (weight, bias), (last, offset) = maps.layers(name, one)
        parts += [item.low, item.high, weight.numpy().ravel(), bias.numpy().ravel(), last.numpy().ravel()]
        parts += [offset.numpy().ravel()]
    return np.concatenate(parts)


def _map_source(name: str, n_inputs: int, n_neurons: int) -> str:
    names = ", ".join(f"a{i}" for i in range(_N_ARGUMENTS[name]))
    lines = [f"def {name}({names}, c):", f"    x = {name}_inputs({names}, c)"]
    for i in range(n_inputs):
        lines.append(f"    x{i} = minimum(maximum(x[{i}], c.{name}_low{i}), c.{name}_high{i})")
    for k in range(n_neurons):
        terms = " + ".join(f"c.{name}_w{i}_{k} * x{i}" for i in range(n_inputs))
        lines.append(f"    z{k} = {terms} + c.{name}_b{k}")
        lines.append(f"    y{k} = c.{name}_v{k} * z{k} / root(1.0 + z{k} * z{k})")
    total = " + ".join(f"y{k}" for k in range(n_neurons))
    limited = ", ".join(f"x{i}" for i in range(n_inputs))
    lines.append(f"    return {name}_output({total} + c.{name}_v, ({limited},))")
    return "\n".join(lines) + "\n"


@lru_cache(maxsize=4)
def _kernels(sizes: Sizes) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels for a block of lanes and for one lane, with maps of these sizes."""
    extended = namedtuple("LearnedConstants", [*CONSTANT_NAMES, *_weight_names(sizes)])  # type: ignore[misc]
    sources = {name: _map_source(name, n_inputs, n_neurons) for name, n_inputs, n_neurons in sizes}
    # numba's cache knows neither globals nor generated text: the kernel's name has to tell them apart
    parts = [*sources.values(), inspect.getsource(empirical_forms), Path(__file__).read_text(encoding="utf-8")]
    mark = hashlib.sha256("".join(parts).encode()).hexdigest()[:12]

    scope = empirical_forms.backend_globals("numba")
    for name, form in bound_forms("improved", "numba").items():
        scope |= {f"{name}_inputs": form.inputs, f"{name}_output": form.output}
    learned = {name: _compiled_text(name, text, scope, mark) for name, text in sources.items()}
    model = bind("numba", replace=learned)

    fields = ", ".join(f"values[{j} * lanes + k]" for j in range(len(extended._fields)))
    text = f"def load_constants(values, k, lanes):\n    return LearnedConstants({fields})\n"
    load_constants = _compiled_text("load_constants", text, {"LearnedConstants": extended}, mark)

    functions: dict[str, Any] = {
        name: getattr(model, name)
        for name in (
            "quantities", "settle_cylinder", "cylinder_sweep", "cylinder_inflow", "fuel_flow", "eta_vol",
            "exhaust_to_intake_ratio",
        )
    } | {"load_constants": load_constants}  # fmt: skip
    rates = _compiled._variant(_compiled._rates.py_func, f"_{mark}", 1, **functions)
    functions["_rates"] = inner(**_compiled._INLINED)(rates)
    kernels = []
    for lanes in (_compiled.LANES, 1):
        suffix = f"_{mark}_{lanes}"
        advance = numba.njit(**_compiled._OPTIONS)(_compiled._variant(_compiled._advance, suffix, lanes, **functions))
        integrate = _compiled._variant(_compiled._integrate, suffix, lanes, **functions, advance=advance)
        kernels.append(kernel(**_compiled._OPTIONS)(integrate))
    return kernels[0], kernels[1]


def _compiled_text(name: str, text: str, scope: dict[str, Any], mark: str) -> Any:
    """Compile generated source; it stays readable in tracebacks."""
    file = f"<{name} {mark}>"
    linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
    own = {**scope, "__name__": __name__}
    exec(compile(text, file, "exec"), own)
    return inner(**COMPILED)(own[name])
