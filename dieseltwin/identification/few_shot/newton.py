"""Few-shot estimator with second-order steps: heads and log-parameters by Levenberg-Marquardt, x_r and T_1 eliminated.

The objective is the weak-constraint likelihood of `collocation`: data residuals over sigma, physics residuals over a
process noise from the laboratory twin (`process_noise`), corrected for what the basis cannot follow (`defects`).
It is minimised in stages of shrinking process noise: a wide one first, because the equations have kinks (turbine
efficiency at 2769-2797 rad/s, compressor flow at zero) that noisy heads get caught in.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dieseltwin.engine import Actuation, EngineParameters, actuate
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import cautious_bound, states_within
from dieseltwin.identification.few_shot.collocation import Collocation, Data
from dieseltwin.identification.few_shot.damped_newton import Factor, Runs, minimise
from dieseltwin.identification.few_shot.defects import STEP_S, Defects, defects, simulate_windows, windows_for
from dieseltwin.identification.few_shot.heads import heads_for
from dieseltwin.identification.few_shot.process_noise import Setting, calibrate
from dieseltwin.identification.few_shot.residuals import N_HEALTH, PointModel, driven_inputs
from dieseltwin.identification.in_place import told_actuation
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import STATE_SAMPLES, SegmentEstimate, intervals_from_log_std
from dieseltwin.identification.settings import NewtonConfig
from dieseltwin.identification.unknowns import health_of, start_centre, starts

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

METHOD = "few-shot-newton"
BLOCK = 10
"""Runs that are iterated together: the batched products of ten runs stay within the cache."""
BLOCK_ALIKE = 30
"""The same of runs of the same readings, which take their Hessians from the first of them."""
LEAST_STATE = (5e4, 5e4, 200.0)
"""Noisy readings are not taken below this for the first trajectory [Pa, Pa, rad/s]: the inverse transform needs them
positive, and the engine's limiters are there."""
MOVED_BELOW = 0.05
"""A renewed defect that moves no parameter by more than this share of its standard deviation has settled."""
EARLY_TOLERANCE = 0.5
"""Decrement at which a run of an early stage stops [standard deviations]."""
RENEWAL_DAMPING = 1e-6
"""First damping after a renewed defect: the run is next to its minimum already."""
DOUBTFUL_SIGMAS = 4.0
"""A run whose data misfit exceeds the runs' median by this many standard deviations of chi-square is tried again."""
CONVERGED_BELOW = 0.1
"""Decrement that counts as converged [standard deviations]."""


def estimate(
    problems: Sequence[SegmentProblem],
    runs: int,
    seed: int,
    *,
    bodies: Bodies | None = None,
    operators: ActuatorOperators | None = None,
    maps: EmpiricalMaps | None = None,
    config: IdentifyConfig,
) -> list[SegmentEstimate]:
    """Estimate the health parameters of each segment with second-order few-shot steps.

    Args:
        problems: segments; `problem.parameters` gives the known parameters and the start (laboratory values).
        runs: runs R of each segment: other starts, other map members, other readings where there are noise draws.
        seed: seed of the starts.
        bodies: trained bodies (`conditioned`), or None for B-splines of the paper's widths.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, one member (or dropout realisation) a run, or None for the exact formulae.
        config: `identify` of params.yaml.

    Returns:
        One estimate for each segment, in order. Standard deviations and 90 % intervals of the logarithms come from the
        inverse Hessian and are never below the Cramér-Rao bound.
    """
    settings, start = cast(NewtonConfig, config.of(METHOD)), config.start
    below = config.identifiable_bound_rel
    rng = np.random.default_rng(seed)
    results = []
    for problem in problems:
        began = time.perf_counter()
        centre = start_centre(problem.parameters, problem.truth, start.at)
        begin = np.log(starts(centre, runs, rng, start.sd_masked))
        results.append(_segment(problem, begin, bodies, operators, maps, settings, began, below))
    return results


