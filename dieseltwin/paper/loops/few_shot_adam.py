"""The printed few-shot method: Adam on the heads of frozen bodies, the unknowns and the self-adaptive weights.

Source: paper, section "Results: Few-shot transfer learning" and appendix "Detailed loss function". All runs of all
segments are lanes of one tensor program. The derivative of a state is dh/dt W with dh/dt computed once; the eight Adam
optimisers of the paper differ in nothing but their learning rate, and Adam works element by element, so one update
over the concatenated unknowns with a rate for each is the same thing (the weights' rate is negative: they ascend).

float32 is safe here: the loop's own noise (learning rates of 1e-3) is four orders above its rounding, and rates are
sums of flows whose relative rounding of 1e-7 is 1e-3 of the least residual. Lanes never mix, but a product over more
lanes is summed in another order: a batch equals its runs alone to rounding, not to the bit.

Not printed, and chosen in `params.yaml` on validation driving: learning rates and the units of the residuals (see
`losses`). Temperatures over 30 K: with 300 K the readings of T_em hardly count, T_1 is 25 K off and h_tot ends
25-40 % off. The self-adaptive weights of 1e3 let the heads fit the noise, so the unknowns are regressed on noisy
states and rates: A_egrmax stays 3 % low however long the loop runs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray

from dieseltwin.engine import HEALTH, actuate
from dieseltwin.identification.bound import nominal_bound
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.identification.shooting import by_grid
from dieseltwin.identification.unknowns import to_physical
from dieseltwin.paper.loop_settings import AdamConfig
from dieseltwin.paper.loops.averaging import TailMean
from dieseltwin.paper.loops.compiled_loss import Place, gradient_function
from dieseltwin.paper.loops.few_shot_program import LANES, METHOD, Lane, Program, draw_lane, make_program, start_values
from dieseltwin.paper.loops.losses import TERMS, data_misfit

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Adam's own constants (Kingma & Ba 2014), left at their defaults by the paper."""
CURVE_POINTS = 200
"""Points of the curves that are kept."""
STILL_BELOW = 0.01
"""Relative change of every estimate within the last tenth of the epochs that counts as converged."""
STILL_PACE = 0.2
"""The same change over what a straight line along the whole training would have made of it: few epochs change little,
but all of them alike. Runs of 5 to 200 epochs have 0.24 to 1.7 (the least with a fifth of the rates at the end, as
printed), 140 runs of 9,000 epochs that stood still at most 0.15."""


def estimate(
    problems: Sequence[SegmentProblem],
    runs: int,
    seed: int,
    *,
    bodies: Bodies | None = None,
    operators: ActuatorOperators | None = None,
    maps: EmpiricalMaps | None = None,
    config: IdentifyConfig,
    first_run: int = 0,
) -> list[SegmentEstimate]:
    """Estimate the health parameters of each segment with the paper's loop.

    Args:
        problems: segments; `problem.parameters` gives the known parameters and the start (laboratory values).
        runs: runs R of each segment: other heads, weights, unknowns, map members, noise draws.
        seed: seed of all draws; a run's draws depend on (seed, segment, run) alone, not on the batch it runs in.
        bodies: trained bodies, or None for B-splines of the paper's widths.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, dropout on, or None for the exact formulae.
        config: `identify` of params.yaml.
        first_run: number of the first run: runs 10-19 alone are those of a batch of 30.

    Returns:
        One estimate for each segment, in order; standard deviations are left to the spread of the members.
    """
    settings = cast(AdamConfig, config.of(METHOD))
    results: dict[int, SegmentEstimate] = {}
    for group in by_grid(problems):
        began = time.perf_counter()
        numbers = range(first_run, first_run + runs)
        lanes = [
            draw_lane(problems[i], i, run, seed, config.start, settings.held_out_share)
            for i in group
            for run in numbers
        ]
        actuations = {i: actuate(problems[i].inputs, problems[i].parameters) for i in group}
        parts = [lanes[a : a + LANES] for a in range(0, len(lanes), LANES)]
        found = [
            train(part, make_program(part, actuations, bodies, operators, maps, settings), settings) for part in parts
        ]
        whole = Trained.joined(found)
        seconds = (time.perf_counter() - began) / len(lanes)
        for row, i in enumerate(group):
            results[i] = estimate_of(
                problems[i],
                whole.lanes(slice(row * runs, (row + 1) * runs)),
                settings.average_share,
                seconds,
                settings.epochs,
                identifiable_below=config.identifiable_bound_rel,
                early_stopping=settings.held_out_share > 0.0,
            )
    return [results[i] for i in range(len(problems))]


