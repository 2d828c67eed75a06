"""Levenberg-Marquardt for many small least-squares problems at once, with an acceptance test for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int_]


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


Linearise = Callable[[Index, Array, NDArray[np.bool_]], Linearisation]
"""(K indices, (K, m) unknowns, (K,) renew) -> cost, gradient, Hessian; without `renew` the last Jacobian serves."""

CHORD_DISTANCE = 1.0
"""A move of fewer standard deviations than this keeps its Jacobian, which changes by some tenths of a per cent."""
ACCEPT_GAIN = 1e-3
"""Smallest share of the predicted decrease that a step must bring."""
GOOD_GAIN, DAMPING_DOWN, DAMPING_UP = 0.5, 0.1, 8.0
"""Damping falls after a step that brought at least half of what was predicted, and rises after a refused one."""
DAMPING_MIN, DAMPING_MAX = 1e-9, 1e9
CONVERGED_BELOW = 0.1
"""Remaining move of an unknown that counts as converged [standard deviations]: it adds 1 % to a variance at most."""
NEGLIGIBLE = 1e-4
"""A decrease of the negative log likelihood that nobody can tell from none."""
ALL = slice(None)
CURVATURE_MIN = 1.0
"""Least curvature that damping acts on: a log standard deviation of 1 counts as no knowledge at all."""


@dataclass(frozen=True)
class Fit:
    """State of L problems.

    Attributes:
        unknowns: (L, m) best values.
        linear: cost, gradient and Hessian there.
        damping: (L,) Levenberg-Marquardt factor.
        decrement: (L,) distance to the minimum that the quadratic model predicts, in standard deviations [-].
        remaining: (L,) largest move of an unknown of interest on that way, in its standard deviations [-].
        iterations: (L,) evaluations used.
        converged: (L,) gradient so small that no unknown of interest would move by `CONVERGED_BELOW`.
    """

    unknowns: Array
    linear: Linearisation
    damping: Array
    decrement: Array
    remaining: Array
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


def levenberg_marquardt(
    linearise: Linearise,
    start: Array,
    box: Box,
    *,
    tolerance: float,
    iterations_max: int,
    interest: slice = ALL,
    damping: float | Array = 1e-2,
) -> Fit:
    """Minimise L sums of squares, each with its own damping; a problem leaves the batch once it has converged.

    A trial point is linearised together with its cost: almost every trial is accepted, and then nothing is computed
    twice. Converged means a Newton decrement sqrt(g' H^-1 g) below `tolerance`: the rest of the way is that share of
    a standard deviation, whatever the units.

    Args:
        linearise: evaluates chosen problems.
        start: (L, m) first values.
        box: where the unknowns may go.
        tolerance: largest decrement that counts as converged [standard deviations].
        iterations_max: most evaluations after the first.
        interest: unknowns whose convergence is judged; the others are nuisances, which may rest at a kink.
        damping: first factor, one for all or (L,).

    Returns:
        The best point of each problem.
    """
    lower, upper, step_max = box.lower, box.upper, box.step_max
    count = len(start)
    everything = np.arange(count)
    lower, upper = np.broadcast_to(lower, start.shape), np.broadcast_to(upper, start.shape)
    x = np.clip(start, lower, upper)
    first = linearise(everything, x, np.ones(count, dtype=bool))
    cost, gradient, hessian = first.cost.copy(), first.gradient.copy(), first.hessian.copy()
    factor = np.broadcast_to(damping, (count,)).astype(np.float64)
    decrement, _ = _newton(gradient, hessian, x, lower, upper)
    iterations = np.ones(count, dtype=np.int64)
    stale = np.zeros(count, dtype=bool)  # the Jacobian belongs to an earlier point
    renewal = np.zeros(count, dtype=bool)  # no step next: the Jacobian is renewed where the problem stands
    active = everything[np.isfinite(cost) & (decrement > tolerance)]
    for _ in range(iterations_max):
        if not len(active):
            break
        again = renewal[active]
        blocked = _blocked(gradient[active], x[active], lower[active], upper[active])
        reduced = _reduced(gradient[active], hessian[active], blocked)
        step = np.where(again[:, None], 0.0, _step(*reduced, factor[active], step_max))
        trial = np.clip(x[active] + step, lower[active], upper[active])
        step = trial - x[active]
        square = np.einsum("lj,ljk,lk->l", step, hessian[active], step)
        predicted = -np.einsum("lk,lk->l", gradient[active], step) - 0.5 * square
        renew = again | (square > CHORD_DISTANCE**2)
        there = linearise(active, trial, renew)
        iterations[active] += 1
        gain = np.where(predicted > 0.0, (cost[active] - there.cost) / np.maximum(predicted, _TINY), -1.0)
        accepted = again | (np.isfinite(there.cost) & (gain > ACCEPT_GAIN))
        # A refused step with a Jacobian from elsewhere says little: renew it before taking shorter steps.
        ask = ~accepted & stale[active]
        rises, falls = ~accepted & ~ask, accepted & ~again & (gain > GOOD_GAIN)
        factor[active] *= np.where(falls, DAMPING_DOWN, np.where(rises, DAMPING_UP, 1.0))
        factor = np.clip(factor, DAMPING_MIN, DAMPING_MAX)
        moved = active[accepted]
        x[moved], cost[moved] = trial[accepted], there.cost[accepted]
        gradient[moved], hessian[moved] = there.gradient[accepted], there.hessian[accepted]
        stale[moved], renewal[active] = ~renew[accepted], ask
        decrement[moved], _ = _newton(gradient[moved], hessian[moved], x[moved], lower[moved], upper[moved])
        # A refused step that promised next to nothing: a kink of the model, not a way on.
        stuck = rises & ((predicted < NEGLIGIBLE) | (factor[active] >= DAMPING_MAX))
        active = active[(decrement[active] > tolerance) & ~stuck]
    remaining = _newton(gradient, hessian, x, lower, upper)[1][:, interest].max(axis=1)
    converged = np.isfinite(cost) & (remaining <= CONVERGED_BELOW)
    return Fit(x, Linearisation(cost, gradient, hessian), factor, decrement, remaining, iterations, converged)


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
    linear = Linearisation(
        merged(fit.linear.cost, other.linear.cost),
        merged(fit.linear.gradient, other.linear.gradient),
        merged(fit.linear.hessian, other.linear.hessian),
    )
    return Fit(
        merged(fit.unknowns, other.unknowns),
        linear,
        merged(fit.damping, other.damping),
        merged(fit.decrement, other.decrement),
        merged(fit.remaining, other.remaining),
        iterations,
        merged(fit.converged, other.converged),
    )


def concatenated(parts: Sequence[Fit]) -> Fit:
    """One fit of all problems of several.

    Args:
        parts: fits with the same unknowns.

    Returns:
        Their problems in order.
    """
    linear = Linearisation(
        np.concatenate([p.linear.cost for p in parts]),
        np.concatenate([p.linear.gradient for p in parts]),
        np.concatenate([p.linear.hessian for p in parts]),
    )
    return Fit(
        np.concatenate([p.unknowns for p in parts]),
        linear,
        np.concatenate([p.damping for p in parts]),
        np.concatenate([p.decrement for p in parts]),
        np.concatenate([p.remaining for p in parts]),
        np.concatenate([p.iterations for p in parts]),
        np.concatenate([p.converged for p in parts]),
    )


EQUAL_COST = 0.01
"""Negative log likelihoods this close are one minimum."""

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


def _step(gradient: Array, hessian: Array, factor: Array, step_max: Array) -> Array:
    diagonal = np.maximum(np.diagonal(hessian, axis1=1, axis2=2), CURVATURE_MIN)
    damped = hessian + (factor[:, None] * diagonal)[:, :, None] * np.eye(hessian.shape[-1])
    step = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
    # Shortening the whole step keeps its direction; clipping single unknowns would not.
    return np.asarray(step / np.maximum(1.0, np.max(np.abs(step) / step_max, axis=1))[:, None])


def _newton(gradient: Array, hessian: Array, x: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Newton decrement (L,), and the Newton step of each unknown over its standard deviation (L, m)."""
    reduced, curvature = _reduced(gradient, hessian, _blocked(gradient, x, lower, upper))
    finite = np.isfinite(reduced).all(axis=1) & np.isfinite(curvature).all(axis=(1, 2))
    decrement, remaining = np.full(len(x), np.inf), np.full(x.shape, np.inf)
    variance = covariance(curvature[finite])
    step = np.einsum("ljk,lk->lj", variance, reduced[finite])
    decrement[finite] = np.sqrt(np.maximum(np.einsum("lj,lj->l", step, reduced[finite]), 0.0))
    remaining[finite] = np.abs(step) / np.sqrt(np.diagonal(variance, axis1=1, axis2=2))
    return decrement, remaining


def covariance(hessian: Array) -> Array:
    """Covariance from a Fisher information matrix that may be singular.

    A prior of standard deviation `UNINFORMED` replaces missing information, so that a shut EGR valve gives a huge
    standard deviation of A_egrmax and leaves the others untouched.

    Args:
        hessian: (.., m, m) Fisher information of the logarithms [-].

    Returns:
        (.., m, m) covariance [-].
    """
    information = hessian + UNINFORMED**-2.0 * np.eye(hessian.shape[-1])
    scale = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    outer = scale[..., :, None] * scale[..., None, :]
    return np.asarray(np.linalg.inv(information / outer) / outer)


UNINFORMED = 1e3
"""Log standard deviation that stands for no information at all [-]."""
