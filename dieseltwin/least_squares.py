"""Levenberg-Marquardt for many small least-squares problems at once, with an acceptance test for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array

Index = NDArray[np.int_]

INTERVAL = 0.90
"""Probability of every reported interval and band."""
Z_90 = 1.6448536269514722
"""Half width of the 90 % interval of a Gaussian in standard deviations, and a one-sided limit of 95 %."""


@dataclass(frozen=True)
class Linearisation:
    """Least-squares problems around the current unknowns.

    Attributes:
        cost: (L,) half the sum of squared residuals over sigma [-]; infinite where the model fails.
        gradient: (L, m) its derivative.
        hessian: (L, m, m) Gauss-Newton Hessian, the Fisher information of the readings.
    """

    cost: Array
    gradient: Array
    hessian: Array

    def take(self, rows: NDArray[np.bool_]) -> Linearisation:
        """The same of some of the problems."""
        return Linearisation(self.cost[rows], self.gradient[rows], self.hessian[rows])


Linearise = Callable[[Index, Array, NDArray[np.bool_]], Linearisation]
"""(K indices, (K, m) unknowns, (K,) renew) -> cost, gradient, Hessian; without `renew` the last Jacobian serves."""

CHORD_DISTANCE = 1.0
"""A move of fewer standard deviations than this keeps its Jacobian, which changes by some tenths of a per cent."""
ACCEPT_GAIN = 1e-3
"""Smallest share of the predicted decrease that a step must bring."""
DAMPING_MIN, DAMPING_MAX = 1e-9, 1e9
CONVERGED_BELOW = 0.1
"""Remaining move of an unknown that counts as converged [standard deviations]: it adds 1 % to a variance at most."""
NEGLIGIBLE = 1e-4
"""A decrease of the negative log likelihood that nobody can tell from none."""
ALL = slice(None)
CURVATURE_MIN = 1.0
"""Least curvature that damping acts on: a log standard deviation of 1 counts as no knowledge at all."""


def of_logarithms(curvature: Array) -> Array:
    """What damping acts on where the unknowns are logarithms, from the Hessian's diagonal (L, m)."""
    return np.maximum(curvature, CURVATURE_MIN)


@dataclass(frozen=True)
class Fit:
    """State of L problems.

    Attributes:
        unknowns: (L, m) best values.
        linear: cost, gradient and Hessian there.
        iterations: (L,) evaluations used.
        converged: (L,) gradient so small that no unknown of interest would move by `CONVERGED_BELOW`.
    """

    unknowns: Array
    linear: Linearisation
    iterations: Index
    converged: NDArray[np.bool_]


@dataclass(frozen=True)
class Box:
    """Where unknowns may go.

    Attributes:
        lower, upper: (m,) or (L, m) limits that trial points are clipped to; equal ones pin an unknown.
        step_max: (m,) largest change of an unknown in one step.
    """

    lower: Array
    upper: Array
    step_max: Array


@dataclass(frozen=True)
class DampingRule:
    """When damping changes, and what it acts on.

    Attributes:
        good_gain: share of the predicted decrease from which a step lets the damping fall [-].
        down, up: factors after a good step and after a refused one [-].
        of: the Hessian's diagonal (L, m) -> the curvatures that the damping multiplies.
    """

    good_gain: float = 0.5
    down: float = 0.1
    up: float = 8.0
    of: Callable[[Array], Array] = of_logarithms


@dataclass(frozen=True)
class Problems:
    """What is minimised, and how.

    Attributes:
        linearise: cost, gradient and Hessian of chosen problems.
        cost_alone: their cost (K,) from (K indices, (K, m) unknowns), where that is much cheaper: then what a trial
            refuses is never linearised, and only linearised points count as iterations.
        rule: of the damping.
    """

    linearise: Linearise
    cost_alone: Callable[[Index, Array], Array] | None = None
    rule: DampingRule = DampingRule()


