"""Perceptrons with dropout that stays on, one or many stacked in one tensor program."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from dieseltwin.errors import InputError

ACTIVATIONS: Mapping[str, Callable[[Tensor], Tensor]] = {
    "tanh": torch.tanh,
    "sin": torch.sin,
    "relu": torch.relu,
    "silu": nn.functional.silu,
    "softplus": nn.functional.softplus,
    "algebraic": lambda z: z * torch.rsqrt(1.0 + z * z),  # a sigmoid of one root and one division: quick when compiled
    "identity": lambda z: z,
}
HIDDEN_GAIN = 2.0  # weights ~ N(0, gain / (in + out)): paper, section on the multi-head networks


class MLP(nn.Module):
    """Fully connected network, or `members` of them stacked in one tensor program.

    Args:
        widths: (in, hidden ..., out) number of neurons of each layer.
        activation: name in ACTIVATIONS, used after each layer but the last (see `activate_last`).
        dropout: share of hidden neurons switched off. It stays on in `eval()` mode too, as in the paper.
        members: None for a single network, else the number of stacked networks of equal widths.
        last_gain: weights of the last layer are drawn from N(0, last_gain / (in + out)).
        activate_last: apply the activation after the last layer too (the body of a multi-head network).
        generator: source of the initial weights; the global one of torch where None.
        dtype: of the weights.

    Shapes: x is (..., n, in), or (n, in) shared by all members; the result is (..., n, out), with members
    (members, n, out).
    """

    def __init__(
        self,
        widths: Sequence[int],
        activation: str = "tanh",
        dropout: float = 0.0,
        *,
        members: int | None = None,
        last_gain: float = HIDDEN_GAIN,
        activate_last: bool = False,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        super().__init__()
        if len(widths) < 2 or any(int(w) < 1 for w in widths):
            raise InputError("MLP widths", list(widths), "two or more positive layer sizes", "correct the widths")
        if activation not in ACTIVATIONS:
            raise InputError("activation", repr(activation), sorted(ACTIVATIONS), "take one of these")
        if not 0.0 <= dropout < 1.0:
            raise InputError("dropout", dropout, "0 <= dropout < 1", "correct the share")
        self.widths = tuple(int(w) for w in widths)
        self.activation = activation
        self.dropout = float(dropout)
        self.members = members
        self.last_gain = float(last_gain)
        self.activate_last = activate_last
        stack = () if members is None else (int(members),)
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        last = len(self.widths) - 2
        for layer, (n_in, n_out) in enumerate(zip(self.widths[:-1], self.widths[1:], strict=True)):
            gain = self.last_gain if layer == last else HIDDEN_GAIN
            draw = torch.randn((*stack, n_in, n_out), generator=generator, dtype=dtype)
            self.weights.append(nn.Parameter(draw * math.sqrt(gain / (n_in + n_out))))
            self.biases.append(nn.Parameter(torch.zeros((*stack, 1, n_out), dtype=dtype)))

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.widths[1:-1]

    def spec(self) -> dict[str, Any]:
        """Plain JSON from which `network_from_spec` makes a network of the same structure."""
        return {
            "kind": "MLP",
            "widths": list(self.widths),
            "activation": self.activation,
            "dropout": self.dropout,
            "members": self.members,
            "last_gain": self.last_gain,
            "activate_last": self.activate_last,
            "dtype": str(self.weights[0].dtype).removeprefix("torch."),
        }

    def sample_masks(
        self, lead: Sequence[int] = (), *, generator: torch.Generator | None = None
    ) -> tuple[Tensor, ...]:
        """One dropout realisation: a mask for each hidden layer, 0 or 1 / (1 - dropout).

        Args:
            lead: leading shape of the masks. () gives (width,) for a single network and (members, 1, width) for a
                stacked one: the same neurons are off for all rows, as one realised engine. (runs, 1) gives each of
                `runs` batches its own realisation; (n,) a fresh one for each of n rows.
            generator: source of the draws.
        """
        if not lead and self.members is not None:
            lead = (self.members, 1)
        keep = 1.0 - self.dropout
        reference = self.weights[0]
        masks = []
        for width in self.hidden:
            uniform = torch.rand((*lead, width), generator=generator, dtype=reference.dtype)
            masks.append((uniform < keep).to(reference.dtype) / keep)
        return tuple(masks)

    def forward(self, x: Tensor, *, generator: torch.Generator | None = None) -> Tensor:
        """Evaluate the network, with a fresh mask for each row and hidden layer where dropout > 0.

        Args:
            x: (..., n, in).
            generator: source of the masks.
        """
        act = ACTIVATIONS[self.activation]
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            # bias is (1, out), and (members, 1, out) for a stack, which broadcasts against (..., n, out)
            x = torch.matmul(x, weight) + bias
            if layer < last:
                x = act(x)
                if self.dropout > 0.0:
                    keep = 1.0 - self.dropout
                    uniform = torch.rand(x.shape, generator=generator, dtype=x.dtype)
                    x = x * ((uniform < keep).to(x.dtype) / keep)
            elif self.activate_last:
                x = act(x)
        return x

    def along(self, x: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """Values (..., n, out) without dropout and their derivative along a direction of the input, both detached.

        Layer by layer, as forward-mode differentiation has it: torch's own loads its compiler first, which takes two
        seconds.

        Args:
            x, direction: (..., n, in).
        """
        act = ACTIVATIONS[self.activation]
        last = len(self.weights) - 1
        value, change = x.detach(), direction.detach()
        with torch.enable_grad():
            for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
                value = (torch.matmul(value, weight) + bias).detach()
                change = torch.matmul(change, weight).detach()
                if layer < last or self.activate_last:
                    inner = value.requires_grad_()
                    outer = act(inner)
                    (slope,) = torch.autograd.grad(outer.sum(), inner)
                    value, change = outer.detach(), slope * change
        return value, change

    def hidden_output(self, x: Tensor) -> Tensor:
        """Input of the last layer, (..., n, hidden[-1]), without dropout."""
        act = ACTIVATIONS[self.activation]
        for weight, bias in list(zip(self.weights, self.biases, strict=True))[:-1]:
            x = act(torch.matmul(x, weight) + bias)
        return x
