"""Levenberg-Marquardt over the heads and parameters of many runs at once, each with its own damping and factor.

Cost and gradient are exact at every point. The Hessian, a hundred times as dear, is assembled and factorised again only
where the kept one no longer serves: where a step was refused, or shrank the decrement too little. Runs of one recording
come together long before they rest, so a run takes the first one's where both stand near each other. That is seen at
the point itself, while `dieseltwin.least_squares` must choose before it evaluates a point: it gets gradient and Hessian
from one integration, and solves a batch of small systems where this keeps a factor of some hundred unknowns a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from scipy.linalg.blas import dtrmv
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs
from torch import Tensor

from dieseltwin.arrays import Array
from dieseltwin.engine.observations import in_threads
from dieseltwin.identification.few_shot.collocation import Collocation, Curvature, Data, Objective
from dieseltwin.identification.few_shot.residuals import N_HEALTH, Cylinder

DAMPING_DOWN, DAMPING_UP = 0.1, 8.0
DAMPING_MIN, DAMPING_MAX = 1e-9, 1e6
DAMPING_AT_REST = 1e-5
"""A factor with more damping than this isn't asked whether a run has arrived: damping shortens the way that is left."""
KEPT_BELOW = 0.3
"""A factor is kept while a step shrinks the decrement to this share of itself."""
NEAR = 10.0
"""A run takes another's Hessian if that one's point is so near [standard deviations of all unknowns together]."""
HEALTH_STEP = 0.5
"""Largest change of a log-parameter in one step."""
HEALTH_RIDGE = 1e-2
"""Added to the curvature of the log-parameters in a step: a parameter without any influence (A_egrmax behind a shut
valve) leaves a row of zeros that no factorisation takes, and would stop all the others. It is the information of a
prior with a standard deviation of 10 in the logarithm, is no part of the objective, and so biases nothing."""


class Factor:
    """The Hessian of one run and the Cholesky factor of what a step takes of it.

    Attributes:
        damping: Levenberg-Marquardt factor of the next factorisation [-].
        stale: the Hessian belongs to an earlier point.
        borrowed: it was made for another run.
    """

    def __init__(self, problem: Collocation, damping: float) -> None:
        self.damping, self.stale, self.borrowed = damping, False, False
        self._problem = problem
        self._point: Array = np.empty(0)
        self._hessian: Array = np.empty((0, 0))
        self._factor: Array = np.empty((0, 0))
        self._factorised_with = float("inf")
        self._usable = False

    def renew(self, of: Curvature, lane: int, point: Array) -> None:
        """Take the Hessian of the point (m,) where run `lane` stands."""
        self._hessian = np.empty((self._problem.size,) * 2)  # the one before may be another run's as well
        self._problem.hessian(of, lane, self._hessian)
        self._point, self.stale, self.borrowed = point.copy(), False, False
        self.factorise()

    def borrow(self, other: Factor, point: Array) -> bool:
        """Take another run's Hessian if it was made near this run's point (m,); whether it was, and is another one."""
        if not other._usable or other._hessian is self._hessian:
            return False
        if np.linalg.norm(dtrmv(other._factor, point - other._point, lower=1, trans=1)) > NEAR:
            return False
        self._hessian, self._point, self._factor = other._hessian, other._point, other._factor
        self._factorised_with, self._usable = other._factorised_with, other._usable
        self.stale, self.borrowed = False, True
        if self._factorised_with != self.damping:
            self.factorise()
        return True

    def factorise(self) -> None:
        """Factorise the Hessian with the present damping."""
        damped = self._hessian.copy()
        diagonal = np.einsum("ii->i", damped)
        diagonal *= 1.0 + self.damping
        diagonal[-N_HEALTH:] += HEALTH_RIDGE
        # The upper triangle of rows is the lower one of columns, which is what LAPACK takes.
        self._factor, info = dpotrf(damped.T, lower=1, clean=0, overwrite_a=1)
        self._factorised_with, self._usable = self.damping, info == 0

    def step(self, gradient: Array) -> tuple[Array, float]:
        """Damped step (m,) and its decrement; zeros and infinity where no step is usable."""
        if self._usable:
            step = -dpotrs(self._factor, gradient, lower=1)[0]
            if np.isfinite(step).all():
                return step, max(-float(step @ gradient), 0.0) ** 0.5
        return np.zeros_like(gradient), float("inf")

    @property
    def damped_away(self) -> bool:
        """Whether the factor holds more damping than it would now, too much to say how far the minimum is."""
        return self._factorised_with > max(DAMPING_AT_REST, self.damping)

    @property
    def empty(self) -> bool:
        """Whether no Hessian was taken yet."""
        return not self._hessian.size

    def log_std(self) -> Array:
        """(4,) standard deviations of the log-parameters; infinite where there is no factor.

        The last rows of the factor's inverse are those of the parameters: inv(L)' inv(L) is the covariance.
        """
        if not self._usable:
            return np.full(N_HEALTH, np.inf)
        corner, _ = dtrtrs(self._factor[-N_HEALTH:, -N_HEALTH:], np.eye(N_HEALTH), lower=1)
        return np.asarray(np.sqrt((corner**2).sum(axis=0)))


