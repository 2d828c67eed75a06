"""Single shooting: predicted readings and their sensitivities to health parameters and initial states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.engine import (
    HEALTH,
    Actuation,
    Observations,
    ParameterBatch,
    actuate,
    parameter_batch,
    simulate_states,
)
from dieseltwin.errors import InputError
from dieseltwin.identification.learned import ErrorDirections, LearnedSimulator
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.least_squares import Linearisation, symmetric_root

Index = NDArray[np.int_]
Simulator = Callable[[Sequence[Actuation], ParameterBatch, Array, Index], Observations]
"""(actuation of each lane, B parameter sets, (B, 3) initial states, (B,) variant of the maps) -> observations."""

UNKNOWNS: tuple[str, ...] = (*HEALTH, "p_im", "p_em", "omega_t")
"""Order of the free quantities; all are estimated as logarithms, because all are positive and matter relatively."""

N_HEALTH = len(HEALTH)
N_UNKNOWNS = len(UNKNOWNS)

STEP_S = 0.0125
"""Integration step [s]: shifts a parameter by at most 0.002 of its bound on the benchmark segments (25 ms: 0.03)."""

FIRST_STEP_S = 0.00625
"""Integration step of the first sample interval [s]: an initial p_em that is off decays within 11-41 ms."""

DIFFERENCE = 1e-5
"""Step of the forward differences in the logarithm [-].

