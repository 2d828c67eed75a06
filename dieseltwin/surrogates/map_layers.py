"""Evaluation of small networks: numpy, torch, and torch with slopes in closed form.

Layers are weights (in, out) or (R, in, out) and biases (out,) or (R, 1, out) of R realisations; points are (..., n, in)
or (..., R, n, in).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dieseltwin.networks import ACTIVATIONS

Layer = tuple[Tensor, Tensor]


def _sigmoid_like(z: Tensor, activation: str) -> tuple[Tensor, Tensor]:
    """Activation and its slope."""
    if activation == "tanh":
        a = torch.tanh(z)
        return a, 1.0 - a * a
    r = torch.rsqrt(1.0 + z * z)
    return z * r, r * r * r


def network(x: Tensor, layers: Sequence[Layer], activation: str) -> Tensor:
    """Output (..., n) at points (..., n, in); differentiable as often as wished."""
    act = ACTIVATIONS[activation]
    for weight, bias in layers[:-1]:
        x = act(torch.matmul(x, weight) + bias)
    weight, bias = layers[-1]
    return (torch.matmul(x, weight) + bias)[..., 0]


def network_and_slopes(x: Tensor, layers: Sequence[Layer], activation: str) -> tuple[Tensor, Tensor]:
    """Output (..., n) and its derivatives by the inputs (..., n, in), by one pass forth and one back."""
    slopes: list[Tensor] = []
    for weight, bias in layers[:-1]:
        x, slope = _sigmoid_like(torch.matmul(x, weight) + bias, activation)
        slopes.append(slope)
    weight, bias = layers[-1]
    value = (torch.matmul(x, weight) + bias)[..., 0]
    delta = weight.transpose(-1, -2) * slopes[-1]
    for number in range(len(layers) - 2, 0, -1):
        delta = torch.matmul(delta, layers[number][0].transpose(-1, -2)) * slopes[number - 1]
    return value, torch.matmul(delta, layers[0][0].transpose(-1, -2))


class ClosedForm(torch.autograd.Function):
    """`network` whose first derivatives are computed together with its value.

    Every later derivative, forward or backward, along however many directions, is a product with these slopes. Second
    derivatives are refused (`once_differentiable`), not silently wrong.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(x: Tensor, activation: str, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        layers = list(zip(tensors[::2], tensors[1::2], strict=True))
        return network_and_slopes(x, layers, activation)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        slopes = output[1]
        ctx.mark_non_differentiable(slopes)
        ctx.save_for_backward(slopes)
        ctx.save_for_forward(slopes)
        ctx.n_inputs = len(inputs)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_value: Tensor, by_slopes: Any) -> tuple[Any, ...]:
        (slopes,) = ctx.saved_tensors
        return (by_value[..., None] * slopes, *([None] * (ctx.n_inputs - 1)))

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *others: Any) -> tuple[Tensor, None]:
        (slopes,) = ctx.saved_tensors
        return (tangent * slopes).sum(-1), None


def closed_form(x: Tensor, layers: Sequence[Layer], activation: str) -> Tensor:
    """As `network`, cheaper where first derivatives are taken."""
    tensors = [t for layer in layers for t in layer]
    return ClosedForm.apply(x, activation, *tensors)[0]


def numpy_network(x: np.ndarray, layers: Sequence[tuple[np.ndarray, np.ndarray]], activation: str) -> np.ndarray:
    """As `network`, for arrays."""
    for weight, bias in layers[:-1]:
        z = np.matmul(x, weight) + bias
        x = np.tanh(z) if activation == "tanh" else z / np.sqrt(1.0 + z * z)
    weight, bias = layers[-1]
    return (np.matmul(x, weight) + bias)[..., 0]
