"""The four networks of the hybrid PINN, over lanes, with their time derivatives and gradients in closed form.

Source: paper, table "Neural network for PINN", row multi-stage TL: p_im and p_em share [1, 15, 15, 15, 2], x_r and T_1
have [1, 15, 15, 15, 1] each, omega_t [1, 15, 15, 1], all tanh. Input is the segment's time scaled to [-1, 1].

A value and its rate go through the layers together (forward mode), so nothing is differentiated by time in the loop,
and the gradient of both by the weights is written out by hand: two products and one transposed product a layer.
Points lie last, in one row of n values and n rates, which makes the products long and thin the right way round. A row
of ones carries the biases; a sixteenth row also makes the transposed product three times faster than fifteen. A tanh is
evaluated as 2 sigmoid(2 x) - 1, for which torch needs a sixth of the time; weights are kept in tanh's convention.

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


@dataclass(frozen=True)
class Activation:
    """Result of one hidden layer of sigmoids.

    Attributes:
        both: (L, k + 1, m) values, and rates behind them where wanted (m = n or 2 n); last a one, whose rate is 0.
        slope: (L, k, n) s (1 - s).
        rate_in: (L, k, n or 1) rate of the sigmoid's argument; None without rates.
        weight: (L, k + 1, in + 1) folded weights and biases that led here, and a row of zeros.
    """

    both: Tensor
    slope: Tensor
    rate_in: Tensor | None
    weight: Tensor


Hidden = list[list[Activation]]
"""Activations of each network's hidden layers."""


