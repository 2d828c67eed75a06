"""Causality DeepONet: an operator from an input's history to outputs that never see the future."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn

from dieseltwin.errors import InputError
from dieseltwin.networks.perceptron import MLP


@dataclass(frozen=True)
class DeepONetSizes:
    """Structure of a causality DeepONet.

    Attributes:
        input_hidden, initial_hidden, trunk_hidden: widths of the hidden layers.
        n_basis: number of terms in the sum.
        activation: of all hidden layers.
    """

    input_hidden: tuple[int, ...] = (40, 40)
    initial_hidden: tuple[int, ...] = (20,)
    trunk_hidden: tuple[int, ...] = (40, 40)
    n_basis: int = 40
    activation: str = "tanh"


class CausalityDeepONet(nn.Module):
    """Operator from an input signal u and initial values to outputs that never see the future (Liu et al. 2022).

    For each output there is one branch on the input's history and one on the initial value; one trunk on time is
    shared. At time t_i the input branch gets the row (u_i, u_{i-1}, ..., u_0, 0, ..., 0) of `n_times` entries: the rows
    of a window make a Toeplitz matrix, so the branch's first layer is a causal convolution. Outputs are
    G(u, y_0)(t_i) = T(b + sum_j input_branch_j(row_i) initial_branch_j(y_0) trunk_j(t_i)), with T a soft clip to [0, 1]
    (inputs, outputs and limits are scaled to [0, 1] by the caller).

    Args:
        n_times: samples in a window.
        outputs: number of outputs (each has two branches).
        sizes: of the branches and the trunk.
        clip_sharpness: of the soft clip, see `soft_clip`.
        memory: None for the paper's initial weights in the input branches. Else those of lag k fade as
            exp(-k / memory), keeping their total variance: most of a long history says nothing new.
        trunk_slopes: None for the paper's initial weights in the trunk. Else (low, high) slopes of its first layer per
            unit of scaled time, spread geometrically, each neuron switching within two of its own time constants
            of the window's start: initial values are forgotten within a few samples, which a smooth trunk cannot
            follow.
        generator: source of the initial weights.
    """

    def __init__(
        self,
        n_times: int,
        outputs: int,
        *,
        sizes: DeepONetSizes | None = None,
        clip_sharpness: float = 1000.0,
        memory: float | None = None,
        trunk_slopes: tuple[float, float] | None = None,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if n_times < 2 or outputs < 1:
            raise InputError("n_times, outputs", (n_times, outputs), ">= 2 and >= 1", "correct them")
        self.n_times = int(n_times)
        self.outputs = int(outputs)
        self.sizes = sizes = DeepONetSizes() if sizes is None else sizes
        self.clip_sharpness = float(clip_sharpness)
        self.memory = memory
        self.trunk_slopes = trunk_slopes

        def make(widths: Sequence[int]) -> MLP:
            return MLP(widths, sizes.activation, generator=generator, dtype=dtype)

        self.input_branches = nn.ModuleList(
            make((n_times, *sizes.input_hidden, sizes.n_basis)) for _ in range(outputs)
        )
        self.initial_branches = nn.ModuleList(
            make((1, *sizes.initial_hidden, sizes.n_basis)) for _ in range(outputs)
        )
        self.trunk = make((1, *sizes.trunk_hidden, sizes.n_basis))
        # between the limits, where the soft clip lets gradients through
        self.offset = nn.Parameter(torch.full((outputs,), 0.5, dtype=dtype))
        with torch.no_grad():
            if memory is not None:
                lags = torch.arange(n_times, dtype=dtype)[:, None]
                for branch in self.input_branches:
                    branch.weights[0].mul_(torch.exp(-lags / memory) * math.sqrt(n_times / memory))
            if trunk_slopes is not None:
                low, high = (math.log10(slope) for slope in trunk_slopes)
                weight, bias = self.trunk.weights[0], self.trunk.biases[0]
                slope = torch.logspace(high, low, weight.shape[1], dtype=dtype)
                switch = 2.0 * torch.rand(slope.shape, generator=generator, dtype=dtype) / slope
                weight.copy_(slope[None, :])
                bias.copy_((slope * (1.0 - switch))[None, :])

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "CausalityDeepONet",
            "n_times": self.n_times,
            "outputs": self.outputs,
            "input_hidden": list(self.sizes.input_hidden),
            "initial_hidden": list(self.sizes.initial_hidden),
            "trunk_hidden": list(self.sizes.trunk_hidden),
            "n_basis": self.sizes.n_basis,
            "activation": self.sizes.activation,
            "clip_sharpness": self.clip_sharpness,
            "memory": self.memory,
            "trunk_slopes": None if self.trunk_slopes is None else list(self.trunk_slopes),
            "dtype": str(self.offset.dtype).removeprefix("torch."),
        }

    @classmethod
    def from_spec(cls, **spec: Any) -> CausalityDeepONet:
        """A network of the structure that `spec` described."""
        own: dict[str, Any] = {f.name: spec.pop(f.name) for f in fields(DeepONetSizes)}
        for name in ("input_hidden", "initial_hidden", "trunk_hidden"):
            own[name] = tuple(own[name])
        return cls(sizes=DeepONetSizes(**own), **spec)

    def times(self) -> Tensor:
        """Sample times of a window scaled to [-1, 1], (n_times, 1)."""
        return torch.linspace(-1.0, 1.0, self.n_times, dtype=self.offset.dtype)[:, None]

    def rows(self, u: Tensor) -> Tensor:
        """Toeplitz rows of windows: (B, n) -> (B, n, n_times), newest sample first, zeros before the window."""
        if u.shape[-1] > self.n_times:
            raise InputError("window", f"{u.shape[-1]} samples", f"<= {self.n_times}", "cut it into windows")
        padded = nn.functional.pad(u, (self.n_times - 1, 0))
        return padded.unfold(-1, self.n_times, 1).flip(-1)

    def from_rows(self, rows: Tensor, initial: Tensor, time: Tensor) -> Tensor:
        """Outputs for rows of histories.

        Args:
            rows: (..., n_times) scaled histories, newest sample first.
            initial: (..., outputs) or a shape that broadcasts, scaled initial values of the window.
            time: (..., 1) or a shape that broadcasts, time since the window's start, scaled to [-1, 1].

        Returns:
            (..., outputs), within [0, 1].
        """
        trunk = self.trunk(time)
        columns = []
        for k in range(self.outputs):
            terms = self.input_branches[k](rows) * self.initial_branches[k](initial[..., k : k + 1]) * trunk
            columns.append(terms.sum(-1) + self.offset[k])
        return soft_clip(torch.stack(columns, dim=-1), self.clip_sharpness)

    def last_layer_design(self, k: int, rows: Tensor, initial: Tensor, time: Tensor) -> Tensor:
        """Design matrix of output k before the soft clip, less the offset, in the last layer of its input branch.

        Args:
            k: number of the output; `rows`, `initial`, `time` as in `from_rows`, with one leading dimension n.

        Returns:
            (n, (m + 1) n_basis), m the width of that layer's input; times `last_layer(k)` flattened it is the output.
        """
        hidden = self.input_branches[k].hidden_output(rows)
        hidden = torch.cat([hidden, torch.ones_like(hidden[:, :1])], dim=1)
        gate = self.initial_branches[k](initial[..., k : k + 1]) * self.trunk(time)
        return (hidden[:, :, None] * gate[:, None, :]).flatten(1)

    def last_layer(self, k: int) -> Tensor:
        """Weights and, as the last row, biases of the last layer of output k's input branch, (m + 1, n_basis)."""
        branch = self.input_branches[k]
        return torch.cat([branch.weights[-1], branch.biases[-1]]).detach()

    def set_last_layer(self, k: int, values: Tensor) -> None:
        """Replace what `last_layer` gives."""
        branch = self.input_branches[k]
        with torch.no_grad():
            branch.weights[-1].copy_(values[:-1])
            branch.biases[-1].copy_(values[-1:])

    def forward(self, u: Tensor, initial: Tensor) -> Tensor:
        """Windows (B, n) with initial values (B, outputs), both scaled to [0, 1] -> (B, n, outputs)."""
        return self.from_rows(self.rows(u), initial[:, None, :], self.times()[: u.shape[-1]])


def soft_clip(z: Tensor, sharpness: float = 1000.0) -> Tensor:
    """Smooth limiter to [0, 1]: softplus(z) - softplus(z - 1) with `sharpness`; the identity well inside.

    Unlike a sigmoid it leaves a linear operator linear between the limits; it is 0.69 / sharpness off at a limit.
    """
    softplus = nn.functional.softplus
    # softplus falls back on its linear branch above `threshold`; 40 keeps that switch below float64 rounding
    return softplus(z, sharpness, 40.0) - softplus(z - 1.0, sharpness, 40.0)


def soft_clip_slope(z: Tensor, sharpness: float = 1000.0) -> Tensor:
    """Derivative of `soft_clip`."""
    return torch.sigmoid(sharpness * z) - torch.sigmoid(sharpness * (z - 1.0))