Small, because the EGR flow has a kink at Pi_egr = 1: a step of 1e-4 across it moved a bound by 3 %. Rounding leaves
1e-9.
"""


def exact_engine(
    actuations: Sequence[Actuation], batch: ParameterBatch, initial: Array, variant: Index
) -> Observations:
    """The `Simulator` of the exact formulae, which have no variants."""
    return simulate_states(actuations, batch, initial)


@dataclass(frozen=True)
class Shooting:
    """Segments of one sample grid, ready to be simulated with any unknowns.

    Attributes:
        problems: S segments with the same sample times after the start.
        simulator: engine with the exact formulae, or with learned maps.
        step_s: largest integration step [s].
        actuations: actuator states of each segment.
        weights: (S, n, C) one over sigma, 0 where masked.
    """

    problems: tuple[SegmentProblem, ...]
    simulator: Simulator = exact_engine
    step_s: float = STEP_S
    actuations: tuple[Actuation, ...] = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if len({grid_key(p) for p in self.problems}) != 1:
            raise InputError("segments of one batch", "different sample times", "one grid", "group them by `grid_key`")
        terms = self.problems[0].parameters.terms
        if any(p.parameters.terms != terms for p in self.problems):
            raise InputError("segments of one batch", "different terms of the engine", "the same terms", "group them")
        if terms and self.simulator is not exact_engine:
            raise InputError("terms of the engine", "learned maps", "the exact maps", "take --maps exact, or no terms")
        steps_s = np.full(len(self.problems[0].time_s) - 1, self.step_s)
        steps_s[0] = min(FIRST_STEP_S, self.step_s)
        actuations = tuple(actuate(p.inputs, p.parameters, steps_s) for p in self.problems)
        object.__setattr__(self, "actuations", actuations)
        weights = np.stack([np.where(p.observed, 1.0 / p.sigma, 0.0) for p in self.problems])
        object.__setattr__(self, "weights", weights)

    def simulate(self, segment: Index, unknowns: Array, variant: Index | None = None) -> Observations:
        """Simulate lanes, each with its own segment and unknowns.

        Args:
            segment: (B,) index into `problems`.
            unknowns: (B, 7) logarithms in the order of `UNKNOWNS` [log SI].
            variant: (B,) variant of the learned maps; None = the nominal maps.

        Returns:
            The engine's observations: states (B, n, 5), measured (B, n, C) on average over the noise.
        """
        values = np.exp(unknowns)
        batches = np.empty((0, 0))
        for s in np.unique(segment):
            lanes = segment == s
            columns = {name: values[lanes, i] for i, name in enumerate(HEALTH)}
            part = parameter_batch(self.problems[s].parameters, size=None, **columns).values
            if not batches.size:
                batches = np.empty((part.shape[0], len(segment)))
            batches[:, lanes] = part
        actuations = [self.actuations[s] for s in segment]
        variants = np.zeros(len(segment), dtype=np.int64) if variant is None else variant
        batch = ParameterBatch(batches, self.problems[0].parameters.terms)
        found = self.simulator(actuations, batch, values[:, N_HEALTH:], variants)
        for s in np.unique(segment):
            for j, cut in self.problems[s].cut_off.items():
                found.measured[segment == s, :, j] = cut.expected(found.measured[segment == s, :, j])
        return found

    def degrees_of_freedom(self) -> Index:
        """(S,) readings minus unknowns of each segment, at least 1."""
        return np.maximum((self.weights > 0.0).sum(axis=(1, 2)) - N_UNKNOWNS, 1)


class ShootingRuns:
    """Least-squares problems of L runs that share a `Shooting`; keeps each run's Jacobian between evaluations.

    Args:
        shooting: the segments.
        segment: (L,) segment of each run.
        readings: (L, n, C) what each run sees [SI], NaN where masked.
        errors: what the model itself may be off by in each segment's readings; None = nothing.
    """

    def __init__(
        self,
        shooting: Shooting,
        segment: Index,
        readings: Array,
        errors: Sequence[ErrorDirections] | None = None,
    ) -> None:
        self.shooting, self.segment = shooting, segment
        count = len(segment)
        self._errors = errors
        self._weights = shooting.weights[segment].reshape(count, -1)
        self._observed = np.where(self._weights > 0.0, readings.reshape(count, -1), 0.0)
        self._jacobian = np.zeros((count, N_UNKNOWNS, self._observed.shape[1]))

    def __call__(self, index: Index, unknowns: Array, renew: NDArray[np.bool_]) -> Linearisation:
        """Cost, gradient and Gauss-Newton Hessian of chosen runs.

        The Jacobian comes from forward differences: eight simulations (one nominal, seven perturbed) in lockstep that
        start from the same fixed-point guess of x_r and T_1; other starts would bias eta_sc and h_tot.
        A run that keeps its Jacobian costs one simulation.

        Args:
            index: (K,) runs to evaluate.
            unknowns: (K, 7) logarithms.
            renew: (K,) whether to compute the Jacobian anew or to keep the run's last one.

        Returns:
            The linearised problems; a diverged simulation has an infinite cost.
        """
        eight, single = np.flatnonzero(renew), np.flatnonzero(~renew)
        lanes = np.repeat(unknowns[eight, None, :], N_UNKNOWNS + 1, axis=1)
        lanes[:, 1:, :] += DIFFERENCE * np.eye(N_UNKNOWNS)
        lanes = np.concatenate([lanes.reshape(-1, N_UNKNOWNS), unknowns[single]])
        run = index[np.concatenate([np.repeat(eight, N_UNKNOWNS + 1), single])]
        measured = self.shooting.simulate(self.segment[run], lanes).measured.reshape(len(run), -1)
        split = len(eight) * (N_UNKNOWNS + 1)
        groups = measured[:split].reshape(len(eight), N_UNKNOWNS + 1, measured.shape[1])
        predicted = np.empty((len(index), self._observed.shape[1]))
        predicted[eight], predicted[single] = groups[:, 0], measured[split:]
        scale = (self._weights[index[eight]] / DIFFERENCE)[:, None, :]
        self._jacobian[index[eight]] = self._whitened(index[eight], (groups[:, 1:] - groups[:, :1]) * scale)
        residual = self._whitened(index, (predicted - self._observed[index]) * self._weights[index])
        jacobian = self._jacobian[index]
        cost = 0.5 * np.einsum("ln,ln->l", residual, residual)
        gradient = np.einsum("lkn,ln->lk", jacobian, residual)
        hessian = jacobian @ jacobian.transpose(0, 2, 1)
        finite = np.isfinite(cost) & np.isfinite(gradient).all(axis=1) & np.isfinite(hessian).all(axis=(1, 2))
        return Linearisation(np.where(finite, cost, np.inf), gradient, hessian)

    def _whitened(self, index: Index, rows: Array) -> Array:
        if self._errors is not None:
            for s in np.unique(self.segment[index]):
                chosen = self.segment[index] == s
                rows[chosen] = self._errors[s].whiten(rows[chosen])
        return rows


def learned_errors(shooting: Shooting, learned: LearnedSimulator, unknowns: Array) -> Array:
    """What the uncertainty of learned maps may do to the readings of each segment.

    Args:
        shooting: S segments.
        learned: the maps and their variants.
        unknowns: (S, 7) logarithms at which to evaluate.

    Returns:
        (S, M, n, C) changes of the readings, a standard deviation of each error [SI].
    """
    count, variants = len(shooting.problems), len(learned.variants)
    segment, variant = np.repeat(np.arange(count), variants), np.tile(np.arange(variants), count)
    measured = shooting.simulate(segment, unknowns[segment], variant).measured
    measured = measured.reshape(count, variants, *measured.shape[1:])
    return np.asarray((measured[:, 1:] - measured[:, :1]) * learned.scale[1:, None, None])


def grid_key(problem: SegmentProblem) -> bytes:
    """Sample times after the start, to the microsecond: segments with the same key can be simulated in one batch."""
    return np.round((problem.time_s - problem.time_s[0]) * 1e6).astype(np.int64).tobytes()


def by_grid(problems: Sequence[SegmentProblem]) -> list[list[int]]:
    """Group segments that have the same sample times after the start.

    Args:
        problems: segments.

    Returns:
        Lists of indices into `problems`.
    """
    groups: dict[bytes, list[int]] = {}
    for i, problem in enumerate(problems):
        groups.setdefault(grid_key(problem), []).append(i)
    return list(groups.values())


SAMPLE_SPREAD = 0.5
"""Draws for bands leave the estimate by at most this logarithm, so that an unidentifiable parameter stays plausible."""


def _root(covariance: Array) -> Array:
    """L with L L' = covariance, (..., 7, 7)."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    except np.linalg.LinAlgError:
        return symmetric_root(covariance)


def sample_states(
    shooting: Shooting, s: int, unknowns: Array, log_covariance: Array, normal: Array
) -> tuple[Array, Array]:
    """K draws from Gaussians of the logarithms, simulated: states (K, n, 5) and parameters (K, 4).

    Args:
        shooting: the problems; s: which of them.
        unknowns: (K, 7) or (7,) centres, logarithms.
        log_covariance: (K, 7, 7) or (1, 7, 7) joint covariance of the logarithms.
        normal: (K, 7) standard normal draws.
    """
    factor = np.broadcast_to(_root(log_covariance), (len(normal), *log_covariance.shape[1:]))
    move = np.einsum("kij,kj->ki", factor, normal)
    # The whole draw is shortened: clipped one by one, unknowns that cancel each other would move the states apart.
    drawn = unknowns + move * np.minimum(SAMPLE_SPREAD / np.abs(move).max(axis=1, keepdims=True), 1.0)
    states = shooting.simulate(np.full(len(drawn), s), drawn).states
    return states, np.exp(drawn[:, :N_HEALTH])