def levenberg_marquardt(
    problems: Problems,
    start: Array,
    box: Box,
    *,
    tolerance: float,
    iterations_max: int,
    interest: slice = ALL,
    damping: float | Array = 1e-2,
) -> Fit:
    """Minimise L sums of squares, each with its own damping; a problem leaves the batch once it has converged.

    A trial point is linearised together with its cost, unless the cost alone is cheap: almost every trial is accepted,
    and then nothing is computed twice. Converged means a Newton decrement sqrt(g' H^-1 g) below `tolerance`: the rest
    of the way is that share of a standard deviation, whatever the units.

    The few-shot estimator's heads are minimised elsewhere (`identification.few_shot.damped_newton`): there the gradient
    costs a hundredth of the Hessian, so that a point is seen first and its Hessian renewed after; here one
    integration gives both, and what is renewed has to be chosen before.

    Args:
        problems: what is minimised.
        start: (L, m) first values.
        box: where the unknowns may go.
        tolerance: largest decrement that counts as converged [standard deviations].
        iterations_max: most evaluations after the first.
        interest: unknowns whose convergence is judged; the others are nuisances, which may rest at a kink.
        damping: first factor, one for all or (L,).

    Returns:
        The best point of each problem.
    """
    linearise, cost_alone, rule = problems.linearise, problems.cost_alone, problems.rule
    lower, upper, step_max = box.lower, box.upper, box.step_max
    count = len(start)
    everything = np.arange(count)
    lower, upper = np.broadcast_to(lower, start.shape), np.broadcast_to(upper, start.shape)
    x = np.clip(start, lower, upper)
    first = linearise(everything, x, np.ones(count, dtype=bool))
    cost, gradient, hessian = first.cost.copy(), first.gradient.copy(), first.hessian.copy()
    factor = np.broadcast_to(damping, (count,)).astype(np.float64)
    decrement = _newton(gradient, hessian, x, lower, upper)[0]
    iterations = np.ones(count, dtype=np.int64)
    stale = np.zeros(count, dtype=bool)  # the Jacobian belongs to an earlier point
    renewal = np.zeros(count, dtype=bool)  # no step next: the Jacobian is renewed where the problem stands
    active = everything[np.isfinite(cost) & (decrement > tolerance)]
    while len(active):
        again = renewal[active]
        blocked = _blocked(gradient[active], x[active], lower[active], upper[active])
        reduced = _reduced(gradient[active], hessian[active], blocked)
        added = factor[active, None] * rule.of(np.diagonal(reduced[1], axis1=1, axis2=2))
        step = np.where(again[:, None], 0.0, _step(*reduced, added, step_max))
        trial = np.clip(x[active] + step, lower[active], upper[active])
        step = trial - x[active]
        square = np.einsum("lj,ljk,lk->l", step, hessian[active], step)
        predicted = -np.einsum("lk,lk->l", gradient[active], step) - 0.5 * square
        renew = again | (square > CHORD_DISTANCE**2) | (cost_alone is not None)
        there: Linearisation | None = None
        if cost_alone is None:
            there = linearise(active, trial, renew)
            cost_there = there.cost
        else:
            cost_there = cost_alone(active, trial)
        gain = np.where(predicted > 0.0, (cost[active] - cost_there) / np.maximum(predicted, _TINY), -1.0)
        accepted = again | (np.isfinite(cost_there) & (gain > ACCEPT_GAIN))
        # A refused step with a Jacobian from elsewhere says little: renew it before taking shorter steps.
        ask = ~accepted & stale[active]
        rises, falls = ~accepted & ~ask, accepted & ~again & (gain > rule.good_gain)
        factor[active] *= np.where(falls, rule.down, np.where(rises, rule.up, 1.0))
        factor = np.clip(factor, DAMPING_MIN, DAMPING_MAX)
        moved = active[accepted]
        now = linearise(moved, trial[accepted], renew[accepted]) if there is None else there.take(accepted)
        iterations[moved if there is None else active] += 1
        x[moved], cost[moved], gradient[moved], hessian[moved] = trial[accepted], now.cost, now.gradient, now.hessian
        stale[moved], renewal[active] = ~renew[accepted], ask
        decrement[moved] = _newton(now.gradient, now.hessian, x[moved], lower[moved], upper[moved])[0]
        # A refused step that promised next to nothing: a kink of the model, not a way on.
        stuck = rises & ((predicted < NEGLIGIBLE) | (factor[active] >= DAMPING_MAX))
        active = active[(decrement[active] > tolerance) & ~stuck & (iterations[active] <= iterations_max)]
    _, way, curvature = _newton(gradient, hessian, x, lower, upper)
    std = np.sqrt(np.diagonal(covariance(curvature), axis1=1, axis2=2))
    remaining = (np.abs(way) / std)[:, interest].max(axis=1)
    converged = np.isfinite(cost) & (remaining <= CONVERGED_BELOW)
    return Fit(x, Linearisation(cost, gradient, hessian), iterations, converged)


def keep_better(fit: Fit, other: Fit, where: Index) -> Fit:
    """Replace problems by another fit of them where that is better.

    Better is a likelihood that is higher, or as high with convergence that the first fit didn't reach.

    Args:
        fit: L problems.
        other: K of them, fitted once more.
        where: (K,) their indices in `fit`.

    Returns:
        The combined fit; iterations add up.
    """
    cost = fit.linear.cost[where]
    equal = np.abs(other.linear.cost - cost) < EQUAL_COST
    better = np.where(equal, other.converged & ~fit.converged[where], other.linear.cost < cost)
    rows = where[better]

    def merged(old: NDArray, new: NDArray) -> NDArray:
        result = old.copy()
        result[rows] = new[better]
        return result

    iterations = fit.iterations.copy()
    iterations[where] += other.iterations
    return replace(_each_array(merged, fit, other), iterations=iterations)


