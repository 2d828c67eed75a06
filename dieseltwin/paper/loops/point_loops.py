"""A recorded tensor program of independent points, written as one C loop over lanes and points.

A loss over (lanes, points) whose points don't mix is element-wise but for sums over time. Recorded with its gradient
(`make_fx`), it is some 900 operations over tensors; written one below the other in the body of a loop they keep
everything between a point's inputs and its gradient in registers. The text is made from the recorded graph, so formulae
and derivatives are those of the tensor program; what can't be written (matrix products, points that mix) is refused.

What depends on the lane alone is computed before the loop, sums over time after it. Powers become exp(a log x), so that
one logarithm serves all powers of a base and their derivatives; the results differ from the tensors' by rounding.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

FLAGS = (
    "-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fPIC",
    "-fno-tree-sink", "-fno-tree-pre", "-fno-code-hoisting", "-fno-gcse", "-fno-thread-jumps",
)  # fmt: skip
"""Of the C compiler: fast mathematics lets sums and exp run over vectors, and no operation may move behind a condition.
One compiler on one machine gives one result."""
C_TYPES = {torch.float32: "float", torch.float64: "double"}
_VIEWS = ("expand", "unsqueeze", "squeeze", "view", "detach", "alias", "clone", "_to_copy", "lift_fresh_copy", "copy")
_BINARY = {"mul": "*", "add": "+", "sub": "-", "div": "/"}
_COMPARED = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_CALLS = {"sqrt": "sqrt", "exp": "exp", "log": "log", "log1p": "log1p", "abs": "fabs", "tanh": "tanh"}


class NotPointwiseError(Exception):
    """The recorded graph holds something that no loop over points can be written for, or nothing compiles it."""


class PointLoops:
    """A compiled loop.

    Args:
        graph: recorded graph; its outputs are (L, n) or (L,).
        arguments: tensors in the order of the placeholders, in place for every call with the same shapes and strides.
        n: points.

    Raises:
        NotPointwiseError: see there.
    """

    def __init__(self, graph: torch.fx.Graph, arguments: Sequence[Tensor], n: int) -> None:
        text = _Text(graph, arguments, n)
        dtype = arguments[0].dtype
        self._run = _library(text.source(C_TYPES[dtype])).run
        self._run.argtypes = [ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
        self._run.restype = None

    def __call__(self, lanes: int, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> None:
        """Evaluate.

        Args:
            lanes: L.
            inputs: tensors as at the start.
            outputs: tensors to write, contiguous along the points; any stride between lanes.
        """
        pointers = (ctypes.c_void_p * len(inputs))(*(t.data_ptr() for t in inputs))
        results = (ctypes.c_void_p * len(outputs))(*(t.data_ptr() for t in outputs))
        strides = (ctypes.c_long * len(outputs))(*(t.stride(0) for t in outputs))
        self._run(lanes, pointers, results, strides)


def lift(recorded: Any) -> list[Tensor]:
    """Make arguments of the tensors that a recorded module holds: data must not be part of the code."""
    graph = recorded.graph
    last = [node for node in graph.nodes if node.op == "placeholder"][-1]
    inputs: dict[int, Any] = {}
    lifted: list[Tensor] = []
    for node in [node for node in graph.nodes if node.op == "get_attr"]:
        tensor = getattr(recorded, node.target)
        if id(tensor) not in inputs:
            with graph.inserting_after(last):
                last = inputs[id(tensor)] = graph.placeholder(f"held_{len(lifted)}")
            lifted.append(tensor)
        node.replace_all_uses_with(inputs[id(tensor)])
        graph.erase_node(node)
    graph.eliminate_dead_code()
    return lifted


class _Text:
    """The C text of a graph. A value is its C expression and when it is known: "lane", "point" or "sum"."""

    def __init__(self, graph: torch.fx.Graph, arguments: Sequence[Tensor], n: int) -> None:
        self.n, self.lanes = n, next(int(t.shape[0]) for t in arguments if t.dim() == 2 and t.shape[1] == n)
        self.parts: dict[str, list[str]] = {"lane": [], "point": [], "sum": [], "start": []}
        self.values: dict[Any, tuple[str, str]] = {}
        self.tensors: dict[Any, tuple[int, Tensor]] = {}
        self.firsts: dict[Any, str] = {}
        self.known: dict[tuple[str, str], str] = {}
        self.count = 0
        self.arguments = arguments
        given = iter(enumerate(arguments))
        for node in graph.nodes:
            if node.op == "placeholder":
                self.tensors[node] = next(given)
            elif node.op == "output":
                self._outputs(node.args[0])
            else:
                self._node(node)

    def source(self, real: str) -> str:
        body = {name: "\n".join(lines) for name, lines in self.parts.items()}
        return (
            f"#include <tgmath.h>\ntypedef {real} real;\n"
            "void run(long lanes, real* const* in, real* const* out, const long* restrict stride) {\n"
            f"for (long lane = 0; lane < lanes; ++lane) {{\n{body['start']}\n{body['lane']}\n"
            '_Pragma("GCC ivdep")\n'
            f"for (long i = 0; i < {self.n}; ++i) {{\n{body['point']}\n}}\n{body['sum']}\n}}\n}}\n"
        )

    def _name(self, when: str, expression: str) -> str:
        if (when, expression) in self.known:
            return self.known[when, expression]
        name = f"v{self.count}"
        self.count += 1
        self.parts[when].append(f"const real {name} = {expression};")
        self.known[when, expression] = name
        return name

    def _outputs(self, nodes: Sequence[Any]) -> None:
        for number, node in enumerate(nodes):
            value, _ = self._value(node)
            at = "[i]" if len(node.meta["val"].shape) == 2 else ""
            self.parts["start"].append(f"real* restrict const o{number} = out[{number}] + lane * stride[{number}];")
            self.parts["point" if at else "sum"].append(f"o{number}{at or '[0]'} = {value};")

    def _value(self, argument: Any) -> tuple[str, str]:
        if isinstance(argument, (int, float)):
            return (f"((real){float(argument)!r})" if math.isfinite(argument) else "((real)INFINITY)"), "lane"
        if argument in self.values:
            return self.values[argument]
        number, tensor = self.tensors[argument]
        self.values[argument] = found = self._load(number, tensor)
        return found

    def _load(self, number: int, tensor: Tensor) -> tuple[str, str]:
        offset = tensor.storage_offset() - self.arguments[number].storage_offset()
        shape, stride = tuple(tensor.shape), tensor.stride()
        if shape and shape[0] not in (1, self.lanes):
            raise NotPointwiseError(f"tensor of shape {shape}")
        by_lane = stride[0] if shape and shape[0] == self.lanes else 0
        where = f"in[{number}] + {offset} + lane * {by_lane}L"
        if len(shape) == 2 and shape[1] == self.n and stride[1] != 0:
            row = f"p{self.count}"
            self.count += 1
            self.parts["start"].append(f"const real* restrict const {row} = {where};")
            return self._name("point", f"{row}[i * {stride[1]}L]"), "point"
        if len(shape) > 2 or (len(shape) == 2 and shape[1] not in (1, self.n)):
            raise NotPointwiseError(f"tensor of shape {shape}")
        return self._name("lane", f"*({where})"), "lane"

    def _node(self, node: Any) -> None:
        name = str(node.target).split(".")[1] if str(node.target).startswith("aten.") else str(node.target)
        source = node.args[0] if node.args and isinstance(node.args[0], torch.fx.Node) else None
        if source in self.tensors and source not in self.values and name in (*_VIEWS, "select", "slice", "transpose"):
            number, tensor = self.tensors[source]
            seen = node.target(tensor, *node.args[1:], **node.kwargs)
            if seen.untyped_storage().data_ptr() == tensor.untyped_storage().data_ptr():
                self.tensors[node] = (number, seen)
                return
        self.values[node] = self._written(node, name)

    def _written(self, node: Any, name: str) -> tuple[str, str]:
        constants = {"ones_like": 1.0, "zeros_like": 0.0}
        if name in constants:
            return self._value(constants[name])
        if name in ("scalar_tensor", "full"):
            return self._value(node.args[0 if name == "scalar_tensor" else 1])
        shape = tuple(node.meta["val"].shape)
        if name == "select":
            return self._first(node)
        if name == "select_backward":
            value, when = self._value(node.args[0])
            if tuple(node.args[1]) != (self.lanes, self.n) or tuple(node.args[2:4]) != (1, 0) or when != "lane":
                raise NotPointwiseError("a slope at other points than the first")
            return self._name("point", f"i == 0 ? {value} : (real)0"), "point"
        if len(shape) > 2 or (shape and shape[0] not in (1, self.lanes)):
            raise NotPointwiseError(f"{name} of shape {shape}")
        if name in ("sum", "mean"):
            return self._sum(node, name)
        if name in _VIEWS:
            return self._value(node.args[0])
        arguments = [self._value(a) for a in node.args if isinstance(a, (int, float, torch.fx.Node))]
        when = self._when(arguments)
        return self._name(when, self._expression(name, [a for a, _ in arguments], node, when)), when

    def _when(self, arguments: Sequence[tuple[str, str]]) -> str:
        found = {when for _, when in arguments}
        if "sum" in found and "point" in found:
            raise NotPointwiseError("a point depends on a sum over time")
        return "sum" if "sum" in found else "point" if "point" in found else "lane"

    def _expression(self, name: str, a: list[str], node: Any, when: str) -> str:
        if name in _BINARY:
            if "rounding_mode" in node.kwargs:
                raise NotPointwiseError("rounded division")
            alpha = node.kwargs.get("alpha", 1)
            second = a[1] if alpha == 1 else f"{self._value(alpha)[0]} * {a[1]}"
            return f"{a[0]} {_BINARY[name]} {second}"
        if name in _COMPARED:
            return f"(real)({a[0]} {_COMPARED[name]} {a[1]})"
        if name in _CALLS:
            return f"{_CALLS[name]}({a[0]})"
        if name == "pow":
            return self._power(a, node.args[1], when)
        if name == "softplus":
            if len(node.args) > 1:
                raise NotPointwiseError("another softplus")
            return f"fmax({a[0]}, (real)0) + log((real)1 + {self._name(when, f'exp(-fabs({a[0]}))')})"
        if name == "softplus_backward":
            return f"{a[0]} * {self._sigmoid(a[1], when)}"
        plain = {
            "neg": "-{0}", "rsub": "{1} - {0}", "reciprocal": "(real)1 / {0}", "square": "{0} * {0}",
            "where": "{0} != (real)0 ? {1} : {2}", "maximum": "fmax({0}, {1})", "minimum": "fmin({0}, {1})",
            "clamp_min": "{0} > {1} ? {0} : {1}", "clamp_max": "{0} < {1} ? {0} : {1}",
            "sigmoid_backward": "{0} * {1} * ((real)1 - {1})",
            "sgn": "(real)(({0} > 0) - ({0} < 0))", "logical_and": "{0} * {1}", "bitwise_and": "{0} * {1}",
        }  # fmt: skip
        if name == "sigmoid":
            return self._sigmoid(a[0], when)
        if name == "clamp":
            low, high = (*node.args[1:], None)[:2]
            text = a[0] if low is None else f"fmax({a[0]}, {self._value(low)[0]})"
            return text if high is None else f"fmin({text}, {self._value(high)[0]})"
        if name not in plain:
            raise NotPointwiseError(name)
        return plain[name].format(*a)

    def _sigmoid(self, x: str, when: str) -> str:
        small = self._name(when, f"exp(-fabs({x}))")
        share = self._name(when, f"(real)1 / ((real)1 + {small})")
        return self._name(when, f"{x} >= 0 ? {share} : {small} * {share}")

    def _power(self, a: list[str], exponent: Any, when: str) -> str:
        if isinstance(exponent, (int, float)):
            if exponent in (0, 1, 2, 3):
                return " * ".join([a[0]] * int(exponent)) or "(real)1"
            if float(exponent).is_integer():
                return f"pow({a[0]}, {a[1]})"
        return f"exp({a[1]} * {self._name(when, f'log({a[0]})')})"

    def _sum(self, node: Any, name: str) -> tuple[str, str]:
        value, when = self._value(node.args[0])
        shape = tuple(node.args[0].meta["val"].shape)
        dims = node.args[1] if len(node.args) > 1 else None
        if when == "sum" or shape != (self.lanes, self.n) or dims is None or [d % 2 for d in dims] != [1]:
            raise NotPointwiseError(f"{name} of {shape} over {dims}")
        total = f"s{self.count}"
        self.count += 1
        self.parts["start"].append(f"real {total} = 0;")
        self.parts["point"].append(f"{total} += {value};")
        return (total if name == "sum" else self._name("sum", f"{total} / (real){self.n}")), "sum"

    def _first(self, node: Any) -> tuple[str, str]:
        """The value at the first point, known before the loop: what it takes is written once more."""
        if tuple(node.args[1:]) != (1, 0):
            raise NotPointwiseError("other points than the first")
        value, when = self._value(node.args[0])
        if when != "point":
            return value, when
        return self._again(value), "lane"

    def _again(self, value: str) -> str:
        """The loop's line for `value` and all it needs, at i = 0, before the loop."""
        if value not in self.firsts:
            expression = next(e for (when, e), name in self.known.items() if name == value and when == "point")
            for other in sorted(set(re.findall(r"\bv\d+\b", expression)), key=len, reverse=True):
                if any(name == other and when == "point" for (when, _), name in self.known.items()):
                    expression = re.sub(rf"\b{other}\b", self._again(other), expression)
            self.firsts[value] = self._name("lane", re.sub(r"\bi\b", "0", expression))
        return self.firsts[value]


