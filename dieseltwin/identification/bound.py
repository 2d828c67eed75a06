"""Cramer-Rao bound: what a segment can tell at best, and the rule for "not identifiable here"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dieseltwin.arrays import Array
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.shooting import (
    N_HEALTH,
    Shooting,
    ShootingRuns,
    Simulator,
    by_grid,
    exact_engine,
    sample_states,
)
from dieseltwin.least_squares import covariance

IDENTIFIABLE_BELOW = 0.25
"""The protocol's largest relative bound that counts as identifiable: a known parameter is known to a quarter."""

NO_INFORMATION = 100.0
"""A relative bound beyond this is reported as infinite: the readings say nothing about the parameter."""


@dataclass(frozen=True)
class Bound:
    """Cramer-Rao bound of one segment: smallest standard deviation of an unbiased estimator.

    Four parameters and three initial states are free, actuators are known, noise is Gaussian with `problem.sigma`.

    Attributes:
        absolute: (4,) standard deviation of the health parameters [m2, m2, -, W/(m2 K)]; infinite without
            information.
        relative: (4,) the same over the value [-].
        initial: (3,) relative standard deviation of p_im, p_em, omega_t at the start [-].
        fisher: (7, 7) information matrix of the logarithms [-].
    """

    absolute: Array
    relative: Array
    initial: Array
    fisher: Array

    def identifiable(self, below: float) -> NDArray[np.bool_]:
        """(4,) whether the relative bound is at most `below` [-] (`identify.identifiable_bound_rel` of params.yaml)."""
        return np.asarray(self.relative <= below)


def cramer_rao(
    problems: Sequence[SegmentProblem],
    health: ArrayLike,
    initial: ArrayLike,
    *,
    simulator: Simulator = exact_engine,
) -> list[Bound]:
    """Bound of each segment at given values.

    Args:
        problems: S segments.
        health: (4,) or (S, 4) values at which to evaluate [m2, m2, -, W/(m2 K)].
        initial: (S, 3) or (3,) p_im, p_em, omega_t at the start [Pa, Pa, rad/s].
        simulator: exact engine or one with learned maps.

    Returns:
        One bound for each segment.
    """
    count = len(problems)
    parts = (np.broadcast_to(health, (count, N_HEALTH)), np.broadcast_to(initial, (count, 3)))
    values = np.concatenate(parts, axis=1).astype(np.float64)
    result: dict[int, Bound] = {}
    for group in by_grid(problems):
        chosen = [problems[i] for i in group]
        everything = np.arange(len(group))
        runs = ShootingRuns(Shooting(tuple(chosen), simulator), everything, np.stack([p.measured for p in chosen]))
        linear = runs(everything, np.log(values[group]), np.ones(len(group), dtype=bool))
        for i, fisher in zip(group, linear.hessian, strict=True):
            result[i] = bound_from_fisher(fisher, values[i, :N_HEALTH])
    return [result[i] for i in range(count)]


def cautious_bound(
    problems: Sequence[SegmentProblem],
    health: ArrayLike,
    initial: ArrayLike,
    below: float,
    *,
    simulator: Simulator = exact_engine,
) -> list[Bound]:
    """Bounds at the estimate; `relative` (identifiable or not) is the larger of that and the one at the nominal values.

    A wrong estimate must not vouch for itself: at idle h_tot can run off to where eta_sc looks certain. Where the
    larger one is above `below`, `absolute` is that share of the estimate too: a parameter that is not identifiable
    shows the bound that says so.

    Args:
        problems: S segments.
        health: (4,) or (S, 4) estimates [m2, m2, -, W/(m2 K)]; initial: (S, 3) or (3,), see `cramer_rao`.
        below: largest relative bound that counts as identifiable [-].
        simulator: exact engine or one with learned maps.
    """
    at_estimate = cramer_rao(problems, health, initial, simulator=simulator)
    nominal = np.stack([problem.parameters.health() for problem in problems])
    at_nominal = cramer_rao(problems, nominal, initial, simulator=simulator)
    found = []
    for own, other, values in zip(at_estimate, at_nominal, np.broadcast_to(health, nominal.shape), strict=True):
        relative = np.maximum(own.relative, other.relative)
        absolute = np.where(relative <= below, own.absolute, relative * values)
        found.append(replace(own, relative=relative, absolute=absolute))
    return found


def nominal_bound(problem: SegmentProblem, states: Array) -> Bound:
    """Bound at the nominal values and where the pooled states (n, 5) of an estimate begin [Pa, Pa, rad/s, -, K].

    For methods that can end far off: a wrong estimate must not vouch for its own bound.
    """
    return cramer_rao([problem], problem.parameters.health(), states[0, :3])[0]


def bound_from_fisher(fisher: Array, health: ArrayLike) -> Bound:
    """Turn an information matrix of logarithms into a bound.

    Args:
        fisher: (7, 7) information of the logarithms [-].
        health: (4,) values of the parameters [m2, m2, -, W/(m2 K)].

    Returns:
        The bound.
    """
    std = np.sqrt(np.diag(covariance(fisher)))
    relative = np.where(std[:N_HEALTH] > NO_INFORMATION, np.inf, std[:N_HEALTH])
    return Bound(relative * np.asarray(health), relative, std[N_HEALTH:], fisher)


def states_within(
    problem: SegmentProblem, health: ArrayLike, initial: ArrayLike, bound: Bound, normal: Array
) -> tuple[Array, Array]:
    """Trajectories that a bound leaves possible around an estimate, for bands.

    Args:
        problem: the segment; health: (4,) and initial: (3,) its estimate [m2, m2, -, W/(m2 K), Pa, Pa, rad/s].
        bound: its bound, whose information matrix gives the joint covariance.
        normal: (K, 7) standard normal draws.

    Returns:
        States (K, n, 5) and parameters (K, 4).
    """
    centre = np.log(np.concatenate([np.asarray(health), np.asarray(initial)]))
    return sample_states(Shooting((problem,), exact_engine), 0, centre, covariance(bound.fisher)[None], normal)
