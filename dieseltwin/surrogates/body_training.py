"""Training of one multi-head body, as printed or with its heads eliminated (`surrogates.bodies` has the two kinds)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from dieseltwin.arrays import Array
from dieseltwin.networks import MultiHead
from dieseltwin.settings.params import BodiesConditionedConfig, BodiesPaperConfig
from dieseltwin.surrogates.output_transforms import TRANSFORMS

WINDOW_S = 60.0  # paper
WINDOW_ROWS = 301  # at 0.2 s: paper

_RIDGE = 1e-8  # keeps the Cholesky factor of the projection real; far below the bases' own size of 1
_LBFGS_HISTORY = 20


class TrainedBody(NamedTuple):
    """A network (float64), the shift (k,) and mix (k, k) that make its basis orthonormal, the training curve."""

    network: MultiHead
    shift: Array
    mix: Array
    curve: Array


def train_as_printed(
    widths: tuple[int, ...],
    states: Mapping[str, Array],
    config: BodiesPaperConfig,
    generator: torch.Generator,
    tell: Callable[[float], None] | None,
) -> TrainedBody:
    """Adam on the mean square error of the scaled outputs; float32, all points and heads in each epoch.

    Args:
        widths: of the network, heads included.
        states: (301, heads) minutes of each state of the body [SI].
        config: epochs and learning rate.
        generator: source of the initial weights.
        tell: called with the share done.
    """
    transform = TRANSFORMS[next(iter(states))]  # the two pressures share theirs
    y = np.concatenate(list(states.values()), axis=1)
    target = torch.as_tensor(y / transform.scale, dtype=torch.float32)
    network = MultiHead(widths, first_scale=config.first_layer_scale, generator=generator)
    with torch.no_grad():
        # the start of the biases is not printed; at zero, x_r would begin at 0.5, tenfold its size
        network.head.biases[0].copy_(torch.as_tensor(transform.linear(y).mean(axis=0)[None, :]))
    time = scaled_times().float()
    optimiser = torch.optim.Adam(network.parameters(), lr=config.rate)
    curve, every = [], max(1, config.epochs // 100)
    for epoch in range(config.epochs):
        optimiser.param_groups[0]["lr"] = _cosine(config.rate, epoch, config.epochs)
        loss = ((transform.scaled(network(time)) - target) ** 2).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        if (epoch + 1) % every == 0:
            curve.append((epoch + 1, float(loss.detach())))
            if tell is not None:
                tell((epoch + 1) / config.epochs)
    return TrainedBody(network.double(), np.zeros(widths[-2]), np.eye(widths[-2]), np.asarray(curve))


def train_by_projection(
    widths: tuple[int, ...],
    recordings: Mapping[str, Sequence[Array]],
    config: BodiesConditionedConfig,
    generator: torch.Generator,
    tell: Callable[[float], None] | None,
) -> TrainedBody:
    """Variable projection: Adam, then L-BFGS, on the log of the share of the windows that their best heads leave out.

    Args:
        widths: of the network, heads included; the heads are not trained here.
        recordings: states of each recording, by column, at 0.2 s [SI].
        config: epochs, learning rate, first layer.
        generator: source of the initial weights.
        tell: called with the share done.
    """
    network = MultiHead(widths, first_scale=config.first_layer_scale, generator=generator, dtype=torch.float64)
    moment = torch.as_tensor(second_moment(recordings))
    time, total = scaled_times(), torch.trace(moment)
    ridge = _RIDGE * torch.eye(widths[-2], dtype=torch.float64)
    curve: list[tuple[int, float]] = []

    def loss_of_body() -> Tensor:
        h = network.body(time)
        h = h - h.mean(dim=0)  # the constant is a basis function of its own, the bias
        factor = torch.linalg.cholesky(h.T @ h + ridge)
        q = torch.linalg.solve_triangular(factor, h.T, upper=False)
        return torch.log1p(-((q @ moment) * q).sum() / total)

    weights = list(network.body.parameters())
    adam = torch.optim.Adam(weights, lr=config.rate)
    for epoch in range(config.epochs):
        adam.param_groups[0]["lr"] = _cosine(config.rate, epoch, config.epochs)
        loss = loss_of_body()
        adam.zero_grad(set_to_none=True)
        loss.backward()
        adam.step()
        curve.append((epoch + 1, math.exp(float(loss.detach()))))
        if tell is not None:
            tell((epoch + 1) / (config.epochs + config.lbfgs_steps))
    if config.lbfgs_steps:
        lbfgs = torch.optim.LBFGS(
            weights,
            max_iter=config.lbfgs_steps,
            history_size=_LBFGS_HISTORY,
            line_search_fn="strong_wolfe",
            tolerance_grad=0.0,  # the number of steps decides, or runs of one seed would differ in length
            tolerance_change=0.0,
        )

        def closure() -> Tensor:
            lbfgs.zero_grad()
            loss = loss_of_body()
            loss.backward()
            return loss

        lbfgs.step(closure)
        curve.append((config.epochs + config.lbfgs_steps, math.exp(float(loss_of_body().detach()))))
    with torch.no_grad():
        h = network.body(time).numpy()
    shift = h.mean(axis=0)
    upper = np.linalg.qr(h - shift, mode="r")
    mix = np.linalg.inv(upper * np.sign(np.diag(upper))[:, None])
    return TrainedBody(network, shift, mix, np.asarray(curve))


def second_moment(recordings: Mapping[str, Sequence[Array]]) -> Array:
    """Mean over the windows at every start of z z^T without the windows' means, summed over states, (301, 301).

    Args:
        recordings: states of each recording, by column, at 0.2 s [SI]; z are their linear outputs.
    """
    moment = np.zeros((WINDOW_ROWS, WINDOW_ROWS))
    for column, values in recordings.items():
        for recording in values:
            z = TRANSFORMS[column].linear(recording)
            z = z - z.mean()
            count = len(z) - WINDOW_ROWS + 1
            for lag in range(WINDOW_ROWS):
                # entry (i, i + lag) sums z[s + i] z[s + i + lag] over the starts s: a moving sum of one product
                total = np.concatenate([[0.0], np.cumsum(z[: len(z) - lag] * z[lag:])])
                rows = np.arange(WINDOW_ROWS - lag)
                sums = (total[rows + count] - total[rows]) / count
                moment[rows, rows + lag] += sums
                if lag:
                    moment[rows + lag, rows] += sums
    moment -= moment.mean(axis=0)
    return moment - moment.mean(axis=1, keepdims=True)


def scaled_times() -> Tensor:
    """Sample times of a minute scaled to [-1, 1], (301, 1), float64."""
    return torch.linspace(-1.0, 1.0, WINDOW_ROWS, dtype=torch.float64)[:, None]


def _cosine(rate: float, epoch: int, epochs: int) -> float:
    return rate * 0.5 * (1.0 + math.cos(math.pi * epoch / epochs))