def prepare(
    problem: SegmentProblem, bodies: Bodies | None = None, operators: ActuatorOperators | None = None
) -> Setting:
    """Heads, inputs and windows of one segment."""
    actuation = actuate(problem.inputs, problem.parameters, STEP_S)
    inputs = driven_inputs(told_actuation(actuation, operators, problem.parameters))
    return Setting(
        problem,
        actuation,
        heads_for(problem.time_s, bodies),
        inputs,
        windows_for(actuation),
        PointModel(problem.parameters, actuation=actuation),
    )


def point_model(
    parameters: EngineParameters, maps: EmpiricalMaps | None, runs: Sequence[int], actuation: Actuation | None = None
) -> PointModel:
    """The estimator's equations for the runs with these numbers, each with its own member of learned maps."""
    if maps is None:
        return PointModel(parameters, actuation=actuation)
    members = [run + 1 for run in runs]  # member 0 would be the nominal one
    replaced = maps.replacements("torch", member=members, slopes=True)
    return PointModel(parameters, replaced, lanes=len(members), actuation=actuation)


@dataclass(frozen=True)
class Solution:
    """Where R runs of one segment ended.

    Attributes:
        runs: minimiser's state.
        defects: corrections that it belongs to.
        converged: (R,) decrement small and defect settled.
        log_std: (R, 4) standard deviation of the log-parameters.
    """

    runs: Runs
    defects: Defects
    converged: Tensor
    log_std: Tensor


def solve(setting: Setting, model: PointModel, readings: Tensor, begin: Tensor, settings: NewtonConfig) -> Solution:
    """Minimise R runs of one segment through all stages.

    Args:
        setting: the segment.
        model: the estimator's equations.
        readings: (R, n, C), NaN where masked.
        begin: (R, 4) log-parameters to start from.
        settings: settings.

    Returns:
        The solution.
    """
    problem, heads = setting.problem, setting.heads
    noise = calibrate(setting, model, settings)
    weights = torch.where(torch.isnan(readings), 0.0, 1.0) / torch.from_numpy(problem.sigma)
    clean = torch.nan_to_num(readings)
    collocation = Collocation(heads, setting.inputs, model)
    unknowns = torch.cat([first_heads(setting, readings, begin), begin], -1)

    state: Runs | None = None
    settled = torch.zeros(begin.shape[0], dtype=torch.bool)
    log_std = torch.full_like(begin, float("inf"))
    found = _defects(setting, unknowns)
    schedule = list(settings.stages) + [settings.stages[-1]] * settings.renewals_max
    for number, multiple in enumerate(schedule):
        last = number >= len(settings.stages) - 1
        if number:
            found = _defects(setting, unknowns)
        if number >= len(settings.stages):
            # Heads from the simulated states leave the kinks that the minimiser's own path was caught in.
            simulated = heads.project(torch.maximum(found.states, torch.tensor(LEAST_STATE, dtype=found.states.dtype)))
            unknowns = torch.cat([simulated, unknowns[:, -N_HEALTH:]], -1)
        data = Data(clean, weights, multiple * noise.at(found.rate), found.rate, found.reading)
        renewal = number >= len(settings.stages)
        state = minimise(
            collocation,
            data,
            unknowns,
            dof=settings.student_dof,
            tolerance=settings.tolerance if last else EARLY_TOLERANCE,
            iterations_max=settings.iterations_max if last else settings.iterations_early,
            damping=RENEWAL_DAMPING if renewal else settings.damping_start,
            start=None if state is None else state.objective.cylinder,
            factors=state.factors if renewal and state is not None else None,
        )
        moved = (state.unknowns - unknowns)[:, -N_HEALTH:].abs()
        unknowns = state.unknowns
        if last:
            log_std = state.log_std()
            settled = (moved <= MOVED_BELOW * log_std).all(-1)
            if renewal and bool(settled.all()):
                break
    if state is None:
        raise InputError("newton stages", settings.stages, "one or more", "correct the settings")
    converged = settled & (state.decrement <= CONVERGED_BELOW) & torch.isfinite(state.objective.cost)
    return Solution(state, found, converged, _log_std(collocation, state))


