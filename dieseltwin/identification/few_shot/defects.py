"""What a basis cannot follow: defects of the projected exact solution, from the compiled simulator.

The exhaust pressure follows the inputs within 11-41 ms while 125 heads resolve half a second. A smooth trajectory
therefore cannot obey the differential equations at the samples even at the true parameters, and what it misses is not
noise: it is largest in the transients that carry the information on h_tot. Left alone it biases h_tot by 1.5-2
Cramer-Rao bounds (measured, every basis).

The remedy is the defect correction of multigrid methods: simulate from the current estimate, project the simulated
states onto the heads, and ask the heads' residual and readings to match those of the projection instead of zero. At a
solution the corrected equations are those of the exact model, whatever the width of the basis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dieseltwin.engine import HEALTH, Actuation, EngineParameters, parameter_batch, simulate_states
from dieseltwin.identification.few_shot.heads import Heads
from dieseltwin.identification.few_shot.residuals import DrivenInputs, PointModel

STEP_S = 0.02
"""Integration step [s]: errs by some 0.01 %, a tenth of what the basis misses."""
WINDOW_S, WARM_UP_S, FADE_S = 10.0, 2.0, 1.0
"""Windows of the simulation restart from the heads' trajectory [s]: the engine is unstable in places, and a single run
of a minute would leave the trajectory there. Pressures forget their start within the warm-up; neighbouring windows are
blended over the fade."""


@dataclass(frozen=True)
class Windows:
    """Overlapping windows of one segment, simulated as lanes of one batch.

    Attributes:
        starts: first sample of each window.
        actuations: of each window, all on the same relative grid.
        share: (w, n) weight of each window at each sample; adds up to one.
        share_rate: (w, n) its time derivative [1/s].
    """

    starts: tuple[int, ...]
    actuations: tuple[Actuation, ...]
    share: Tensor
    share_rate: Tensor


def windows_for(actuation: Actuation) -> Windows:
    """Cut a segment into windows; one window where its samples are not evenly spaced or where it is short.

    Args:
        actuation: of the segment, at the step of the simulation.

    Returns:
        The windows.
    """
    time = actuation.time_s
    n = time.size
    step = float(time[1] - time[0])
    even = np.allclose(np.diff(time), step, rtol=1e-6, atol=1e-6) and len(set(actuation.steps.tolist())) == 1
    warm, fade = max(1, round(WARM_UP_S / step)), max(1, round(FADE_S / step))
    length = round(WINDOW_S / step) + warm + fade
    if not even or length >= n:
        one = torch.ones(1, n, dtype=torch.float64)
        return Windows((0,), (actuation,), one, torch.zeros_like(one))
    count = 1 + int(np.ceil((n - 1 - length) / (length - 1 - warm - fade)))
    starts = [int(v) for v in np.round(np.linspace(0, n - 1 - length, count))]
    rise, rise_rate = np.zeros((count + 1, n)), np.zeros((count + 1, n))
    rise[0] = 1.0
    index = np.arange(n)
    for k in range(1, count):
        x = np.clip((index - starts[k] - warm) / fade, 0.0, 1.0)
        rise[k], rise_rate[k] = x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / (fade * step)
    per_sample = 2 * int(actuation.steps[0])
    cut = [
        replace(
            actuation,
            time_s=time[a : a + length + 1],
            steps=actuation.steps[a : a + length],
            grid=np.ascontiguousarray(actuation.grid[:, per_sample * a : per_sample * (a + length) + 1]),
        )
        for a in starts
    ]
    share, rate = rise[:-1] - rise[1:], rise_rate[:-1] - rise_rate[1:]
    return Windows(tuple(starts), tuple(cut), torch.as_tensor(share), torch.as_tensor(rate))


@dataclass(frozen=True)
class Defects:
    """Corrections of `collocation.Data`, and the simulated states behind them.

    Attributes:
        rate: (R, n, 3) [Pa/s, Pa/s, rad/s2].
        reading: (R, n, C) [SI].
        states: (R, n, 3) simulated p_im, p_em, omega_t [Pa, Pa, rad/s].
    """

    rate: Tensor
    reading: Tensor
    states: Tensor


ASTRAY = 0.5
"""A window whose simulated state leaves the trajectory by more than this share has nothing to say about it."""


def simulate_windows(
    windows: Windows, parameters: EngineParameters, health: np.ndarray, trajectory: np.ndarray
) -> tuple[Tensor, Tensor]:
    """Simulate all windows of R runs from given trajectories.

    Args:
        windows: W windows of the segment.
        parameters: known parameters.
        health: (R, 4) health values [SI].
        trajectory: (R, n, 3) states from which each window starts [Pa, Pa, rad/s].

    Returns:
        Blended states (R, n, 3), and the rate that the blending adds to them (R, n, 3) [per s].
    """
    runs, n = trajectory.shape[:2]
    count = len(windows.starts)
    initial = trajectory[:, list(windows.starts)].reshape(runs * count, 3)
    columns: dict[str, Any] = {name: np.repeat(health[:, i], count) for i, name in enumerate(HEALTH)}
    batch = parameter_batch(parameters, **columns)
    lanes = simulate_states(list(windows.actuations) * runs, batch, np.ascontiguousarray(initial)).states[..., :3]
    states, forcing = np.zeros((runs, n, 3)), np.zeros((runs, n, 3))
    lanes = lanes.reshape(runs, count, -1, 3)
    for k, a in enumerate(windows.starts):
        rows = slice(a, a + lanes.shape[2])
        states[:, rows] += windows.share[k, rows, None].numpy() * lanes[:, k]
        forcing[:, rows] += windows.share_rate[k, rows, None].numpy() * lanes[:, k]
    return torch.from_numpy(states), torch.from_numpy(forcing)


def defects(
    heads: Heads,
    inputs: DrivenInputs,
    exact: PointModel,
    windows: Windows,
    parameters: EngineParameters,
    unknowns: Tensor,
) -> Defects:
    """Defects of the heads around the current estimate.

    Args:
        heads, inputs: of the segment.
        exact: the model that the simulator integrates.
        windows: of the segment.
        parameters: known parameters.
        unknowns: (R, m) heads and log-parameters.

    Returns:
        The corrections; zero where the simulation went astray.
    """
    log_health = unknowns[:, -len(HEALTH) :]
    path = heads.trajectory(unknowns[:, : -len(HEALTH)])
    states, forcing = simulate_windows(windows, parameters, torch.exp(log_health).numpy(), path.states.numpy())
    return defects_of(heads, inputs, exact, log_health, states, forcing, path.states)


def defects_of(
    heads: Heads,
    inputs: DrivenInputs,
    exact: PointModel,
    log_health: Tensor,
    states: Tensor,
    forcing: Tensor,
    trajectory: Tensor,
) -> Defects:
    """Defects of given exact states (R, n, 3); `forcing` is the part of their rate that is not physics."""
    astray = (states / trajectory - 1.0).abs().amax((-1, -2))
    valid = torch.isfinite(astray) & (astray < ASTRAY)
    states = torch.where(valid[:, None, None], states, trajectory)
    projected = heads.trajectory(heads.project(states))
    coarse = exact(projected.states, log_health, inputs, derivatives=False)
    fine = exact(states, log_health, inputs, derivatives=False)
    keep = valid[:, None, None].to(states.dtype)
    rate = (projected.rates - coarse.rates - forcing) * keep
    reading = torch.cat([states - projected.states, fine.readings - coarse.readings], -1) * keep
    return Defects(rate, reading, states)
