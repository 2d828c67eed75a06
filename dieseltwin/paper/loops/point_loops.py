"""A recorded tensor program of independent points, written as one C loop over lanes and points.

A loss over (lanes, points) whose points don't mix is element-wise but for sums over time. Recorded with its gradient
(`make_fx`), it is some 900 operations over tensors; written one below the other in the body of a loop they keep
everything between a point's inputs and its gradient in registers. The text is made from the recorded graph, so formulae
and derivatives are those of the tensor program; what can't be written (points that mix) is refused.

What depends on the lane alone is computed before the loop, sums over time after it. Powers become exp(a log x), so that
one logarithm serves all powers of a base and their derivatives; the results differ from the tensors' by rounding.

Points are taken in blocks. A small network (`fused_maps`) ends one pass over a block and begins the next: it is
evaluated for the whole block at once with its slopes (`networks.c`), and what later passes need of earlier ones
lies in rows of the block. The last block overlaps the one before, so that all have the same length.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Sequence
from typing import Any, Literal

import torch
from torch import Tensor
from torch.fx import Graph, GraphModule, Node
from torch.fx.node import Argument

from dieseltwin.paper.loops.c_library import BLOCK, NotCompiledError, load, networks_source
from dieseltwin.paper.loops.network_functions import NetworkFunctions

_VIEWS = ("expand", "unsqueeze", "squeeze", "view", "detach", "alias", "clone", "_to_copy", "lift_fresh_copy", "copy")
_BINARY = {"mul": "*", "add": "+", "sub": "-", "div": "/"}
_COMPARED = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_CALLS = {"sqrt": "sqrt", "exp": "exp_of", "log": "log_of", "log1p": "log1p", "abs": "fabs", "tanh": "tanh"}


class PointLoops:
    """A compiled loop.

    Attributes:
        run: C function of the first lane, the one behind the last, addresses of the arguments, addresses of the
            outputs (contiguous along the points) and their strides between lanes.

    Args:
        graph: recorded graph; its outputs are (L, n) or (L,).
        arguments: tensors in the order of the placeholders, in place for every call with the same shapes and strides.
        n: points.

    Raises:
        NotCompiledError: see there.
    """

    def __init__(self, graph: Graph, arguments: Sequence[Tensor], n: int) -> None:
        text = _Text(graph, arguments, n)
        self.run = load(networks_source(arguments[0].dtype) + text.source()).run
        self.run.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
        self.run.restype = None


def pointers(tensors: Sequence[Tensor]) -> Any:
    """The tensors' addresses, as C takes them."""
    return (ctypes.c_void_p * len(tensors))(*(t.data_ptr() for t in tensors))


def lift(recorded: GraphModule) -> list[Tensor]:
    """Make arguments of the tensors that a recorded module holds: data must not be part of the code."""
    graph = recorded.graph
    last = [node for node in graph.nodes if node.op == "placeholder"][-1]
    inputs: dict[int, Node] = {}
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


When = Literal["lane", "sum"] | int
"""When a value is known: before the loop over points, after it, or in which pass over a block of points."""


