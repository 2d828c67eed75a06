"""An epoch of the hybrid PINN as C: networks of time with their rates, the loss's points, and all gradients.

A lane's networks, points and gradients follow each other while what they hand on is in the nearest caches. The points
are the recorded program's (`point_loops`), the layers and their derivatives stand once in `networks.c`; this module
writes the calls for the widths of the networks. Frozen hidden layers are evaluated once and kept.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable

import torch
from torch import Tensor

from dieseltwin.paper.loops.c_library import BLOCK, load, networks_source
from dieseltwin.paper.loops.compiled_loss import CompiledLoss, Place, gradient_function
from dieseltwin.paper.loops.few_shot_program import Program
from dieseltwin.paper.loops.network_functions import NetworkFunctions
from dieseltwin.paper.loops.pinn_networks import StateNetworks

_HEAD = """
typedef void (*points_function)(long, long, real* const*, real* const*, const long*);
struct epoch {
    long lanes, frozen, known, stride;
    const real *time, *values;
    real *gradient, *work, *kept;
    real *const *z, *const *by;
    points_function points;
    real *const *in, *const *out;
    const long* strides;
};
"""


class _Epoch(ctypes.Structure):
    """`struct epoch` above."""

    _fields_ = [
        *((name, ctypes.c_long) for name in ("lanes", "frozen", "known", "stride")),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "time", "values", "gradient", "work", "kept", "z", "by", "points", "in_", "out", "strides",
            )
        ),
    ]  # fmt: skip


def epoch_function(
    program: Program, networks: StateNetworks, columns: tuple[Tensor, Tensor], place: Place, epochs: int,
    compiled: bool | None = None,
) -> Callable[[bool, bool], Tensor]:  # fmt: skip
    """A function that evaluates one epoch in place, compiled where it pays.

    Args:
        program: the loss.
        networks: from weights to linear outputs.
        columns: values and gradient (L, M), weights of the networks first.
        place: within these.
        epochs: that it is going to be called for.
        compiled: compile or not; None compiles where it pays.

    Returns:
        Function of whether the hidden layers are frozen and whether the self-adaptive weights adapt, to losses (L,).
    """
    values, gradient = columns
    loss = gradient_function(program, place, epochs * len(values), compiled)
    if isinstance(loss, CompiledLoss):
        loops = NetworkLoops(networks, values, gradient, loss)
        return lambda frozen, adaptive: loops(frozen)

    def eager(frozen: bool, adaptive: bool) -> Tensor:
        with torch.no_grad():
            for target, z in zip(place.z, networks.outputs(values), strict=True):
                target.copy_(z)
        total = loss(adaptive)
        networks.gradient(values, place.by_z, gradient)
        return total

    return eager


class NetworkLoops:
    """Loss and gradients of all columns of the lanes.

    Args:
        networks: the networks.
        values: (L, M) weights first; read in place.
        gradient: (L, M) written in place.
        loss: compiled points of the same lanes, whose linear outputs are written here.

    Raises:
        NotCompiledError: nothing compiles it.
    """

    def __init__(self, networks: StateNetworks, values: Tensor, gradient: Tensor, loss: CompiledLoss) -> None:
        text = _Text(networks)
        self.loss = loss
        self._run = load(networks_source(values.dtype) + _HEAD + text.source()).epoch
        self._run.restype = None
        blocks = text.blocks
        time = torch.zeros(blocks, 2, BLOCK, dtype=values.dtype)
        for k in range(blocks):
            at = text.start_of(k)
            row = networks.input[at : at + text.block]
            time[k, 0, : len(row)], time[k, 1] = row, networks.input_rate
        work = torch.empty(text.work, dtype=values.dtype)
        kept = torch.empty(len(values), text.kept, dtype=values.dtype)
        self._held = (time, work, kept, values, gradient)
        self._at = _Epoch(
            len(values), 0, 0, values.stride(0), time.data_ptr(), values.data_ptr(), gradient.data_ptr(),
            work.data_ptr(), kept.data_ptr(), *(ctypes.addressof(a) for a in (loss.z, loss.by_z)),
            ctypes.cast(loss.loops.run, ctypes.c_void_p).value,
            *(ctypes.addressof(a) for a in (loss.inputs, loss.outputs, loss.strides)),
        )  # fmt: skip

    def __call__(self, frozen: bool) -> Tensor:
        """Write z, all gradients, and return the (L,) total loss; `frozen` leaves the hidden layers' columns alone."""
        self._at.known = int(bool(self._at.frozen and frozen))
        self._at.frozen = int(frozen)
        self._run(ctypes.byref(self._at))
        return self.loss.total