@dataclass(frozen=True)
class Trained:
    """What the loop found for L lanes.

    Attributes:
        health: (L, points, 4) parameters along the epochs [SI].
        final: (L, 4) the result: the mean over the last share of the epochs [SI]. With readings held out the result is
            in `health`, at the epoch that predicts them best.
        states: (L, n, 5) p_im, p_em, omega_t, x_r, T_1 [SI].
        loss: (L, points) total loss.
        misfit: (L,) sum of squared data residuals over sigma, divided by their number.
        held_out: (L, points) the same of the readings that no loss sees; zeros where there are none.
        terms: (L, points, 10) `losses.TERMS`.
    """

    health: NDArray[np.float64]
    final: NDArray[np.float64]
    states: NDArray[np.float64]
    loss: NDArray[np.float64]
    misfit: NDArray[np.float64]
    held_out: NDArray[np.float64]
    terms: NDArray[np.float64]

    @classmethod
    def joined(cls, parts: Sequence[Trained]) -> Trained:
        """The lanes of several loops, one after the other."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def lanes(self, rows: slice) -> Trained:
        """Some of the lanes."""
        return Trained(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def train(
    lanes: Sequence[Lane],
    program: Program,
    settings: AdamConfig,
    progress: Callable[[int], None] | None = None,
    compiled: bool | None = None,
) -> Trained:
    """Run the loop over L lanes of one sample grid.

    Args:
        lanes: the runs.
        program: their loss.
        settings: settings.
        progress: called with the epoch now and then.
        compiled: whether loss and gradient are compiled (`compiled_loss`); None: where it pays.

    Returns:
        Parameters, states and loss of each lane.
    """
    values, rates = start_values(lanes, program, settings)
    count = len(lanes)
    at = np.cumsum([0, *program.widths()])
    n_heads, n_down = int(at[-1]), int(at[-1]) + len(HEALTH)
    first, second = torch.zeros_like(values), torch.zeros_like(values)
    gradient = torch.zeros_like(values)
    keep = np.unique(np.linspace(0, settings.epochs, min(CURVE_POINTS, settings.epochs + 1)).round().astype(int))
    curve_health, curve_loss, curve_held_out, curve_terms = [], [], [], []
    sigma = torch.tensor(np.stack([lane.problem.sigma[:5] for lane in lanes]), dtype=values.dtype)
    mean = TailMean(settings.epochs, settings.average_share, values[:, n_heads:n_down])
    best, least = values.clone(), torch.full((count,), float("inf"), dtype=values.dtype)

    place = Place.within(values, gradient, n_heads, program)
    loss_and_gradient = gradient_function(program, place, count * settings.epochs, compiled)
    z, masked, weights = place.z, place.masked, place.weights

    for epoch in range(settings.epochs + 1):
        mean.add(epoch, masked)
        program.renew()
        for j in range(5):
            torch.mm(values[:, at[j] : at[j + 1]], program.columns[j], out=z[j])
        adaptive = epoch < settings.weights_until_epoch
        total = loss_and_gradient(adaptive)
        if epoch in keep:
            curve_health.append(to_physical(masked, torch))
            curve_loss.append(total.clone())
            curve_terms.append(place.terms.clone())
            curve_held_out.append(program.held_out_misfit(z, masked, sigma))
            better = curve_held_out[-1] < least
            best[better], least[better] = values[better], curve_held_out[-1][better]
            if progress is not None:
                progress(epoch)
        if epoch == settings.epochs:
            break
        for j in range(5):
            gradient[:, at[j] : at[j + 1]] = place.by_z[j] @ program.columns[j].T
        live = values.shape[1] if adaptive else n_down
        if epoch == settings.late_from_epoch:
            rates = settings.late_rates * rates
        g, m, v = gradient[:, :live], first[:, :live], second[:, :live]
        m.lerp_(g, 1.0 - BETA_1)
        v.mul_(BETA_2).addcmul_(g, g, value=1.0 - BETA_2)
        correct = (1.0 - BETA_2 ** (epoch + 1)) ** 0.5
        step = m / (v.sqrt().add_(EPSILON * correct))
        values[:, :live].addcmul_(step, rates[:live], value=-correct / (1.0 - BETA_1 ** (epoch + 1)))

    if program.held_out is not None:
        values.copy_(best)
        for j in range(5):
            torch.mm(values[:, at[j] : at[j + 1]], program.columns[j], out=z[j])
    with torch.no_grad():
        loss = program(z, masked, weights)
        states, _ = program.states(z)
    misfit = data_misfit(loss, program.observed, sigma)
    return Trained(
        torch.stack(curve_health, 1).double().numpy(), mean.physical().numpy(),
        torch.stack(states, -1).double().numpy(), torch.stack(curve_loss, 1).double().numpy(),
        misfit.double().numpy(), torch.stack(curve_held_out, 1).double().numpy(),
        torch.stack(curve_terms, 1).double().numpy(),
    )  # fmt: skip


def estimate_of(
    problem: SegmentProblem,
    found: Trained,
    average_share: float,
    seconds: float,
    epochs: int = 0,
    *,
    identifiable_below: float,
    early_stopping: bool = False,
    pace_below: float = STILL_PACE,
) -> SegmentEstimate:
    """The runs of one segment as an estimate (also of the baseline and the multi-stage method).

    Args:
        problem: the segment.
        found: its R runs. A run has converged if its result is within `STILL_BELOW` of the mean a tenth of the epochs
            earlier, and moves there at less than `pace_below` of its pace along the whole training.
        average_share: share of the epochs behind `found.final`.
        seconds: wall seconds per run.
        epochs: trained.
        identifiable_below: largest relative bound that counts as identifiable [-].
        early_stopping: a run's parameters are those where the misfit of the readings that no loss saw is least, and a
            choice before the last epoch counts as converged.
        pace_below: largest such pace, of the unknown that moves fastest over the one that moved farthest [-].
    """
    health, loss, states, final = found.health, found.loss, found.states, found.final
    points = health.shape[1]
    width, lag = max(1, round(average_share * points)), max(2, points // 10) - 1
    earlier = health[:, max(0, points - lag - width) : max(1, points - lag)].mean(axis=1)
    chosen = np.full(len(health), points - 1)
    if early_stopping:
        chosen = np.argmin(found.held_out, axis=1)
        final = health[np.arange(len(health)), chosen]
        earlier = health[:, -(lag + 1)]
    finite = np.isfinite(final).all(axis=1) & np.isfinite(loss[:, -1])
    change = np.abs(final / earlier - 1.0)
    way = np.abs((health - health[:, :1]) / final[:, None]).max(axis=(1, 2))
    slow = change.max(axis=1) <= pace_below * way * lag / max(1, points - 1)
    still = finite & (((change <= STILL_BELOW).all(axis=1) & slow) | (chosen < points - 1))
    used = still if still.any() else (finite if finite.any() else np.ones_like(finite))
    pooled_states = states[used].mean(axis=0)
    bound = nominal_bound(problem, pooled_states)
    nothing = np.full(final.shape, np.nan)
    return SegmentEstimate(
        t0_s=problem.t0_s, t1_s=problem.t1_s, time_s=problem.time_s, parameters=final, std=nothing,
        interval_90=np.stack([nothing, nothing], -1), states=pooled_states, bound=bound.absolute,
        identifiable=bound.identifiable(identifiable_below), converged=still, seconds_per_run=seconds, method=METHOD,
        chi2_per_sample=found.misfit, state_samples=states[used], parameter_samples=final[used],
        curves={
            "epoch": np.linspace(0, epochs, loss.shape[1]).round(), "loss": loss.T,
            **{name: health[..., i].T for i, name in enumerate(HEALTH)},
            **dict(zip(TERMS, found.terms.mean(axis=0).T, strict=True)),
            **({"held_out_misfit": found.held_out.T} if early_stopping else {}),
        },
    )  # fmt: skip
