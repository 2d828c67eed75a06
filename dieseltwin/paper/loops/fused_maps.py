"""Learned maps inside the Adam loop: one tensor program for all runs, each with its own dropout realisations.

Dropout stays on (paper). Fresh realisations in every epoch are what a dropout layer does; the paper's spread of 0.03 %
in A_vgtmax over 30 runs on clean data would be impossible with one realisation a run, nearly half of which lack a
neuron of that map. A realisation holds for all points of a run, as of one engine, and is drawn from a bank, so that an
epoch costs a look-up.

A hidden tanh layer is a sigmoid layer with other weights, tanh(z) = 2 sigmoid(2 z) - 1; torch has a float32 sigmoid at
a sixth of the cost. Slopes are computed with the values, so that nothing of a network is kept for autograd. A map
whose inputs don't depend on the unknowns (f_egr of the known valve position) is evaluated once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps

BANK = 512
"""Realisations of each map that the epochs draw from: 230 of them lack a neuron or more (three layers of 20)."""
BLOCK = 512
"""Epochs whose draws are made at once."""
Layer = tuple[Tensor, Tensor]


def as_sigmoid_layers(layers: Sequence[Layer]) -> list[Layer]:
    """Weights of the sigmoid network that equals a tanh network, (.., in, out) and (.., 1, out)."""
    result = []
    last = len(layers) - 1
    for number, (weight, bias) in enumerate(layers):
        w, b = weight, bias
        if number > 0:  # the inputs are now (tanh + 1) / 2
            b = b - w.sum(-2, keepdim=True)
            w = 2.0 * w
        if number < last:
            w, b = 2.0 * w, 2.0 * b
        result.append((w.contiguous(), b.contiguous()))
    return result


class _SigmoidNetwork(torch.autograd.Function):
    """Value of a sigmoid network at (.., n, in); its slopes are found on the way, unless no gradient is wanted."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, count: int, *tensors: Tensor) -> Tensor:
        layers = [(tensors[2 * i], tensors[2 * i + 1]) for i in range(count)]
        slopes: list[Tensor] = []
        h = x
        for weight, bias in layers[:-1]:
            h = torch.sigmoid_(torch.matmul(h, weight).add_(bias))
            slopes.append(torch.addcmul(h, h, h, value=-1.0))
        weight, bias = layers[-1]
        value = (torch.matmul(h, weight) + bias).squeeze(-1)
        delta = slopes[-1].mul_(weight.transpose(-1, -2))
        for number in range(count - 2, 0, -1):
            delta = torch.matmul(delta, layers[number][0].transpose(-1, -2)).mul_(slopes[number - 1])
        ctx.save_for_backward(torch.matmul(delta, layers[0][0].transpose(-1, -2)))
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Any) -> tuple[Any, ...]:
        (slopes,) = ctx.saved_tensors
        return (gradients[0].unsqueeze(-1) * slopes, *([None] * (len(ctx.needs_input_grad) - 1)))


class Dropout:
    """Realisations of the lanes' maps, drawn anew in every epoch; a lane's draws depend on its seed alone.

    Attributes:
        layers: map name -> tensors of the present realisations (L, ..), changed in place by `draw`.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self.layers: dict[str, list[Tensor]] = {}
        self._banks: dict[str, list[tuple[Tensor, Tensor | None]]] = {}
        self._draws = [np.random.default_rng([seed, BANK]) for seed in seeds]
        self._block = np.empty((0, len(seeds), 0), dtype=np.int64)
        self._epoch = 0

    def add(self, name: str, bank: Sequence[Tensor], rows: Tensor | None = None) -> list[Tensor]:
        """Tensors (L, ..) that follow the draws.

        Args:
            name: of the map.
            bank: tensors (BANK, ..), or (S, BANK, ..) with `rows`.
            rows: (L,) first index of each lane.
        """
        self._banks[name] = [(tensor, rows) for tensor in bank]
        first = torch.zeros(len(self._draws), dtype=torch.int64)
        self.layers[name] = [t[first] if rows is None else t[rows, first] for t in bank]
        return self.layers[name]

    def draw(self) -> None:
        """Take the next epoch's realisations."""
        if self._epoch == len(self._block):
            drawn = [rng.integers(BANK, size=(BLOCK, len(self._banks))) for rng in self._draws]
            self._block, self._epoch = np.stack(drawn, 1), 0
        chosen = torch.from_numpy(self._block[self._epoch])
        self._epoch += 1
        for number, (name, bank) in enumerate(self._banks.items()):
            for target, (source, rows) in zip(self.layers[name], bank, strict=True):
                if rows is None:
                    torch.index_select(source, 0, chosen[:, number], out=target)
                else:
                    target.copy_(source[rows, chosen[:, number]])


