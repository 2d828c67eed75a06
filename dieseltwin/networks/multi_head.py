"""A body shared by many linear heads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from dieseltwin.errors import InputError
from dieseltwin.networks.perceptron import MLP

HEADS_GAIN = 10.0  # weights of the heads ~ N(0, gain / (in + out)): paper, section on the multi-head networks


class MultiHead(nn.Module):
    """A body shared by many linear heads: y(t) = h(t) W_out + b_out (paper, Eq. "Few shot output").

    Args:
        widths: (in, hidden ..., k, heads); k is the width of the last hidden layer, the number of basis functions.
        first_scale: None for the paper's initial weights in the first layer. Else the first layer is
            tanh(a (x - c)) with slopes a ~ +-U(scale_low, scale_high) and centres c spread evenly over [-1, 1]
            with a jitter: a body of well-conditioned, local bases.
    """

    def __init__(
        self,
        widths: Sequence[int],
        activation: str = "tanh",
        *,
        first_scale: tuple[float, float] | None = None,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if len(widths) < 3:
            raise InputError("MultiHead widths", list(widths), "(in, hidden ..., k, heads)", "correct them")
        self.widths = tuple(int(w) for w in widths)
        self.activation = activation
        self.first_scale = first_scale
        self.body = MLP(self.widths[:-1], activation, activate_last=True, generator=generator, dtype=dtype)
        self.head = MLP(self.widths[-2:], last_gain=HEADS_GAIN, generator=generator, dtype=dtype)
        if first_scale is not None:
            self._spread_first_layer(first_scale, generator)

    def _spread_first_layer(self, scale: tuple[float, float], generator: torch.Generator | None) -> None:
        weight, bias = self.body.weights[0], self.body.biases[0]
        if weight.shape[0] != 1:
            raise InputError("first_scale", f"{weight.shape[0]} inputs", "a scalar input", "leave it out")
        n = weight.shape[1]
        low, high = scale
        uniform = torch.rand((3, n), generator=generator, dtype=weight.dtype)
        slope = (low + (high - low) * uniform[0]) * torch.where(uniform[1] < 0.5, -1.0, 1.0).to(weight.dtype)
        # centres reach a little beyond the interval, so that its ends are as well covered as its middle
        grid = torch.linspace(-1.0, 1.0, n, dtype=weight.dtype) * (1.0 + 1.0 / n)
        centre = grid + (uniform[2] - 0.5) * (2.0 / n)
        with torch.no_grad():
            weight.copy_(slope[None, :])
            bias.copy_((-slope * centre)[None, :])

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "MultiHead",
            "widths": list(self.widths),
            "activation": self.activation,
            "first_scale": None if self.first_scale is None else list(self.first_scale),
            "dtype": str(self.body.weights[0].dtype).removeprefix("torch."),
        }

    def forward(self, x: Tensor) -> Tensor:
        """(n, in) -> (n, heads), before any output transformation."""
        return self.head(self.body(x))

    def basis(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Last hidden layer h (n, k) and its derivative dh/dx (n, k), exact.

        Args:
            x: (n, 1), a scalar input.
        """
        if self.widths[0] != 1:
            raise InputError("basis", f"{self.widths[0]} inputs", "a scalar input", "differentiate otherwise")
        return self.body.along(x, torch.ones_like(x))


