"""Baseline: a small network added to the rates, trained on the biases that the Kalman filter finds.

It learns where in the operating range the balances are off and is simulated with the twin; alarms when it improves the
last part of the recording, on which it was not trained. It has no name for anything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dieseltwin.challenge.baselines.health_only import HealthFit, fit_health
from dieseltwin.challenge.baselines.kalman import SETTLE_S
from dieseltwin.challenge.baselines.model import HIDDEN, NET_INPUTS, Bound, Net

TRAIN_SHARE = 0.7
EPOCHS = 400  # full batch
SHARES = (1.0, 0.5, 0.25)  # of the net's output that are tried on the same rows; none if none helps
RATE = 0.02
DECAY = 1e-3


def train(bound: Bound, fit: HealthFit, filtered: np.ndarray) -> Net:
    """A net from states and inputs to the filtered biases over the first 70 % of the recording.

    A filter's biases lag and carry noise, so the share of the net's output is the one that simulates those rows best.
    """
    net = _regressed(bound, filtered)
    last = round(TRAIN_SHARE * bound.time_s.size)
    last = int(bound.starts[np.searchsorted(bound.starts, last)])
    best, chosen = float(np.sum(fit.residual[:last] ** 2)), Net.zero()
    for share in SHARES:
        tried = replace(net, w2=share * net.w2, b2=share * net.b2)
        corrected = fit_health(bound, start=fit.health, local=fit.local, free=False, net=tried, iterations=1)
        chi2 = float(np.sum(corrected.residual[:last] ** 2))
        if chi2 < best:
            best, chosen = chi2, tried
    return chosen


def _regressed(bound: Bound, filtered: np.ndarray) -> Net:
    import torch

    torch.set_num_threads(1)

    sample_s = float(bound.time_s[1] - bound.time_s[0])
    rows = slice(round(SETTLE_S / sample_s), round(TRAIN_SHARE * bound.time_s.size))
    inputs = np.column_stack([filtered[:, :3], bound.fine[:, :: bound.every].T])[rows]
    targets = filtered[rows, 3:]
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-9
    scale = targets.std(axis=0) + 1e-12
    generator = torch.Generator().manual_seed(0)
    x = torch.tensor((inputs - middle) / spread, dtype=torch.float32)
    t = torch.tensor(targets / scale, dtype=torch.float32)
    w1 = (torch.randn(HIDDEN, NET_INPUTS, generator=generator) * 0.5).requires_grad_()
    b1 = torch.zeros(HIDDEN, requires_grad=True)
    w2 = torch.zeros(3, HIDDEN, requires_grad=True)
    b2 = torch.zeros(3, requires_grad=True)
    optimiser = torch.optim.Adam([w1, b1, w2, b2], lr=RATE, weight_decay=DECAY)
    for _ in range(EPOCHS):
        optimiser.zero_grad()
        loss = torch.mean((torch.tanh(x @ w1.T + b1) @ w2.T + b2 - t) ** 2)
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        weights = [v.numpy().astype(np.float64) for v in (w1, b1, w2, b2)]
    return Net(weights[0], weights[1], weights[2] * scale[:, None], weights[3] * scale, middle, spread)


def gain_per_sample(bound: Bound, fit: HealthFit, net: Net, first_row: int) -> float:
    """Log-likelihood gained a sample by the net on the rows from `first_row` on, initial states refitted with it.

    Args:
        fit: of this recording without the net (`without_net`).
    """
    without = fit
    corrected = fit_health(bound, start=fit.health, local=fit.local, free=False, net=net, iterations=2)
    at = int(bound.starts[np.searchsorted(bound.starts, first_row)])
    gained = np.sum(without.residual[at:] ** 2) - np.sum(corrected.residual[at:] ** 2)
    return float(0.5 * gained / (bound.time_s.size - at))


def without_net(bound: Bound, health: dict[str, float]) -> HealthFit:
    """Initial states fitted to a recording with health parameters from elsewhere."""
    return fit_health(bound, start=health, free=False, iterations=3)
