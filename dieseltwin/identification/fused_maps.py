"""Learned maps inside the Adam loop: one tensor program for all runs, each with its own dropout realisation.

A hidden tanh layer is a sigmoid layer with other weights, tanh(z) = 2 sigmoid(2 z) - 1; torch has a float32 sigmoid at
a sixth of the cost. Slopes are computed with the values, so that nothing of a network is kept for autograd. A map
whose inputs don't depend on the unknowns (f_egr of the known valve position) is evaluated once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

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


def fused_replacements(
    maps: Any, members: Sequence[int], u_egr: Tensor, constants: Any, dtype: torch.dtype = torch.float32
) -> dict[str, Callable[..., Tensor]]:
    """Functions for ``bind("torch", replace=...)``, for L lanes with a member (or dropout realisation) each.

    Args:
        maps: `surrogates.empirical.EmpiricalMaps`.
        members: one number for each lane.
        u_egr: (L, n) valve position, known before the loop [%].
        constants: engine constants.
        dtype: of weights and results.

    Returns:
        Map name -> function of the engine's signature.
    """
    from dieseltwin.surrogates.empirical_forms import bound_forms

    forms = bound_forms(maps.kind, "torch")
    plain = maps.replacements("torch", member=list(members), dtype=dtype)
    opening = plain["f_egr"](u_egr, constants).detach()
    result: dict[str, Callable[..., Tensor]] = {"f_egr": lambda u, c: opening}
    for name, function in plain.items():
        if name == "f_egr":
            continue
        item = maps.maps[name]
        if item.network.activation != "tanh":
            result[name] = maps.replacements("torch", member=list(members), dtype=dtype, slopes=True)[name]
            continue
        layers = as_sigmoid_layers(maps.layers(name, list(members), dtype))
        result[name] = _fused(forms[name], layers, item.low, item.high, function.__name__)
    return result


def _fused(form: Any, layers: list[Layer], low: Any, high: Any, name: str) -> Callable[..., Tensor]:
    tensors = [t for layer in layers for t in layer]
    limited = bool((low > -float("inf")).any() or (high < float("inf")).any())

    def evaluate(*arguments: Any) -> Tensor:
        inputs = torch.broadcast_tensors(*(torch.as_tensor(v, dtype=tensors[0].dtype) for v in form.inputs(*arguments)))
        if limited:
            inputs = [torch.clamp(v, float(a), float(b)) for v, a, b in zip(inputs, low, high, strict=True)]
        x = torch.stack(list(inputs), -1)
        return form.output(_SigmoidNetwork.apply(x, len(layers), *tensors), tuple(inputs))

    evaluate.__name__ = name
    return evaluate