@dataclass
class Runs:
    """State of R runs.

    Attributes:
        unknowns: (R, m) heads and log-parameters.
        objective: there.
        factors: of each run.
        decrement: (R,) distance to the minimum that the local model predicts [standard deviations].
        iterations: (R,) evaluations so far.
    """

    unknowns: Tensor
    objective: Objective
    factors: list[Factor]
    decrement: Tensor
    iterations: Tensor

    def log_std(self) -> Tensor:
        """(R, 4) standard deviations of the log-parameters, of the factors that were kept."""
        return torch.from_numpy(np.stack([factor.log_std() for factor in self.factors]))


def minimise(
    problem: Collocation,
    data: Data,
    unknowns: Tensor,
    *,
    dof: float,
    tolerance: float,
    iterations_max: int,
    damping: float = 1e-3,
    start: Cylinder | None = None,
    factors: list[Factor] | None = None,
) -> Runs:
    """Minimise the objective of R runs; a run rests once its decrement is below the tolerance.

    Args:
        problem, data: what is minimised.
        unknowns: (R, m) start.
        dof: tails of the physics residuals.
        tolerance: decrement that counts as converged [standard deviations].
        iterations_max: most trial steps.
        damping: first factor.
        start: warm start of x_r and T_1.
        factors: of the same runs in a minimum nearby, to begin with.

    Returns:
        The best point of each run.
    """
    x = unknowns.clone()
    here = problem(x, data, dof, start=start)
    count = len(x)
    kept = [Factor(problem, damping) for _ in range(count)] if factors is None else factors
    for factor in kept:
        factor.damping, factor.stale = damping, True
    endless = torch.full((count,), float("inf"), dtype=x.dtype)
    runs = Runs(x, here, kept, endless, torch.ones(count, dtype=torch.int64))
    active = torch.nonzero(torch.isfinite(here.cost)).squeeze(-1)
    for _ in range(iterations_max):
        lanes = active.tolist()
        first = [_next(runs, tolerance, None, lane) for lane in lanes[:1]]
        rest = in_threads(partial(_next, runs, tolerance, kept[lanes[0]]), lanes[1:]) if lanes else []
        steps = dict(zip(lanes, first + rest, strict=True))
        active = torch.tensor([lane for lane, step in steps.items() if step is not None], dtype=torch.int64)
        if not active.numel():
            break
        step = torch.from_numpy(np.stack([s for s in steps.values() if s is not None]))
        trial = x[active] + step
        there = _evaluate(problem, data, dof, runs, active, trial)
        runs.iterations[active] += 1
        accepted = torch.isfinite(there.cost) & (there.cost < here.cost[active])
        to, of = active[accepted], torch.nonzero(accepted).squeeze(-1)
        x[to] = trial[of]
        here.put(to, there, of)
        lanes, good = active.tolist(), dict(zip(active.tolist(), accepted.tolist(), strict=True))
        # Hessians and factors are a run's own, and made without Python's lock
        going = in_threads(partial(_goes_on, runs, good), lanes)
        active = torch.tensor([lane for lane, on in zip(lanes, going, strict=True) if on], dtype=torch.int64)
    return runs


def _next(runs: Runs, tolerance: float, first: Factor | None, lane: int) -> Array | None:
    """The next step of a run (m,), whose Hessian may be the first run's; None where it has arrived."""
    factor, gradient, point = runs.factors[lane], runs.objective.gradient[lane].numpy(), runs.unknowns[lane].numpy()

    def renew() -> None:
        if first is None or not factor.borrow(first, point):
            factor.renew(runs.objective.curvature, lane, point)

    if factor.empty:
        renew()
    step, decrement = factor.step(gradient)
    if factor.stale and decrement > KEPT_BELOW * float(runs.decrement[lane]):
        renew()
        step, decrement = factor.step(gradient)
    elif decrement < tolerance and factor.damped_away:
        factor.factorise()
        step, decrement = factor.step(gradient)
    runs.decrement[lane] = decrement
    if decrement < tolerance and factor.damping < 1.0:
        return None
    longest = float(np.abs(step[-N_HEALTH:]).max()) / HEALTH_STEP
    return step / max(longest, 1.0)


def _goes_on(runs: Runs, accepted: dict[int, bool], lane: int) -> bool:
    """Set a run's damping after a trial; whether there is another."""
    factor = runs.factors[lane]
    if accepted[lane]:
        factor.damping, factor.stale = max(factor.damping * DAMPING_DOWN, DAMPING_MIN), True
    elif factor.stale or factor.borrowed:  # a refused step of a Hessian from elsewhere says little
        factor.renew(runs.objective.curvature, lane, runs.unknowns[lane].numpy())
    else:
        factor.damping = min(factor.damping * DAMPING_UP, DAMPING_MAX)
        factor.factorise()
    return factor.damping < DAMPING_MAX


def _evaluate(problem: Collocation, data: Data, dof: float, runs: Runs, lanes: Tensor, trial: Tensor) -> Objective:
    """The objective of some runs at their trial points."""
    if problem.model.lanes > 1:  # maps hold a member for each run: the batch can't shrink
        whole = runs.unknowns.clone()
        whole[lanes] = trial
        return problem(whole, data, dof, start=runs.objective.cylinder).take(lanes)
    warm = Cylinder(*(v[lanes] for v in runs.objective.cylinder))
    return problem(trial, data, dof, lanes=lanes, start=warm)