class _Text:
    """The C text of a graph. A value is its C expression and when it is known."""

    def __init__(self, graph: Graph, arguments: Sequence[Tensor], n: int) -> None:
        self.n, self.lanes = n, next(int(t.shape[0]) for t in arguments if t.dim() == 2 and t.shape[1] == n)
        self.block = min(n, BLOCK)
        self.parts: dict[str, list[str]] = {"lane": [], "sum": [], "start": []}
        self.passes: list[list[str]] = [[]]
        self.calls: list[list[str]] = [[]]
        self.functions = NetworkFunctions()
        self.values: dict[Node, tuple[str, When]] = {}
        self.tensors: dict[Node, tuple[int, Tensor]] = {}
        self.networks: dict[Node, tuple[str, int]] = {}
        self.firsts: dict[Node, str] = {}
        self.known: dict[tuple[When, str], str] = {}
        self.born: dict[str, tuple[int, str]] = {}
        self.loads: set[str] = set()
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

    def source(self) -> str:
        body = {name: "\n".join(lines) for name, lines in self.parts.items()}
        return (
            f"{self.functions.source()}\n"
            "void run(long first, long last, real* const* in, real* const* out, const long* restrict stride) {\n"
            f"for (long lane = first; lane < last; ++lane) {{\n{body['start']}\n{body['lane']}\n"
            f"for (long from = 0; from < {self.n}; from += {self.block}) {{\n"
            f"const long at = from + {self.block} > {self.n} ? {self.n - self.block} : from;\n"
            f"{self._block()}\n}}\n{body['sum']}\n}}\n}}\n"
        )

    def _block(self) -> str:
        """All passes over one block; what a later pass needs of an earlier one is read again or lies in a row."""
        kept: dict[str, None] = {}
        texts = []
        for number, lines in enumerate(self.passes):
            needed = dict.fromkeys(re.findall(r"\bv\d+\b", "\n".join(lines)))
            before = []
            for name in needed:
                born, expression = self.born.get(name, (number, ""))
                if born < number:
                    again = name in self.loads
                    before.append(f"const real {name} = {expression if again else f'row_{name}[b]'};")
                    kept |= {} if again else {name: None}
            texts.append((before, lines))
        rows = [f"real row_{name}[BLOCK] __attribute__((aligned(64)));" for name in kept]
        loops = []
        for number, (before, lines) in enumerate(texts):
            keep = [f"row_{name}[b] = {name};" for name in kept if self.born[name][0] == number]
            loops += [
                '_Pragma("GCC ivdep")', f"for (int b = 0; b < {self.block}; ++b) {{ const long i = at + b;",
                *before, *lines, *keep, "}", *self.calls[number],
            ]  # fmt: skip
        return "\n".join([*rows, *loops])

    def _name(self, when: When, expression: str, *, load: bool = False) -> str:
        if (when, expression) in self.known:
            return self.known[when, expression]
        name = f"v{self.count}"
        self.count += 1
        if isinstance(when, int):
            self.born[name] = when, expression
            self._pass(when).append(f"const real {name} = {expression};")
            if load:
                self.loads.add(name)
        else:
            self.parts[when].append(f"const real {name} = {expression};")
        self.known[when, expression] = name
        return name

    def _pass(self, number: int) -> list[str]:
        while len(self.passes) <= number:
            self.passes.append([])
            self.calls.append([])
        return self.passes[number]

    def _outputs(self, nodes: Sequence[Node]) -> None:
        for number, node in enumerate(nodes):
            value, when = self._value(node)
            self.parts["start"].append(f"real* restrict const o{number} = out[{number}] + lane * stride[{number}];")
            if len(node.meta["val"].shape) == 2:
                self._pass(when if isinstance(when, int) else 0).append(f"o{number}[i] = {value};")
            else:
                self.parts["sum"].append(f"o{number}[0] = {value};")

    def _value(self, argument: Argument) -> tuple[str, When]:
        if isinstance(argument, (int, float)):
            return (f"((real){float(argument)!r})" if math.isfinite(argument) else "((real)INFINITY)"), "lane"
        if argument in self.values:
            return self.values[argument]
        number, tensor = self.tensors[argument]
        self.values[argument] = found = self._load(number, tensor)
        return found

    def _load(self, number: int, tensor: Tensor) -> tuple[str, When]:
        offset = tensor.storage_offset() - self.arguments[number].storage_offset()
        shape, stride = tuple(tensor.shape), tensor.stride()
        if shape and shape[0] not in (1, self.lanes):
            raise NotCompiledError(f"tensor of shape {shape}")
        by_lane = stride[0] if shape and shape[0] == self.lanes else 0
        where = f"in[{number}] + {offset} + lane * {by_lane}L"
        if len(shape) == 2 and shape[1] == self.n and stride[1] != 0:
            row = f"p{self.count}"
            self.count += 1
            self.parts["start"].append(f"const real* restrict const {row} = {where};")
            return self._name(0, f"{row}[i * {stride[1]}L]", load=True), 0
        if len(shape) > 2 or (len(shape) == 2 and shape[1] not in (1, self.n)):
            raise NotCompiledError(f"tensor of shape {shape}")
        return self._name("lane", f"*({where})"), "lane"

    def _node(self, node: Node) -> None:
        name = str(node.target)
        name = name.split(".")[1] if name.startswith(("aten.", "dieseltwin.")) else name
        source = node.args[0] if node.args and isinstance(node.args[0], torch.fx.Node) else None
        if source in self.tensors and source not in self.values and name in (*_VIEWS, "select", "slice", "transpose"):
            number, tensor = self.tensors[source]
            seen = node.target(tensor, *node.args[1:], **node.kwargs)
            if seen.untyped_storage().data_ptr() == tensor.untyped_storage().data_ptr():
                self.tensors[node] = (number, seen)
                return
        if name == "small_network":
            self._network(node)
        else:
            self.values[node] = self._written(node, name)

    def _network(self, node: Node) -> None:
        """The call behind the pass that knows the inputs; value and slopes are rows that the next pass reads."""
        inputs, weights, widths, activation = node.args
        values = [self._value(v) for v in inputs]
        when = max((w for _, w in values if isinstance(w, int)), default=0)
        if any(w == "sum" for _, w in values):
            raise NotCompiledError("a network of a sum over time")
        number, tensor = self.tensors[weights]
        place = f"in[{number}] + {tensor.storage_offset() - self.arguments[number].storage_offset()}"
        mark, function = len(self.networks), "_".join(["network", activation, *map(str, widths)])
        self.functions.network(function, widths, activation)
        for name, length in ((f"x{mark}", widths[0]), (f"y{mark}", 1 + widths[0])):
            self.parts["start"].append(f"real {name}[{length} * BLOCK] __attribute__((aligned(64))) = {{0}};")
        self._pass(when).extend(f"x{mark}[{j} * BLOCK + b] = {value};" for j, (value, _) in enumerate(values))
        self.calls[when].append(f"{function}({place} + lane * {tensor.stride(0)}L, x{mark}, y{mark});")
        self.networks[node] = f"y{mark}", when + 1

    def _written(self, node: Node, name: str) -> tuple[str, When]:
        if node.args and node.args[0] in self.networks:  # getitem: value, then slopes
            row, number = self.networks[node.args[0]]
            return self._name(number, f"{row}[{node.args[1]} * BLOCK + b]", load=True), number
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
                raise NotCompiledError("a slope at other points than the first")
            return self._name(0, f"i == 0 ? {value} : (real)0", load=True), 0
        if len(shape) > 2 or (shape and shape[0] not in (1, self.lanes)):
            raise NotCompiledError(f"{name} of shape {shape}")
        if name in ("sum", "mean"):
            return self._sum(node, name)
        if name in _VIEWS:
            return self._value(node.args[0])
        arguments = [self._value(a) for a in node.args if isinstance(a, (int, float, torch.fx.Node))]
        when = self._when(arguments)
        return self._name(when, self._expression(name, [a for a, _ in arguments], node, when)), when

    def _when(self, arguments: Sequence[tuple[str, When]]) -> When:
        found = {when for _, when in arguments}
        passes = [when for when in found if isinstance(when, int)]
        if "sum" in found and passes:
            raise NotCompiledError("a point depends on a sum over time")
        return "sum" if "sum" in found else max(passes) if passes else "lane"

    def _expression(self, name: str, a: list[str], node: Node, when: When) -> str:
        if name in _BINARY:
            if "rounding_mode" in node.kwargs:
                raise NotCompiledError("rounded division")
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
                raise NotCompiledError("another softplus")
            return f"fmax({a[0]}, (real)0) + log_of((real)1 + {self._name(when, f'exp_of(-fabs({a[0]}))')})"
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
            raise NotCompiledError(name)
        return plain[name].format(*a)

    def _sigmoid(self, x: str, when: When) -> str:
        small = self._name(when, f"exp_of(-fabs({x}))")
        share = self._name(when, f"(real)1 / ((real)1 + {small})")
        return self._name(when, f"{x} >= 0 ? {share} : {small} * {share}")

    def _power(self, a: list[str], exponent: Argument, when: When) -> str:
        if isinstance(exponent, (int, float)):
            if exponent in (0, 1, 2, 3):
                return " * ".join([a[0]] * int(exponent)) or "(real)1"
            if float(exponent).is_integer():
                return f"pow({a[0]}, {a[1]})"
        return f"exp_of({a[1]} * {self._name(when, f'log_of({a[0]})')})"

    def _sum(self, node: Node, name: str) -> tuple[str, When]:
        value, when = self._value(node.args[0])
        shape = tuple(node.args[0].meta["val"].shape)
        dims = node.args[1] if len(node.args) > 1 else None
        if when == "sum" or shape != (self.lanes, self.n) or dims is None or [d % 2 for d in dims] != [1]:
            raise NotCompiledError(f"{name} of {shape} over {dims}")
        total = f"s{self.count}"
        self.count += 1
        self.parts["start"].append(f"real {total} = 0;")
        added = f"i < from ? (real)0 : {value}" if self.n % self.block else value  # the last block repeats points
        self._pass(when if isinstance(when, int) else 0).append(f"{total} += {added};")
        return (total if name == "sum" else self._name("sum", f"{total} / (real){self.n}")), "sum"

    def _first(self, node: Node) -> tuple[str, When]:
        """The value at the first point, known before the loop: what it takes is written once more."""
        if tuple(node.args[1:]) != (1, 0):
            raise NotCompiledError("other points than the first")
        value, when = self._value(node.args[0])
        if not isinstance(when, int):
            return value, when
        if when > 0:
            raise NotCompiledError("a network's value at the first point")
        return self._again(value), "lane"

    def _again(self, value: str) -> str:
        """The loop's line for `value` and all it needs, at i = 0, before the loop."""
        if value not in self.firsts:
            _, expression = self.born[value]
            for other in sorted(set(re.findall(r"\bv\d+\b", expression)), key=len, reverse=True):
                if other in self.born:
                    expression = re.sub(rf"\b{other}\b", self._again(other), expression)
            self.firsts[value] = self._name("lane", re.sub(r"\bi\b", "0", expression))
        return self.firsts[value]