def _library(source: str) -> Any:
    """Compile, or take from the folder of compiled kernels."""
    compiler = next((c for c in (os.environ.get("CC"), "gcc", "cc", "clang") if c and shutil.which(c)), None)
    if compiler is None:
        raise NotPointwiseError("no C compiler found")
    from dieseltwin.engine._compiled import numba  # its folder is the project's

    folder = Path(numba.config.CACHE_DIR)
    try:
        return ctypes.CDLL(str(_built(compiler, source, folder)))
    except OSError as error:
        raise NotPointwiseError(f"compiled loop in {folder}: {error}") from None


def _built(compiler: str, source: str, folder: Path) -> Path:
    """The library of a source, made if it isn't there; the processor is part of its name."""
    about = Path("/proc/cpuinfo")
    machine = about.read_text().partition("flags")[2].partition("\n")[0] if about.exists() else platform.processor()
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    name = hashlib.sha256("\0".join([source, compiler, version, machine, *FLAGS]).encode()).hexdigest()[:24]
    path = folder / f"points-{name}.so"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        text, part, made = (str(Path(scratch) / f"points.{end}") for end in ("c", "o", "so"))
        Path(text).write_text(source)
        # linked on its own: a linker told of fast mathematics adds code that makes the whole process flush subnormals
        for command in ([*FLAGS, "-c", text, "-o", part], ["-shared", part, "-o", made, "-lmvec", "-lm"]):
            done = subprocess.run([compiler, *command], capture_output=True, text=True, check=False)
            if done.returncode:
                raise NotPointwiseError(f"{compiler}: {(done.stderr.strip().splitlines() or ['failed'])[0]}")
        os.replace(made, path)
    return path