class _Text:
    """The C text of an epoch."""

    def __init__(self, networks: StateNetworks) -> None:
        self.networks, self.n = networks, networks.n
        self.block, self.blocks = min(self.n, BLOCK), math.ceil(self.n / BLOCK)
        self.work = self.kept = 0
        self.functions = NetworkFunctions()

    def start_of(self, block: int) -> int:
        """First point of a block; the last one overlaps the one before."""
        return min(block * self.block, self.n - self.block)

    def _rows(self, rows: int, *, kept: bool = False) -> str:
        """An expression for `rows` rows of every block, k."""
        at, size = (self.kept, rows * BLOCK) if kept else (self.work, rows * BLOCK)
        if kept:
            self.kept += size * self.blocks
        else:
            self.work += size * self.blocks
        return f"({'kept' if kept else 'p->work'} + {at} + k * {size})"

    def source(self) -> str:
        """All text."""
        hidden: list[str] = []
        last: list[str] = []
        back: list[str] = []
        for number, spec in enumerate(self.networks.specs):
            for part, lines in zip((hidden, last, back), self._network(number, spec.rates, spec.states), strict=True):
                part += lines
        first = self.networks.hidden_size
        block = f"for (long k = 0; k < {self.blocks}; ++k) {{\n"
        point = (
            f"const long from = k * {self.block};\n"
            f"const long at = from + {self.block} > {self.n} ? {self.n - self.block} : from;\n"
        )
        kept = f"real* const kept = p->kept + lane * {self.kept}L;\n"
        return (
            self.functions.source() + "\nvoid epoch(const struct epoch* p) {\n"
            "for (long lane = 0; lane < p->lanes; ++lane) {\n"
            f"const real* const w = p->values + lane * p->stride;\n{kept}"
            f"static __thread vec sums[{self.networks.size}];\n"
            f"if (!p->known) {block}const real* const t = p->time + k * {2 * BLOCK};\n" + "\n".join(hidden) + "\n}\n"
            + block + point + "\n".join(last) + "\n}\n"
            "p->points(lane, lane + 1, p->in, p->out, p->strides);\n"
            f"for (long c = p->frozen ? {first} : 0; c < {self.networks.size}; ++c) sums[c] = (vec){{}};\n"
            + block + point + f"const real* const t = p->time + k * {2 * BLOCK};\n" + "\n".join(back) + "\n}\n"
            "real* const g = p->gradient + lane * p->stride;\n"
            f"for (long c = p->frozen ? {first} : 0; c < {self.networks.size}; ++c) {{\n"
            "real sum = 0;\nfor (int s = 0; s < WIDTH; ++s) sum += sums[c][s];\ng[c] = sum;\n}\n}\n}\n"
        )  # fmt: skip

    def _network(self, number: int, rated: bool, states: tuple[int, ...]) -> tuple[list[str], list[str], list[str]]:
        *layers, top = self.networks.layers[number]
        below = [("t", f"(t + {BLOCK})")]
        rates_of_arguments, hidden = [], []
        for depth, layer in enumerate(layers):
            kept = depth == len(layers) - 1
            h = self._rows(layer.outputs, kept=kept)
            x, x_rate = below[-1]
            i, o, w, offset = layer.inputs, layer.outputs, f"w + {layer.at}", f"w + {layer.bias_at}"
            r = q = "0"
            hidden.append(self.functions.forward(i, o, w, x, h, offset=offset, rows="out"))
            hidden.append(f"tanh_rows({o}, {h});")
            if rated:
                r, q = self._rows(o, kept=kept), self._rows(o, kept=kept)
                hidden.append(self.functions.forward(i, o, w, x_rate, q, rows="out"))
                hidden.append(f"tanh_rates({o}, {h}, {q}, {r});")
            rates_of_arguments.append(q)
            below.append((h, r))
        h, r = below[-1]
        out, ins, length = top.outputs, top.inputs, 2 * self.n if rated else self.n
        rows = f"real __attribute__((aligned(64))) y[{out} * BLOCK]"
        last = [f"{{ {rows}, y_rate[{out} * BLOCK];"]
        last.append(self.functions.forward(ins, out, f"w + {top.at}", h, "y", offset=f"w + {top.bias_at}", rows="out"))
        if rated:
            last.append(self.functions.forward(ins, out, f"w + {top.at}", r, "y_rate", rows="out"))
        for row, state in enumerate(states):
            last.append(f"real* const z{state} = p->z[{state}] + lane * {length}L + at;")
            last.append(f"for (int b = 0; b < {self.block}; ++b) z{state}[b] = y[{row} * BLOCK + b];")
            if rated:
                behind = f"z{state}[{self.n} + b] = y_rate[{row} * BLOCK + b];"
                last.append(f"for (int b = 0; b < {self.block}; ++b) {behind}")
        last.append("}")
        return hidden, last, self._back(number, rated, states, below, rates_of_arguments)

    def _back(
        self, number: int, rated: bool, states: tuple[int, ...], below: list[tuple[str, str]], arguments: list[str]
    ) -> list[str]:
        layers = self.networks.layers[number]
        widest = max(layer.outputs for layer in layers)
        length = 2 * self.n if rated else self.n
        size = f"{widest} * BLOCK"
        rows = f"real __attribute__((aligned(64))) d[{size}], e[{size}], d_rate[{size}], e_rate[{size}];"
        lines = ["{", rows]
        for row, state in enumerate(states):
            lines.append(f"const real* const by{state} = p->by[{state}] + lane * {length}L + at;")
            for name, shift in (("d", 0), *((("d_rate", self.n),) if rated else ())):
                lines.append(
                    f"for (int b = 0; b < BLOCK; ++b) {name}[{row} * BLOCK + b] = "
                    f"b < {self.block} && at + b >= from ? by{state}[{shift} + (b < {self.block} ? b : 0)] : 0;"
                )
        d, e = "d", "e"
        for depth in range(len(layers) - 1, -1, -1):
            layer, (x, x_rate) = layers[depth], below[depth]
            i, o = layer.inputs, layer.outputs
            if depth == len(layers) - 2:
                lines.append("if (!p->frozen) {")
            lines.append(self.functions.outer(i, o, d, x, f"sums + {layer.at}"))
            if rated:
                lines.append(self.functions.outer(i, o, f"{d}_rate", x_rate, f"sums + {layer.at}"))
            lines.append(f"row_sums({o}, {d}, sums + {layer.bias_at});")
            if depth == 0:
                continue
            inner = [self.functions.backward(i, o, f"w + {layer.at}", d, e, rows="out")]
            if rated:
                inner.append(self.functions.backward(i, o, f"w + {layer.at}", f"{d}_rate", f"{e}_rate", rows="out"))
                inner.append(f"rated_slope({i}, {x}, {arguments[depth - 1]}, {e}, {e}_rate);")
            else:
                inner.append(f"tanh_slope({i}, {x}, {e});")
            lines += ["if (!p->frozen) {", *inner, "}"] if depth == len(layers) - 1 else inner
            d, e = e, d
        lines += ["}", "}"]
        return lines
