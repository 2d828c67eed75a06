"""C functions of layers of fixed sizes over `networks.c`; each size is compiled once, however often it is called."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

_ROWS = "real* restrict"


class NetworkFunctions:
    """The functions that a text calls, written when they are first asked for."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def source(self) -> str:
        """All of them."""
        return "\n".join(self._texts.values())

    def forward(self, inputs: int, outputs: int, w: str, x: str, y: str, *, offset: str = "", rows: str = "in") -> str:
        """A call: rows y from rows x.

        Args:
            inputs, outputs: of the layer.
            w: its weights.
            x, y: rows.
            offset: of the biases behind the weights; none without.
            rows: what a row of the matrix belongs to: "in", (in, out) as of the maps; "out", (out, in).
        """
        strides = (outputs, 1) if rows == "in" else (1, inputs)
        return self._product(inputs, outputs, strides, w, offset, x, y)

    def backward(self, inputs: int, outputs: int, w: str, by_y: str, by_x: str, *, rows: str = "in") -> str:
        """A call: gradients by the inputs' rows from those by the outputs' rows."""
        strides = (1, outputs) if rows == "in" else (inputs, 1)
        return self._product(outputs, inputs, strides, w, "", by_y, by_x)

    def _product(self, n_in: int, n_out: int, strides: tuple[int, int], w: str, offset: str, x: str, y: str) -> str:
        name = f"product_{n_in}_{n_out}_{strides[0]}_{strides[1]}{'_offset' if offset else ''}"
        told = "offset" if offset else "0"
        self._add(
            name, f"const real* w, const real* offset, const {_ROWS} x, {_ROWS} y",
            f"product({n_in}, {n_out}, w, {strides[0]}, {strides[1]}, {told}, x, y);",
        )  # fmt: skip
        return f"{name}({w}, {offset or 0}, {x}, {y});"

    def outer(self, inputs: int, outputs: int, by_y: str, x: str, sums: str) -> str:
        """A call: the gradient by the weights (out, in) is added to their sums."""
        name = f"outer_{outputs}_{inputs}"
        self._add(
            name, f"const {_ROWS} d, const {_ROWS} x, vec* restrict sums",
            f"outer({outputs}, {inputs}, d, x, sums);",
        )  # fmt: skip
        return f"{name}({by_y}, {x}, {sums});"

    def network(self, name: str, widths: Sequence[int], activation: str) -> None:
        """A function of a network of one output: rows of its inputs to rows of value and slopes.

        Args:
            name: of the function.
            widths: of all layers, input and output included; weights (in, out) and biases of a layer follow each other.
            activation: "tanh" or "algebraic".
        """
        forth: list[str] = []
        back: list[str] = []
        at, last = 0, len(widths) - 2
        for k, (i, o) in enumerate(pairwise(widths)):
            x, y = f"h{k - 1}" if k else "x", "y" if k == last else f"h{k}"
            forth.append(self.forward(i, o, f"w + {at}", x, y, offset=f"w + {at + i * o}"))
            if k < last:
                forth.append(f"{activation}_rows({o}, {y});")
            slope = [f"{activation}_slope({i}, {x}, d{k});"] if k else []
            into = f"d{k}" if k else "y + BLOCK"
            by = f"d{k + 1}" if k < last else "one"
            back = [self.backward(i, o, f"w + {at}", by, into), *slope, *back]
            at += (i + 1) * o
        rows = ", ".join(f"h{k}[{o} * BLOCK], d{k + 1}[{o} * BLOCK]" for k, o in enumerate(widths[1:-1]))
        self._add(
            name, f"const real* w, const {_ROWS} x, {_ROWS} y",
            f"real __attribute__((aligned(64))) one[BLOCK], {rows};\nfor (int b = 0; b < BLOCK; ++b) one[b] = 1;\n"
            + "\n".join([*forth, *back]),
        )  # fmt: skip

    def _add(self, name: str, arguments: str, body: str) -> None:
        text = f"static __attribute__((noinline)) void {name}({arguments}) {{\n{body}\n}}"
        self._texts.setdefault(name, text)
