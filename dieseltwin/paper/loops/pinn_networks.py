"""The four networks of the hybrid PINN, over lanes, with their time derivatives.

Source: paper, table "Neural network for PINN", row multi-stage TL: p_im and p_em share [1, 15, 15, 15, 2], x_r and T_1
have [1, 15, 15, 15, 1] each, omega_t [1, 15, 15, 1], all tanh. Input is the segment's time scaled to [-1, 1].

A value and its rate go through the layers together (forward mode), so nothing is differentiated by time in the loop.
Here they are tensors, for autograd and for the runs that aren't compiled; `network_loops` writes the same as C.

Columns of a lane's weights: hidden layers of all networks first, last layers behind, so that freezing the hidden
layers leaves one contiguous block to train.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

N_STATES = 5
"""p_im, p_em, omega_t, x_r, T_1, in this order."""


@dataclass(frozen=True)
class NetworkSpec:
    """One network.

    Attributes:
        name: for messages.
        hidden: widths of the hidden layers.
        states: indices of the states that it gives, in the order p_im, p_em, omega_t, x_r, T_1.
        rates: whether their time derivatives are needed.
    """

    name: str
    hidden: tuple[int, ...]
    states: tuple[int, ...]
    rates: bool

    @property
    def widths(self) -> tuple[int, ...]:
        """Widths of all layers, input and output included."""
        return (1, *self.hidden, len(self.states))


PAPER_NETWORKS = (
    NetworkSpec("pressures", (15, 15, 15), (0, 1), True),
    NetworkSpec("x_r", (15, 15, 15), (3,), False),
    NetworkSpec("T_1", (15, 15, 15), (4,), False),
    NetworkSpec("omega_t", (15, 15), (2,), True),
)
"""Networks of the paper's table (multi-stage TL)."""


@dataclass(frozen=True)
class Layer:
    """Where one layer's weights stand in a lane's columns: (out, in) weights from `at`, (out,) biases behind."""

    at: int
    inputs: int
    outputs: int

    @property
    def bias_at(self) -> int:
        """Column of the first bias."""
        return self.at + self.inputs * self.outputs

    @property
    def end(self) -> int:
        """Column behind the last bias."""
        return self.bias_at + self.outputs

    def weight(self, values: Tensor) -> Tensor:
        """Weights (L, out, in), a view."""
        return values[:, self.at : self.bias_at].view(-1, self.outputs, self.inputs)

    def bias(self, values: Tensor) -> Tensor:
        """Biases (L, out, 1), a view."""
        return values[:, self.bias_at : self.end].view(-1, self.outputs, 1)


class StateNetworks:
    """Networks of L lanes on one sample grid.

    Args:
        time_s: (n,) sample times of the segment [s].
        dtype: of all tensors.
    """

    def __init__(self, time_s: ArrayLike, dtype: torch.dtype = torch.float32) -> None:
        t = np.asarray(time_s, dtype=np.float64)
        span = float(t[-1] - t[0])
        self.specs, self.dtype, self.n = PAPER_NETWORKS, dtype, len(t)
        self.input = torch.tensor(2.0 * (t - t[0]) / span - 1.0, dtype=dtype)
        self.input_rate = 2.0 / span
        self.layers: list[list[Layer]] = [[] for _ in self.specs]
        at = 0
        for rows, spec in zip(self.layers, self.specs, strict=True):
            for i, o in zip(spec.widths[:-2], spec.widths[1:-1], strict=True):
                rows.append(Layer(at, i, o))
                at = rows[-1].end
        self.hidden_size = at
        for rows, spec in zip(self.layers, self.specs, strict=True):
            rows.append(Layer(at, spec.widths[-2], spec.widths[-1]))
            at = rows[-1].end
        self.size = at

    def start(self, generator: torch.Generator, slopes: tuple[float, float] | None) -> Tensor:
        """Draw one lane's weights.

        Weights are N(0, 2 / (in + out)) and biases zero, as the paper has it for its other networks; it prints no start
        for these. With `slopes` the first layer's weights have sizes between the two (uniform in the logarithm) on time
        scaled to [-1, 1], and its tanhs are centred evenly over the segment. With the plain start all sit on the
        middle; after 8,000 epochs of `baseline` on one minute the states were 1.3 to 2.2 times further off (one run).

        Args:
            generator: source of the draws.
            slopes: smallest and largest slope of the first layer, None for the plain start.

        Returns:
            (size,) weights, float64.
        """
        values = torch.zeros(1, self.size, dtype=torch.float64)
        for rows in self.layers:
            for layer in rows:
                draw = torch.randn(layer.outputs, layer.inputs, generator=generator, dtype=torch.float64)
                layer.weight(values)[0] = draw * math.sqrt(2.0 / (layer.inputs + layer.outputs))
            if slopes is None:
                continue
            first = rows[0]
            low, high = math.log(slopes[0]), math.log(slopes[1])
            u = torch.rand(2, first.outputs, generator=generator, dtype=torch.float64)
            size = torch.exp(low + (high - low) * u[0])
            weight = torch.where(first.weight(values)[0, :, 0] < 0.0, -size, size)
            order = torch.randperm(first.outputs, generator=generator)
            centre = 2.0 * (order + u[1]) / first.outputs - 1.0
            first.weight(values)[0, :, 0] = weight
            first.bias(values)[0, :, 0] = -weight * centre
        return values[0]

    def outputs(self, values: Tensor) -> list[Tensor]:
        """Linear outputs z of p_im, p_em, omega_t, x_r, T_1.

        Args:
            values: (L, >= size) weights.

        Returns:
            Five tensors (L, n), or (L, 2 n) with dz/dt [1/s] behind the values for networks with rates.
        """
        result: list[Tensor] = [self.input] * N_STATES
        for spec, layers in zip(self.specs, self.layers, strict=True):
            h, rate = self.input.view(1, 1, -1), self.input.new_full((1, 1, self.n), self.input_rate)
            for layer in layers:
                weight = layer.weight(values)
                h = weight @ h + layer.bias(values)
                rate = weight @ rate if spec.rates else rate
                if layer is not layers[-1]:
                    h = torch.tanh(h)
                    rate = (1.0 - h * h) * rate if spec.rates else rate
            for row, state in enumerate(spec.states):
                result[state] = torch.cat([h[:, row], rate[:, row]], 1) if spec.rates else h[:, row]
        return result

    def gradient(self, values: Tensor, by_outputs: Sequence[Tensor], out: Tensor) -> None:
        """Write the gradient by the weights (L, >= size), given those by the results of `outputs`."""
        leaf = values[:, : self.size].detach().requires_grad_()
        with torch.enable_grad():
            z = self.outputs(leaf)
        out[:, : self.size] = torch.autograd.grad(z, leaf, by_outputs)[0]