def first_heads(setting: Setting, readings: Tensor, begin: Tensor) -> Tensor:
    """Heads to start from: windows of the engine at the starting parameters, each from the readings' own states.

    Heads fitted to the noisy readings themselves would put the states where the equations have kinks; simulated states
    are consistent, and the restarts keep them near the readings.
    """
    low = torch.tensor(LEAST_STATE, dtype=torch.float64)
    noisy = torch.maximum(_filled(setting.problem, readings[..., :3]), low)
    smooth = setting.heads.trajectory(setting.heads.project(noisy)).states
    smooth = torch.maximum(smooth, low)
    states, _ = simulate_windows(setting.windows, setting.problem.parameters, torch.exp(begin).numpy(), smooth.numpy())
    usable = torch.isfinite(states).all(-1).all(-1)[:, None, None]
    return setting.heads.project(torch.where(usable, torch.maximum(states, low), smooth))


def _filled(problem: SegmentProblem, states: Tensor) -> Tensor:
    """Readings (R, n, 3) with masked samples interpolated in time; a channel without readings is refused."""
    if not torch.isnan(states).any():
        return states
    problem.first_states(states.numpy())  # raises where a channel is absent
    values, t = states.numpy().copy(), problem.time_s
    for lane in values:
        for j in range(lane.shape[1]):
            present = np.isfinite(lane[:, j])
            lane[:, j] = np.interp(t, t[present], lane[present, j])
    return torch.from_numpy(values)


def _defects(setting: Setting, unknowns: Tensor) -> Defects:
    return defects(setting.heads, setting.inputs, setting.exact, setting.windows, setting.problem.parameters, unknowns)


def _log_std(collocation: Collocation, state: Runs) -> Tensor:
    """(R, 4) standard deviations of the log-parameters from the inverse Hessian; infinite where it is singular.

    With the ridge of the steps: behind a shut valve A_egrmax has no curvature, and the others must keep theirs.
    """
    factor = Factor(collocation, 0.0)
    rows = []
    for lane in range(len(state.unknowns)):
        factor.renew(state.objective.curvature, lane, state.unknowns[lane].numpy())
        rows.append(factor.log_std())
    return torch.from_numpy(np.stack(rows))