class StateNetworks:
    """Networks of L lanes on one sample grid.

    Args:
        time_s: (n,) sample times of the segment [s].
        specs: the networks; every state must come from one of them.
        dtype: of all tensors.
    """

    def __init__(
        self, time_s: ArrayLike, specs: Sequence[NetworkSpec] = PAPER_NETWORKS, dtype: torch.dtype = torch.float32
    ) -> None:
        t = np.asarray(time_s, dtype=np.float64)
        span = float(t[-1] - t[0])
        self.specs, self.dtype, self.n = tuple(specs), dtype, len(t)
        self.input = torch.tensor(2.0 * (t - t[0]) / span - 1.0, dtype=dtype)
        self.input_rate = 2.0 / span
        columns = torch.stack([self.input, torch.ones_like(self.input)], -1)
        rates = torch.stack([torch.full_like(self.input, self.input_rate), torch.zeros_like(self.input)], -1)
        self._inputs = [torch.cat([columns, rates]) if spec.rates else columns for spec in self.specs]
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

    def hidden(self, values: Tensor) -> Hidden:
        """Hidden layers of all networks.

        Args:
            values: (L, >= size) weights.

        Returns:
            Activations; while the hidden layers are frozen they stay as they are.
        """
        return [self._hidden_of(values, number) for number in range(len(self.specs))]

    def _hidden_of(self, values: Tensor, number: int) -> list[Activation]:
        n, rates = self.n, self.specs[number].rates
        result: list[Activation] = []
        for depth, layer in enumerate(self.layers[number][:-1]):
            k, weight = layer.outputs, _folded(layer, values, first=depth == 0, last=False)
            both = values.new_empty(values.shape[0], k + 1, 2 * n if rates else n)
            both[:, k, :n], both[:, k, n:] = 1.0, 0.0
            if depth == 0:
                argument = torch.addcmul(weight[:, :k, 1:], weight[:, :k, :1], self.input)
                rate_in = weight[:, :k, :1] * self.input_rate if rates else None
            else:
                product = torch.bmm(weight, result[-1].both)
                argument = product[:, :k, :n]
                rate_in = product[:, :k, n:] if rates else None
            s = torch.sigmoid(argument, out=both[:, :k, :n])
            slope = torch.addcmul(s, s, s, value=-1.0)
            if rate_in is not None:
                torch.mul(slope, rate_in, out=both[:, :k, n:])
            result.append(Activation(both, slope, rate_in, weight))
        return result

    def outputs(self, values: Tensor, hidden: Hidden) -> list[Tensor]:
        """Linear outputs z of p_im, p_em, omega_t, x_r, T_1.

        Args:
            values: (L, >= size) weights.
            hidden: of `hidden`.

        Returns:
            Five tensors (L, n), or (L, 2 n) with dz/dt [1/s] behind the values for networks with rates.
        """
        result: list[Tensor] = [self.input] * N_STATES
        for spec, rows, layers in zip(self.specs, hidden, self.layers, strict=True):
            z = torch.bmm(_folded(layers[-1], values, first=False, last=True), rows[-1].both)
            for row, state in enumerate(spec.states):
                result[state] = z[:, row]
        return result

    def gradient(
        self, values: Tensor, hidden: Hidden, by_outputs: Sequence[Tensor], out: Tensor, *, last_only: bool = False
    ) -> None:
        """Gradient of a scalar of each lane by its weights.

        Args:
            values: (L, >= size) weights.
            hidden: of `hidden`.
            by_outputs: five gradients by the results of `outputs`, of their shapes.
            out: (L, >= size), written; the hidden layers' columns are left alone with `last_only`.
            last_only: hidden layers are frozen.
        """
        for number, spec in enumerate(self.specs):
            layer, rows = self.layers[number][-1], hidden[number]
            upper = torch.stack([by_outputs[state] for state in spec.states], 1)
            by_folded = torch.bmm(upper, rows[-1].both.transpose(1, 2))
            _unfold(layer, by_folded, out, weight_factor=2.0, bias_factor=1.0)
            if not last_only:
                weight = _folded(layer, values, first=False, last=True)
                self._hidden_gradient(weight, upper, number, rows, out)

    def _hidden_gradient(self, weight: Tensor, upper: Tensor, number: int, rows: list[Activation], out: Tensor) -> None:
        n = self.n
        for depth in range(len(rows) - 1, -1, -1):
            row, layer = rows[depth], self.layers[number][depth]
            k = layer.outputs
            # The last row belongs to the ones: it meets only zeros and is not used, but makes a sixteenth.
            one = upper.shape[1] == 1
            by_both = weight.transpose(1, 2) * upper if one else torch.bmm(weight.transpose(1, 2), upper)
            by_value = by_both[:, :k, :n]
            if row.rate_in is not None:  # d(slope) / d(argument) = slope (1 - 2 s)
                by_rate = by_both[:, :k, n:]
                bend = by_rate * row.rate_in
                by_value.add_(bend).addcmul_(bend, row.both[:, :k, :n], value=-2.0)
                by_rate.mul_(row.slope)
            by_value.mul_(row.slope)
            if depth == 0:
                by_folded = torch.mm(by_both.view(-1, by_both.shape[-1]), self._inputs[number]).view(-1, k + 1, 2)
                layer.weight(out).copy_(2.0 * by_folded[:, :k, :1])
                layer.bias(out).copy_(2.0 * by_folded[:, :k, 1:])
            else:
                by_folded = torch.bmm(by_both, rows[depth - 1].both.transpose(1, 2))[:, :k]
                _unfold(layer, by_folded, out, weight_factor=4.0, bias_factor=2.0)
            weight, upper = row.weight, by_both


def _folded(layer: Layer, values: Tensor, *, first: bool, last: bool) -> Tensor:
    """Weights and biases (L, out, in + 1) for sigmoids on both sides of a layer: tanh(x) = 2 sigmoid(2 x) - 1.

    A hidden layer gets a row of zeros more, (L, out + 1, in + 1), see `Activation`.
    """
    weight, bias = layer.weight(values), layer.bias(values)
    shift = 0.0 if first else weight.sum(-1, keepdim=True)
    folded = torch.cat([weight if first else 2.0 * weight, bias - shift], -1)
    return folded if last else torch.nn.functional.pad(2.0 * folded, (0, 0, 0, 1))


def _unfold(layer: Layer, by_folded: Tensor, out: Tensor, *, weight_factor: float, bias_factor: float) -> None:
    """Write the gradient by a layer's weights and biases, given that by the folded ones (L, out, in + 1)."""
    by_bias = bias_factor * by_folded[..., -1:]
    torch.sub(weight_factor * by_folded[..., :-1], by_bias, out=layer.weight(out))
    layer.bias(out).copy_(by_bias)
