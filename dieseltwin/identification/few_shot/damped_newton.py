"""Levenberg-Marquardt over the heads and parameters of many runs at once, each with its own damping."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dieseltwin.identification.few_shot.collocation import Collocation, Data, Quadratic
from dieseltwin.identification.few_shot.residuals import N_HEALTH, Cylinder

DAMPING_DOWN, DAMPING_UP = 0.1, 8.0
DAMPING_MIN, DAMPING_MAX = 1e-9, 1e6
HEALTH_STEP = 0.5
"""Largest change of a log-parameter in one step."""
HEALTH_RIDGE = 1e-2
"""Added to the curvature of the log-parameters in a step: a parameter without any influence (A_egrmax behind a shut
valve) leaves a row of zeros that no factorisation takes, and would stop all the others. It is the information of a
prior with a standard deviation of 10 in the logarithm, is no part of the objective, and so biases nothing."""


@dataclass
class Runs:
    """State of R runs; updated in place by `minimise`.

    Attributes:
        unknowns: (R, m) heads and log-parameters.
        quadratic: objective there.
        damping: (R,) Levenberg-Marquardt factor.
        decrement: (R,) distance to the minimum that the local model predicts [standard deviations].
        iterations: (R,) evaluations so far.
    """

    unknowns: Tensor
    quadratic: Quadratic
    damping: Tensor
    decrement: Tensor
    iterations: Tensor


def ridge(size: int, dtype: torch.dtype) -> Tensor:
    """(size, size) diagonal matrix with `HEALTH_RIDGE` for the log-parameters, the last of the unknowns."""
    added = torch.zeros(size, dtype=dtype)
    added[-N_HEALTH:] = HEALTH_RIDGE
    return torch.diag(added)


def _rows(cylinder: Cylinder, lanes: Tensor) -> Cylinder:
    return Cylinder(cylinder.x_r[lanes], cylinder.T_1[lanes])


def _take(q: Quadratic, lanes: Tensor) -> Quadratic:
    """The same for some of the runs."""
    gradient = None if q.gradient is None else q.gradient[lanes]
    hessian = None if q.hessian is None else q.hessian[lanes]
    return Quadratic(q.cost[lanes], gradient, hessian, q.physics[lanes], q.data[lanes], _rows(q.cylinder, lanes))


def _step(hessian: Tensor, gradient: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """Damped step (R, m), and which runs have a usable one."""
    diagonal = torch.diagonal(hessian, dim1=-2, dim2=-1)
    damped = hessian + torch.diag_embed(damping[:, None] * diagonal) + ridge(diagonal.shape[-1], diagonal.dtype)
    factor, info = torch.linalg.cholesky_ex(damped)
    step = -torch.cholesky_solve(gradient.unsqueeze(-1), factor).squeeze(-1)
    usable = (info == 0) & torch.isfinite(step).all(-1)
    step = torch.where(usable[:, None], step, torch.zeros_like(step))
    longest = step[:, -N_HEALTH:].abs().amax(-1, keepdim=True) / HEALTH_STEP
    return step / longest.clamp(min=1.0), usable


def minimise(
    problem: Collocation,
    data: Data,
    unknowns: Tensor,
    *,
    dof: float,
    tolerance: float,
    iterations_max: int,
    damping: Tensor | float = 1e-3,
    start: Cylinder | None = None,
) -> Runs:
    """Minimise the objective of R runs; a run rests once its decrement is below the tolerance.

    Args:
        problem, data: what is minimised.
        unknowns: (R, m) start.
        dof: tails of the physics residuals.
        tolerance: decrement that counts as converged [standard deviations].
        iterations_max: most trial steps.
        damping: first factor, (R,) or one for all.
        start: warm start of x_r and T_1.

    Returns:
        The best point of each run.
    """
    x = unknowns.clone()
    best = problem(x, data, dof, start=start)
    if best.gradient is None or best.hessian is None:
        return Runs(x, best, x[:, 0], x[:, 0], x[:, 0])
    cost, gradient, hessian = best.cost, best.gradient, best.hessian
    physics, misfit, cylinder = best.physics, best.data, best.cylinder
    count = x.shape[0]
    factor = torch.as_tensor(damping, dtype=x.dtype).expand(count).clone()
    decrement = torch.full((count,), float("inf"), dtype=x.dtype)
    iterations = torch.ones(count, dtype=torch.int64)
    active = torch.nonzero(torch.isfinite(cost)).squeeze(-1)
    everything = torch.arange(count)
    fixed_lanes = problem.model.lanes > 1  # maps hold a member for each run: the batch can't shrink
    for _ in range(iterations_max):
        if not active.numel():
            break
        step, usable = _step(hessian[active], gradient[active], factor[active])
        decrement[active] = (-(step * gradient[active]).sum(-1)).clamp(min=0.0).sqrt()
        small = (decrement[active] < tolerance) & usable & (factor[active] < 1.0)
        go = ~small
        active, step, usable = active[go], step[go], usable[go]
        if not active.numel():
            break
        trial = x[active] + step
        if fixed_lanes:
            whole = x.clone()
            whole[active] = trial
            there = _take(problem(whole, data, dof, start=_rows(cylinder, everything)), active)
        else:
            there = problem(trial, data.take(active), dof, start=_rows(cylinder, active))
        iterations[active] += 1
        accepted = usable & torch.isfinite(there.cost) & (there.cost < cost[active])
        factor[active] = torch.where(accepted, factor[active] * DAMPING_DOWN, factor[active] * DAMPING_UP)
        factor.clamp_(DAMPING_MIN, DAMPING_MAX)
        to, of = active[accepted], accepted
        x[to], cost[to] = trial[of], there.cost[of]
        gradient[to], hessian[to] = there.gradient[of], there.hessian[of]  # type: ignore[index]
        physics[to], misfit[to] = there.physics[of], there.data[of]
        cylinder.x_r[to], cylinder.T_1[to] = there.cylinder.x_r[of], there.cylinder.T_1[of]
        active = active[factor[active] < DAMPING_MAX]
    final = Quadratic(cost, gradient, hessian, physics, misfit, cylinder)
    return Runs(x, final, factor, decrement, iterations)
