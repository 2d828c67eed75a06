"""Learned maps inside the Adam loops: one tensor program for all runs, each with its own dropout realisations.

Dropout stays on (paper) and is drawn anew in every epoch: the paper's spread of 0.03 % in A_vgtmax over 30 runs on
clean data would be impossible with one realisation a run, nearly half of which lack a neuron of that map. A dropout
layer draws a mask for every row, too; here a realisation holds for all points of a run, as of one engine, and is drawn
from a bank, so that an epoch costs a look-up. A minute's mean of a map then scatters ten times as far between epochs
(docs/methods.md); the mean over epochs that is the estimate takes most of that out.

A network is one operation of the tensor program, whose results are its value and its slopes by the inputs: nothing of
it is kept for autograd, and the compiled loop (`point_loops`) writes it as C. A map whose inputs don't depend on the
unknowns (f_egr of the known valve position) is evaluated once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from dieseltwin.engine.binding import MAPS
from dieseltwin.surrogates.empirical_forms import bound_forms
from dieseltwin.surrogates.map_layers import Layer, network_and_slopes

if TYPE_CHECKING:
    from dieseltwin.surrogates.empirical import EmpiricalMaps, MapNetwork

BANK = 512
"""Realisations of each map that the epochs draw from: 230 of them lack a neuron or more (three layers of 20)."""
BLOCK = 512
"""Epochs whose draws are made at once."""


@torch.library.custom_op("dieseltwin::small_network", mutates_args=())
def small_network(inputs: list[Tensor], weights: Tensor, widths: list[int], activation: str) -> list[Tensor]:
    """Value of a network of one output and its slopes by the inputs, each (L, n).

    Args:
        inputs: each (L, n).
        weights: (L, size) of all layers: weights (in, out) and biases (out,) each.
        widths: of all layers, inputs and output included.
        activation: "tanh" or "algebraic".
    """
    layers, at = [], 0
    for i, o in pairwise(widths):
        matrix, bias = weights[:, at : at + i * o], weights[:, at + i * o : at + (i + 1) * o]
        layers.append((matrix.reshape(-1, i, o), bias[:, None]))
        at += (i + 1) * o
    value, slopes = network_and_slopes(torch.stack(inputs, -1), layers, activation)
    return [value.clone(), *(slope.clone() for slope in slopes.unbind(-1))]


class _Network(torch.autograd.Function):
    """`small_network`'s value, differentiable once."""

    @staticmethod
    def forward(ctx: Any, weights: Tensor, widths: list[int], activation: str, *inputs: Tensor) -> Tensor:
        value, *slopes = small_network(list(inputs), weights, widths, activation)
        ctx.save_for_backward(*slopes)
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *gradients: Any) -> tuple[Any, ...]:
        return (None, None, None, *(gradients[0] * slope for slope in ctx.saved_tensors))


def flat_layers(layers: Sequence[Layer]) -> Tensor:
    """Weights of R realisations, (R, in, out) and (R, 1, out) a layer, in one row each."""
    return torch.cat([t.flatten(1) for layer in layers for t in layer], 1)


class Dropout:
    """Realisations of the lanes' maps, drawn anew in every epoch; a lane's draws depend on its seed alone.

    Attributes:
        rows: map name -> the present realisations (L, ..), changed in place by `draw`.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self.rows: dict[str, Tensor] = {}
        self._banks: dict[str, tuple[Tensor, Tensor]] = {}
        self._draws = [np.random.default_rng([seed, BANK]) for seed in seeds]
        self._block = np.empty((0, len(seeds), 0), dtype=np.int64)
        self._epoch = 0

    def add(self, name: str, bank: Tensor, which: Tensor | None = None) -> Tensor:
        """A tensor (L, ..) that follows the draws.

        Args:
            name: of the map.
            bank: (BANK, ..), or (S, BANK, ..) with `which`.
            which: (L,) first index of each lane.
        """
        first = torch.zeros(len(self._draws), dtype=torch.int64) if which is None else which * BANK
        self._banks[name] = (bank if which is None else bank.flatten(0, 1)), first
        self.rows[name] = self._banks[name][0][first]
        return self.rows[name]

    def draw(self) -> None:
        """Take the next epoch's realisations."""
        if self._epoch == len(self._block):
            drawn = [rng.integers(BANK, size=(BLOCK, len(self._banks))) for rng in self._draws]
            self._block, self._epoch = np.stack(drawn, 1), 0
        chosen = torch.from_numpy(self._block[self._epoch])
        self._epoch += 1
        for number, (name, (bank, first)) in enumerate(self._banks.items()):
            torch.index_select(bank, 0, first + chosen[:, number], out=self.rows[name])


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
    forms = bound_forms(maps.kind, "torch")
    if dropout is not None:
        opening = dropout.add("f_egr", *_openings(maps, u_egr, constants, dtype))
    else:
        plain = maps.replacements("torch", member=list(members), dtype=dtype)
        opening = plain["f_egr"](u_egr, constants).detach()
    result: dict[str, Callable[..., Tensor]] = {"f_egr": lambda u, c: opening}
    for name in (name for name in MAPS if name != "f_egr"):
        numbers = list(members) if dropout is None else list(range(1, BANK + 1))
        weights = flat_layers(maps.layers(name, numbers, dtype))
        result[name] = _fused(forms[name], weights if dropout is None else dropout.add(name, weights), maps.maps[name])
    return result


def _openings(maps: EmpiricalMaps, u_egr: Tensor, constants: Any, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """f_egr (S, BANK, n) of the S different valve positions among (L, n), and the lanes' rows (L,) in it."""
    different, rows = torch.unique(u_egr, dim=0, return_inverse=True)
    bank = maps.replacements("torch", member=list(range(1, BANK + 1)), dtype=dtype)["f_egr"]
    with torch.no_grad():
        return torch.stack([bank(one.expand(BANK, -1), constants) for one in different]), rows


def _fused(form: Any, weights: Tensor, item: MapNetwork) -> Callable[..., Tensor]:
    widths, activation = [int(w) for w in item.network.widths], item.network.activation
    limited = bool((item.low > -float("inf")).any() or (item.high < float("inf")).any())

    def evaluate(*arguments: Any) -> Tensor:
        inputs = torch.broadcast_tensors(*(torch.as_tensor(v, dtype=weights.dtype) for v in form.inputs(*arguments)))
        if limited:
            limits = zip(inputs, item.low, item.high, strict=True)
            inputs = [torch.clamp(v, float(a), float(b)) for v, a, b in limits]
        return form.output(_Network.apply(weights, widths, activation, *inputs), tuple(inputs))

    return evaluate