def concatenated(parts: Sequence[Fit]) -> Fit:
    """One fit of all problems of several.

    Args:
        parts: fits with the same unknowns.

    Returns:
        Their problems in order.
    """
    return _each_array(lambda *arrays: np.concatenate(arrays), *parts)


def _each_array(function: Callable[..., NDArray], *fits: Fit) -> Fit:
    """The fit whose every array is a function of the same array of all the fits."""

    def of(parts: Sequence[Fit] | Sequence[Linearisation]) -> dict[str, NDArray]:
        names = [part.name for part in fields(parts[0]) if part.name != "linear"]
        return {name: function(*(vars(part)[name] for part in parts)) for name in names}

    return Fit(linear=Linearisation(**of([fit.linear for fit in fits])), **of(fits))


EQUAL_COST = 0.01
"""Negative log likelihoods this close are one minimum."""

ROUNDING = 1e-12
"""Added to a correlation's diagonal: with more unknowns than readings it is singular, and rounding decides whether."""
_TINY = 1e-12
"""A predicted decrease below this is rounding."""


def _blocked(gradient: Array, x: Array, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """Unknowns that the gradient pushes against their box, (L, m); one with lower = upper is pinned."""
    return ((x <= lower) & (gradient >= 0.0)) | ((x >= upper) & (gradient <= 0.0))


def _reduced(gradient: Array, hessian: Array, blocked: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The problem without its blocked unknowns: no gradient, no coupling, a curvature that moves nothing."""
    free = ~blocked
    coupled = hessian * free[:, :, None] * free[:, None, :]
    return np.where(blocked, 0.0, gradient), coupled + blocked[:, :, None] * np.eye(hessian.shape[-1])


def _step(gradient: Array, hessian: Array, added: Array, step_max: Array) -> Array:
    """The step (L, m) of Hessians with something added to their diagonals, no unknown moved by more than its most."""
    damped = hessian + added[:, :, None] * np.eye(hessian.shape[-1])
    step = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
    # Shortening the whole step keeps its direction; clipping single unknowns would not.
    return np.asarray(step / np.maximum(1.0, np.max(np.abs(step) / step_max, axis=1))[:, None])


def _newton(gradient: Array, hessian: Array, x: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
    """Newton decrement (L,), Newton step (L, m) and the Hessian without blocked unknowns (L, m, m)."""
    reduced, curvature = _reduced(gradient, hessian, _blocked(gradient, x, lower, upper))
    finite = np.isfinite(reduced).all(axis=1) & np.isfinite(curvature).all(axis=(1, 2))
    decrement, step = np.full(len(x), np.inf), np.full(x.shape, np.inf)
    correlation, scale = _scaled(curvature[finite])
    step[finite] = np.linalg.solve(correlation, (reduced[finite] / scale)[:, :, None])[:, :, 0] / scale
    decrement[finite] = np.sqrt(np.maximum(np.einsum("lj,lj->l", step[finite], reduced[finite]), 0.0))
    curvature[~finite] = np.eye(x.shape[1])
    return decrement, step, curvature


def covariance(hessian: Array) -> Array:
    """Covariance from a Fisher information matrix that may be singular.

    A prior of standard deviation `UNINFORMED` replaces missing information, so that a shut EGR valve gives a huge
    standard deviation of A_egrmax and leaves the others untouched.

    Args:
        hessian: (.., m, m) Fisher information of the logarithms [-].

    Returns:
        (.., m, m) covariance [-].
    """
    correlation, scale = _scaled(hessian)
    return np.asarray(np.linalg.inv(correlation) / (scale[..., :, None] * scale[..., None, :]))


def symmetric_root(covariance: Array) -> Array:
    """R with R R = covariance, (..., m, m); what rounding makes negative where nothing is told counts as 0.

    Draws with it are the same on every processor; eigenvectors have any signs.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(root, dtype=np.float64)


def without_negative(matrix: Array) -> Array:
    """The nearest (m, m) symmetric matrix without negative eigenvalues: rounding makes directions that nothing says
    negative."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)


def _scaled(hessian: Array) -> tuple[Array, Array]:
    """Fisher information (.., m, m) with a diagonal of ones, and the roots (.., m) of what its diagonal was."""
    information = hessian + UNINFORMED**-2.0 * np.eye(hessian.shape[-1])
    scale = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    return information / (scale[..., :, None] * scale[..., None, :]) + ROUNDING * np.eye(hessian.shape[-1]), scale


UNINFORMED = 1e3
"""Log standard deviation that stands for no information at all [-]."""