def fused_replacements(
    maps: EmpiricalMaps, members: Sequence[int], u_egr: Tensor, constants: Any, dtype: torch.dtype = torch.float32,
    dropout: Dropout | None = None,
) -> dict[str, Callable[..., Tensor]]:  # fmt: skip
    """Functions for ``bind("torch", replace=...)``, for L lanes with a member (or dropout realisations) each.

    Args:
        maps: `surrogates.empirical.EmpiricalMaps`.
        members: one number for each lane.
        u_egr: (L, n) valve position, known before the loop [%].
        constants: engine constants.
        dtype: of weights and results.
        dropout: takes the maps' realisations and renews them; None: member `members` stays as it is.

    Returns:
        Map name -> function of the engine's signature.
    """
    from dieseltwin.surrogates.empirical_forms import bound_forms

    forms = bound_forms(maps.kind, "torch")
    plain = maps.replacements("torch", member=list(members), dtype=dtype)
    if dropout is not None:
        [opening] = dropout.add("f_egr", *_openings(maps, u_egr, constants, dtype))
    else:
        opening = plain["f_egr"](u_egr, constants).detach()
    result: dict[str, Callable[..., Tensor]] = {"f_egr": lambda u, c: opening}
    for name, function in plain.items():
        if name == "f_egr":
            continue
        item = maps.maps[name]
        if item.network.activation != "tanh":
            result[name] = maps.replacements("torch", member=list(members), dtype=dtype, slopes=True)[name]
            continue
        numbers = list(members) if dropout is None else list(range(1, BANK + 1))
        tensors = [t for layer in as_sigmoid_layers(maps.layers(name, numbers, dtype)) for t in layer]
        if dropout is not None:
            tensors = dropout.add(name, tensors)
        result[name] = _fused(forms[name], tensors, item.low, item.high, function.__name__)
    return result


def _openings(maps: EmpiricalMaps, u_egr: Tensor, constants: Any, dtype: torch.dtype) -> tuple[list[Tensor], Tensor]:
    """f_egr (S, BANK, n) of the S different valve positions among (L, n), and the lanes' rows (L,) in it."""
    different, rows = torch.unique(u_egr, dim=0, return_inverse=True)
    bank = maps.replacements("torch", member=list(range(1, BANK + 1)), dtype=dtype)["f_egr"]
    with torch.no_grad():
        return [torch.stack([bank(one.expand(BANK, -1), constants) for one in different])], rows


def _fused(form: Any, tensors: list[Tensor], low: Any, high: Any, name: str) -> Callable[..., Tensor]:
    limited = bool((low > -float("inf")).any() or (high < float("inf")).any())

    def evaluate(*arguments: Any) -> Tensor:
        inputs = torch.broadcast_tensors(*(torch.as_tensor(v, dtype=tensors[0].dtype) for v in form.inputs(*arguments)))
        if limited:
            inputs = [torch.clamp(v, float(a), float(b)) for v, a, b in zip(inputs, low, high, strict=True)]
        x = torch.stack(list(inputs), -1)
        return form.output(_SigmoidNetwork.apply(x, len(tensors) // 2, *tensors), tuple(inputs))

    evaluate.__name__ = name
    return evaluate
