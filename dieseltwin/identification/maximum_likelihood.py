"""Classical estimator: maximum likelihood by single shooting with sensitivities and Levenberg-Marquardt."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.engine.simulate import settle_first
from dieseltwin.identification.bound import cautious_bound
from dieseltwin.identification.input_errors import input_errors
from dieseltwin.identification.learned import ErrorDirections, LearnedSimulator
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import STATE_SAMPLES, SegmentEstimate, intervals_from_log_std
from dieseltwin.identification.settings import ClassicalConfig
from dieseltwin.identification.shooting import (
    N_HEALTH,
    N_UNKNOWNS,
    UNKNOWNS,
    Shooting,
    ShootingRuns,
    Simulator,
    by_grid,
    exact_engine,
    learned_errors,
    sample_states,
)
from dieseltwin.identification.unknowns import health_of, start_centre, starts
from dieseltwin.least_squares import (
    Box,
    Fit,
    Problems,
    concatenated,
    covariance,
    keep_better,
    levenberg_marquardt,
)

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig, StartConfig
    from dieseltwin.surrogates.empirical import EmpiricalMaps

Index = NDArray[np.int_]
METHOD = "classical"

BLOCK = 256
"""Runs that are iterated together: their Jacobians take 100 kB each."""
STEP_MAX = np.array([0.5] * N_HEALTH + [0.2] * (N_UNKNOWNS - N_HEALTH))
"""Largest change of a logarithm in one step: the linear model is trusted no further."""
HEALTH_RANGE = 3.0
"""Health parameters stay within this logarithm of their nominal values: a factor of twenty, met without information."""
INITIAL_RANGE = 1.0
"""Initial states stay within this logarithm of the first readings."""
SECOND_LOOK = 0.4
"""A health parameter that ends further than this logarithm from its nominal value is fitted a second time."""
WORSE = 0.5
"""Negative log likelihood above that of another run of the same readings that makes a minimum a local one."""
NOTHING = np.array([], dtype=np.int64)
START_PRESSURES = np.array([UNKNOWNS.index("p_im"), UNKNOWNS.index("p_em")])


def estimate(
    problems: Sequence[SegmentProblem],
    runs: int,
    seed: int,
    *,
    bodies: object = None,
    operators: object = None,
    maps: EmpiricalMaps | None = None,
    config: IdentifyConfig,
) -> list[SegmentEstimate]:
    """Estimate the health parameters of each segment by maximum likelihood.

    Four parameters and the initial p_im, p_em, omega_t are free; x_r and T_1 start at their fixed point; actuators
    follow from the inputs with their history. Standard deviations and 90 % intervals come from the inverse Hessian, for
    the logarithm of each parameter.

    Args:
        problems: segments; `problem.parameters` gives the known parameters and the start.
        runs: runs R on each segment: other starts, and other readings where the problem has noise draws.
        seed: seed of the starts and of the draws for the bands.
        bodies, operators: not used by this method.
        maps: learned empirical maps (improved kind) in place of the formulae; None = exact. The spread of their members
            is taken as uncertainty of the model: it weighs the readings and widens the intervals.
        config: `identify` of params.yaml.

    Returns:
        One estimate for each segment, in order.
    """
    settings = cast(ClassicalConfig, config.of(METHOD))
    learned = None if maps is None else LearnedSimulator(maps)
    simulator: Simulator = exact_engine if learned is None else learned
    rng = np.random.default_rng(seed)
    begin = [_starts(problem, runs, config.start, rng) for problem in problems]
    normal = [rng.standard_normal((STATE_SAMPLES, N_UNKNOWNS)) for _ in problems]
    result: dict[int, SegmentEstimate] = {}
    for group in by_grid(problems):
        shooting = Shooting(tuple(problems[i] for i in group), simulator)
        # Loads or compiles the kernel, so that the time taken is that of warm runs.
        shooting.simulate(np.zeros(2, dtype=np.int64), begin[group[0]][[0, 0]])
        began = time.perf_counter()
        fit = fit_runs(shooting, np.stack([begin[i] for i in group]), settings)
        ends = fit.unknowns.reshape(len(group), runs, N_UNKNOWNS)
        errors = _errors(shooting, learned, np.median(ends, axis=1))
        if errors is not None:
            fit = fit_runs(shooting, ends, settings, errors)
        seconds = (time.perf_counter() - began) / (runs * len(group))
        ambient = _by_ambient(shooting, fit, settings, errors)
        parts = [
            replace(part, ambient_log=change)
            for part, change in zip(
                _segments(shooting, fit, runs, [normal[i] for i in group], seconds, config.identifiable_bound_rel),
                ambient, strict=True,
            )
        ]  # fmt: skip
        result.update(zip(group, parts, strict=True))
    return [result[i] for i in range(len(problems))]


def _errors(shooting: Shooting, learned: LearnedSimulator | None, unknowns: Array) -> list[ErrorDirections] | None:
    """What learned maps and inputs between the rows may be off by in each segment; None where nothing is."""
    count, shape = len(shooting.problems), shooting.weights.shape[1:]
    of_maps = np.zeros((count, 0, *shape))
    if learned is not None and len(learned.variants) > 1:
        of_maps = learned_errors(shooting, learned, unknowns)
    found = [
        np.concatenate([of_maps[s], input_errors(problem, shooting.simulator, unknowns[s])])
        for s, problem in enumerate(shooting.problems)
    ]
    if not any(len(moved) for moved in found):
        return None
    pairs = zip(found, shooting.weights, strict=True)
    return [ErrorDirections.of((moved * weights).reshape(len(moved), -1).T) for moved, weights in pairs]


def _by_ambient(
    shooting: Shooting, fit: Fit, settings: ClassicalConfig, errors: Sequence[ErrorDirections] | None
) -> Array:
    """Changes (S, 4) of the logarithms of the health parameters by one standard deviation of the ambient pressure.

    Weighed like noise, a wrong ambient would be free to take up what the engine lacks; so estimates stay as they are.
    """
    count = len(shooting.problems)
    if not any(problem.p_amb_std_pa for problem in shooting.problems):
        return np.zeros((count, N_HEALTH))
    higher = [
        replace(p, parameters=p.parameters.replace(p_amb=p.parameters.p_amb + p.p_amb_std_pa))
        for p in shooting.problems
    ]
    ends = fit.unknowns.reshape(count, -1, N_UNKNOWNS)
    there = fit_runs(Shooting(tuple(higher), shooting.simulator), ends, settings, errors).unknowns
    return np.asarray(np.median(there.reshape(ends.shape) - ends, axis=1)[:, :N_HEALTH])


def fit_runs(
    shooting: Shooting, begin: Array, settings: ClassicalConfig, errors: Sequence[ErrorDirections] | None = None
) -> Fit:
    """Fit every run of every segment.

    The sensor of W_egr has a kink where the flow stops, and a start at which p_em falls below p_im can sit on it. A run
    that ends unconverged goes on with p_im and p_em of the start pinned there.

    At idle the likelihood can have a second minimum far away (more eta_sc balanced by more h_tot) that is nearly as
    good. A run that still hasn't converged, or has ended far from the nominal values, is fitted once more from the
    nominal values, and the better end is kept.

    Args:
        shooting: S segments.
        begin: (S, R, 7) logarithms to start from, R runs of each segment.
        settings: iteration settings.
        errors: what the model itself may be off by in each segment; None = nothing.

    Returns:
        Fit of S R problems, segment by segment.
    """
    runs = begin.shape[1]
    segment = np.repeat(np.arange(len(shooting.problems)), runs)
    readings = np.concatenate([p.readings(runs) for p in shooting.problems])
    start = begin.reshape(-1, N_UNKNOWNS)
    nominal = np.log(np.stack([health_of(p.parameters) for p in shooting.problems]))[segment]
    lower = np.concatenate([nominal - HEALTH_RANGE, start[:, N_HEALTH:] - INITIAL_RANGE], axis=1)
    upper = np.concatenate([nominal + HEALTH_RANGE, start[:, N_HEALTH:] + INITIAL_RANGE], axis=1)

    def fitted(rows: Index, at: Array, pinned: Index = NOTHING) -> Fit:
        low, high = lower[rows], upper[rows]
        low[:, pinned] = high[:, pinned] = at[:, pinned]
        return levenberg_marquardt(
            Problems(ShootingRuns(shooting, segment[rows], readings[rows], errors)),
            at,
            Box(low, high, STEP_MAX),
            tolerance=settings.tolerance,
            iterations_max=settings.iterations_max,
            interest=slice(0, N_HEALTH),
            damping=settings.damping_start,
        )

    parts = []
    for first in range(0, len(segment), BLOCK):
        rows = np.arange(first, min(first + BLOCK, len(segment)))
        fit = fitted(rows, start[rows])
        stuck = np.flatnonzero(~fit.converged)
        if len(stuck):
            fit = keep_better(fit, fitted(rows[stuck], fit.unknowns[stuck], START_PRESSURES), stuck)
        moved = np.abs(fit.unknowns[:, :N_HEALTH] - nominal[rows]).max(axis=1)
        again = np.flatnonzero((moved > SECOND_LOOK) | ~fit.converged)
        if len(again):
            second = np.concatenate([nominal[rows[again]], start[rows[again], N_HEALTH:]], axis=1)
            fit = keep_better(fit, fitted(rows[again], second), again)
        parts.append(fit)
    return concatenated(parts)


def _starts(problem: SegmentProblem, runs: int, start: StartConfig, rng: np.random.Generator) -> Array:
    centre = start_centre(problem.parameters, problem.truth, start.at)
    health = starts(centre, runs, rng, start.sd_masked)
    rest = settle_first(problem.inputs, problem.parameters)
    return np.log(np.concatenate([health, problem.first_states(problem.readings(runs), absent=rest)], axis=1))


def _segments(
    shooting: Shooting, fit: Fit, runs: int, normal: Sequence[Array], seconds: float, below: float
) -> list[SegmentEstimate]:
    count = len(shooting.problems)
    unknowns = fit.unknowns.reshape(count, runs, N_UNKNOWNS)
    cost = fit.linear.cost.reshape(count, runs)
    converged = fit.converged.reshape(count, runs) & _best_of_same_data(shooting.problems, cost)
    chi2 = 2.0 * cost / shooting.degrees_of_freedom()[:, None]
    log_covariance = covariance(fit.linear.hessian).reshape(count, runs, N_UNKNOWNS, N_UNKNOWNS)
    log_std = np.sqrt(np.diagonal(log_covariance, axis1=2, axis2=3))[..., :N_HEALTH]
    values = np.exp(unknowns[..., :N_HEALTH])
    std, interval = intervals_from_log_std(values, log_std)
    used = np.where(converged.any(axis=1, keepdims=True), converged, True)
    pooled = np.einsum("srk,sr->sk", unknowns, used) / used.sum(axis=1, keepdims=True)
    states = shooting.simulate(np.arange(count), pooled).states
    health, initial = np.exp(pooled[:, :N_HEALTH]), np.exp(pooled[:, N_HEALTH:])
    bounds = cautious_bound(shooting.problems, health, initial, below, simulator=shooting.simulator)
    result = []
    for s, problem in enumerate(shooting.problems):
        rows = np.flatnonzero(used[s])[np.arange(len(normal[s])) % used[s].sum()]
        band_states, band_health = sample_states(shooting, s, unknowns[s, rows], log_covariance[s, rows], normal[s])
        result.append(
            SegmentEstimate(
                t0_s=problem.t0_s,
                t1_s=problem.t1_s,
                time_s=problem.time_s,
                parameters=values[s],
                std=std[s],
                interval_90=interval[s],
                states=states[s],
                bound=bounds[s].absolute,
                identifiable=bounds[s].identifiable(below),
                converged=converged[s],
                seconds_per_run=seconds,
                method=METHOD,
                chi2_per_sample=chi2[s],
                state_samples=band_states,
                parameter_samples=band_health,
            )
        )
    return result


def _best_of_same_data(problems: Sequence[SegmentProblem], cost: Array) -> NDArray[np.bool_]:
    """(S, R) false for a run that ended in a worse minimum than another run of the same readings."""
    best = np.ones(cost.shape, dtype=bool)
    for s, problem in enumerate(problems):
        draws = 1 if problem.noise_draws is None else len(problem.noise_draws)
        draw = np.arange(cost.shape[1]) % draws
        lowest = np.full(draws, np.inf)
        np.minimum.at(lowest, draw, cost[s])
        best[s] = cost[s] <= lowest[draw] + WORSE
    return best
