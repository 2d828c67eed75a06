"""Total loss of the paper and its self-adaptive weights, over (lanes, time).

Source: paper, appendix "Detailed loss function": physics losses, data losses with self-adaptive weights inside the
square, initial-condition losses, x_r and the initial x_r and T_1 weighted by 100; section "Few-shot transfer learning"
for the start of the weights and their softplus mask.

Not printed, so chosen in `params.yaml` (identify.adam): the units that the residuals are squared in (`Scales`). The
paper's networks give states over 1e5 Pa, 5e3 rad/s and 300 K, and its printed weights (1e3, 2e3, 20) only balance for
residuals of that order, so by default a state and its rate use the output scaling of the table of networks, W_egr kg/s,
T_em that of T_1. x_r is of the order of 0.05 and is counted in tenths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from dieseltwin.identification.residuals import PhysicsResiduals

X_R_WEIGHT = 100.0
"""Weight of the residual of x_r (paper, total loss).

With x_r in units of one it is too small for noisy data: x_r moves T_em by 300-600 K, so its heads follow the noise of
T_em (18 K) almost for free, T_em stops saying anything about h_tot, and h_tot drifts with the epochs. Tenths stop it.
"""
INITIAL_WEIGHTS = (1.0, 1.0, 1.0, 100.0, 100.0)
"""Weights of the initial-condition losses of p_im, p_em, omega_t, x_r, T_1 (paper, total loss)."""
WEIGHT_SIGMA = 0.1
"""Standard deviation of the starting weights (paper)."""
POINTWISE = ("p_im", "p_em", "omega_t", "W_egr")
"""Channels with one self-adaptive weight for each sample; T_em and T_1 have a single one each."""
SCALAR = ("T_em", "T_1")
PAPER_WEIGHTS: Mapping[str, float] = {
    "p_im": 1e3, "p_em": 1e3, "omega_t": 1e3, "W_egr": 2e3, "T_em": 20.0, "T_1": 20.0
}  # fmt: skip
"""Starting multipliers alpha of the pointwise weights, and means of the two single ones (paper)."""


@dataclass(frozen=True)
class Scales:
    """Units that residuals are divided by before they are squared.

    Attributes:
        p: pressures [Pa], and their rates [Pa/s]; omega: turbo speed [rad/s], and its rate [rad/s2].
        T_1, T_em: temperatures [K]; w_egr: EGR flow [kg/s].
        rate: further divisor of the three rates [-]: below 1 the differential equations count more against the data.
        x_r: residual gas [-], which is of the order of 0.05.
    """

    p: float = 1e5
    omega: float = 5e3
    T_1: float = 300.0
    T_em: float = 300.0
    w_egr: float = 1.0
    rate: float = 1.0
    x_r: float = 0.1

    @property
    def physics(self) -> tuple[float, ...]:
        """Scales of the five physics residuals."""
        return (self.p * self.rate, self.p * self.rate, self.omega * self.rate, self.x_r, self.T_1)

    @property
    def states(self) -> tuple[float, ...]:
        """Scales of p_im, p_em, omega_t, x_r, T_1."""
        return (self.p, self.p, self.omega, self.x_r, self.T_1)

    @property
    def channels(self) -> tuple[float, ...]:
        """Scales of the readings p_im, p_em, omega_t, W_egr, T_em."""
        return (self.p, self.p, self.omega, self.w_egr, self.T_em)


class Weights(NamedTuple):
    """Self-adaptive weights before the softplus mask: pointwise (L, 4, n) and single (L, 2)."""

    pointwise: Tensor
    single: Tensor


def starting_weights(
    readings: Tensor, generator: torch.Generator, alpha: Mapping[str, float] = PAPER_WEIGHTS
) -> Weights:
    """Draw the weights: N(alpha X / max X, 0.1) at each sample, N(20, 0.1) for T_em and T_1 (paper).

    Args:
        readings: (L, n, 4) or more channels p_im, p_em, omega_t, W_egr; masked samples take 0 and never count.
        generator: source of the draws.
        alpha: multipliers by channel, as printed where not given.

    Returns:
        Weights of L lanes.
    """
    x = torch.nan_to_num(readings[..., : len(POINTWISE)]).transpose(1, 2)
    largest = x.amax(-1, keepdim=True)
    share = x / torch.where(largest > 0.0, largest, torch.ones_like(largest))
    multiplier = x.new_tensor([alpha[name] for name in POINTWISE])[:, None]
    pointwise = multiplier * share
    single = x.new_tensor([alpha[name] for name in SCALAR]).expand(x.shape[0], -1)
    return Weights(
        pointwise + WEIGHT_SIGMA * torch.randn(pointwise.shape, generator=generator, dtype=x.dtype),
        single + WEIGHT_SIGMA * torch.randn(single.shape, generator=generator, dtype=x.dtype),
    )


@dataclass(frozen=True)
class Observed:
    """What the data losses compare with.

    Attributes:
        readings: (L, n, 5) p_im, p_em, omega_t, W_egr, T_em, any finite value where masked [SI].
        present: (L, n, 5) 1 where a reading exists, 0 elsewhere.
        initial: (L, 5) p_im, p_em, omega_t, x_r, T_1 at the segment's start [SI].
        scales: units of the residuals.
    """

    readings: Tensor
    present: Tensor
    initial: Tensor
    scales: Scales = field(default_factory=Scales)


@dataclass(frozen=True)
class Loss:
    """Total loss of each lane and the data residuals behind it.

    Attributes:
        total: (L,).
        mean_squares: (L, 4, n) squared scaled data residuals over the number of readings, for the weights' ascent.
        single: (L, 2) losses that the single weights multiply: data of T_em, physics of T_1.
    """

    total: Tensor
    mean_squares: Tensor
    single: Tensor


def total_loss(residuals: PhysicsResiduals, states: tuple[Tensor, ...], weights: Weights, observed: Observed) -> Loss:
    """Total loss of the paper, lane by lane.

    Args:
        residuals: physics residuals and predicted W_egr, T_em, each (L, n) [SI].
        states: p_im, p_em, omega_t, x_r, T_1, each (L, n) [SI].
        weights: self-adaptive weights before their mask.
        observed: readings and initial states.

    Returns:
        The loss; gradients flow into `residuals` and `states`.
    """
    scale = observed.scales
    physics = [(r / s).square().mean(-1) for r, s in zip(residuals[:5], scale.physics, strict=True)]
    initial = sum(
        w * ((x[:, 0] - observed.initial[:, i]) / s).square()
        for i, (x, s, w) in enumerate(zip(states, scale.states, INITIAL_WEIGHTS, strict=True))
    )
    predicted = torch.stack([*states[:3], residuals.W_egr, residuals.T_em], 1)
    present = observed.present.transpose(1, 2)
    error = (predicted - observed.readings.transpose(1, 2)) * present / predicted.new_tensor(scale.channels)[:, None]
    mean_square = error.square() / present.sum(-1, keepdim=True).clamp(min=1.0)
    masked = torch.nn.functional.softplus(weights.pointwise)
    single = torch.nn.functional.softplus(weights.single)
    data = (mean_square[:, :4] * masked.square()).sum((1, 2))
    t_em = mean_square[:, 4].sum(-1)
    total = (
        physics[0] + physics[1] + physics[2] + X_R_WEIGHT * physics[3] + single[:, 1] * physics[4]
        + initial + data + single[:, 0] * t_em
    )  # fmt: skip
    return Loss(total, mean_square[:, :4].detach(), torch.stack([t_em, physics[4]], -1).detach())


def weights_gradient(loss: Loss, weights: Weights) -> Weights:
    """Derivative of the total loss by the unmasked weights; the weights go up it, everything else goes down.

    Args:
        loss: of `total_loss`.
        weights: the weights it was computed with.

    Returns:
        Gradient, shapes as the weights; never negative, because each loss grows with its weight.
    """
    masked, slope = torch.nn.functional.softplus(weights.pointwise), torch.sigmoid(weights.pointwise)
    return Weights(2.0 * loss.mean_squares * masked * slope, loss.single * torch.sigmoid(weights.single))