def _segment(
    problem: SegmentProblem, begin: NDArray[np.float64], bodies: Bodies | None, operators: ActuatorOperators | None,
    maps: EmpiricalMaps | None,
    settings: NewtonConfig, began: float, below: float,
) -> SegmentEstimate:  # fmt: skip
    setting = prepare(problem, bodies, operators)
    readings = torch.tensor(problem.readings(len(begin)))
    begin_t = torch.from_numpy(begin)
    parts: list[tuple[Solution, Tensor]] = []
    alike = bool(torch.equal(torch.nan_to_num(readings), torch.nan_to_num(readings[:1]).expand_as(readings)))
    block = BLOCK_ALIKE if alike else BLOCK
    for first in range(0, len(begin), block):
        members = list(range(first, min(first + block, len(begin))))
        parts.append(_solved(setting, maps, readings[members], begin_t[members], members, settings))
    doubtful = _doubtful(problem, [s for s, _ in parts])
    for first in range(0, len(doubtful), block):
        members = doubtful[first : first + block]
        centre = torch.from_numpy(np.log(health_of(problem.parameters))).expand(len(members), -1)
        again = _solved(setting, maps, readings[members], centre, members, settings.patient())
        for i, member in enumerate(members):
            _replace_if_better(parts[member // block], member % block, again, i)
    unknowns = torch.cat([s.runs.unknowns for s, _ in parts])
    log_std = torch.cat([s.log_std for s, _ in parts]).numpy()
    converged = torch.cat([s.converged for s, _ in parts]).numpy()
    states = torch.cat([x for _, x in parts]).numpy()
    misfit = torch.cat([(s.runs.objective.data**2).sum((-1, -2)) for s, _ in parts]).numpy()
    health = np.exp(unknowns[:, -N_HEALTH:].numpy())
    used = converged if converged.any() else np.ones_like(converged)
    pooled_states = states[used].mean(axis=0)
    pooled = np.exp(np.log(health[used]).mean(axis=0))
    bound = cautious_bound([problem], pooled, pooled_states[0, :3], below)[0]
    std, interval = intervals_from_log_std(health, np.maximum(log_std, bound.relative))
    normal = np.random.default_rng(0).standard_normal((STATE_SAMPLES, N_HEALTH + 3))
    bands = (None, None) if maps is not None else states_within(problem, pooled, pooled_states[0, :3], bound, normal)
    misfit /= max(int(problem.observed.sum()) - N_HEALTH - 3, 1)
    return SegmentEstimate(
        t0_s=problem.t0_s, t1_s=problem.t1_s, time_s=problem.time_s, parameters=health, std=std, interval_90=interval,
        states=pooled_states, bound=bound.absolute, identifiable=bound.identifiable(below), converged=converged,
        seconds_per_run=(time.perf_counter() - began) / len(begin), method=METHOD, chi2_per_sample=misfit,
        state_samples=bands[0], parameter_samples=bands[1],
    )  # fmt: skip


def _solved(
    setting: Setting,
    maps: EmpiricalMaps | None,
    readings: Tensor,
    begin: Tensor,
    members: list[int],
    settings: NewtonConfig,
) -> tuple[Solution, Tensor]:
    model = point_model(setting.problem.parameters, maps, members, setting.actuation)
    found = solve(setting, model, readings, begin, settings)
    return found, _states(setting, model, found)


def _doubtful(problem: SegmentProblem, solutions: list[Solution]) -> list[int]:
    """Runs that did not converge, or that fit clearly worse than the others: caught at a kink of the equations."""
    misfit = torch.cat([(s.runs.objective.data**2).sum((-1, -2)) for s in solutions])
    converged = torch.cat([s.converged for s in solutions])
    freedom = max(int(problem.observed.sum()), 1)
    worse = misfit > misfit.median() + DOUBTFUL_SIGMAS * (2.0 * freedom) ** 0.5
    return [int(i) for i in torch.nonzero(~converged | worse).squeeze(-1)]


def _replace_if_better(old: tuple[Solution, Tensor], i: int, new: tuple[Solution, Tensor], j: int) -> None:
    mine, other = old[0], new[0]
    if not bool(other.converged[j]) and bool(mine.converged[i]):
        return
    if bool(other.converged[j]) == bool(mine.converged[i]) and bool(
        other.runs.objective.cost[j] >= mine.runs.objective.cost[i]
    ):
        return
    mine.runs.unknowns[i], mine.log_std[i], mine.converged[i] = (
        other.runs.unknowns[j], other.log_std[j], other.converged[j]
    )  # fmt: skip
    mine.runs.objective.data[i], mine.runs.objective.cost[i] = (
        other.runs.objective.data[j],
        other.runs.objective.cost[j],
    )
    old[1][i] = new[1][j]


def _states(setting: Setting, model: PointModel, found: Solution) -> Tensor:
    """States (R, n, 5) of the solution: the heads' trajectory, what the basis misses, and x_r, T_1 at them."""
    unknowns = found.runs.unknowns
    path = setting.heads.trajectory(unknowns[:, :-N_HEALTH])
    states = path.states + found.defects.reading[..., :3]
    health = list(torch.exp(unknowns[:, -N_HEALTH:]).unsqueeze(1).unbind(-1))
    cylinder = model.cylinder(states, health, setting.inputs, None)
    return torch.cat([states, cylinder.x_r.unsqueeze(-1), cylinder.T_1.unsqueeze(-1)], -1)
