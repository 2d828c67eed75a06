"""The training loop of the hybrid PINN: stages of Adam on networks, unknowns and self-adaptive weights, over lanes.

Source: paper, sections "A hybrid model using DeepONet and PINN" (two phases), "Multi-stage Transfer learning" (Stages
I-III) and "Results: Multi-stage Transfer Learning" (starts, epochs). `baseline` and `multi_stage` differ in their
stages and in where the networks and unknowns start. Loss, weights, masks, inputs and learned maps are those of
`few_shot_program`; only the way from unknowns to linear outputs z is another one (`pinn_networks`).

From Stage II on the hidden layers are frozen, so a compiled run computes their outputs and rates once.
As in `few_shot_adam`, several Adam optimisers with rates of their own are one update with a rate for each column.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dieseltwin.engine import HEALTH, actuate
from dieseltwin.errors import InputError
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.identification.unknowns import to_physical
from dieseltwin.paper.loop_settings import PinnConfig, Stage
from dieseltwin.paper.loops.averaging import TailMean
from dieseltwin.paper.loops.compiled_loss import Place
from dieseltwin.paper.loops.few_shot_adam import BETA_1, BETA_2, CURVE_POINTS, EPSILON, Trained, estimate_of
from dieseltwin.paper.loops.few_shot_program import LANES, Lane, Program, draw_lane, make_program
from dieseltwin.paper.loops.losses import data_misfit, starting_weights
from dieseltwin.paper.loops.network_loops import epoch_function
from dieseltwin.paper.loops.pinn_networks import StateNetworks

if TYPE_CHECKING:
    from dieseltwin.settings.params import IdentifyConfig, StartConfig
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

STILL_PACE = 0.3
"""As of the few-shot loop, whose unknowns don't begin with random networks: 113 runs of 7,000 and 12,000 epochs that
stood still have at most 0.27, few epochs at the rates of the first stage about 1."""


def settings_of(config: IdentifyConfig, method: str) -> PinnConfig:
    """Settings of "baseline" or "multi-stage".

    Raises:
        InputError: its stages are out of order.
    """
    settings = cast(PinnConfig, config.of(method))
    ends = [stage.until_epoch for stage in settings.stages]
    if sorted(set(ends)) != ends:
        raise InputError("stages", f"until_epoch {ends}", "rising numbers", "mend identify.*.stages")
    layers = [stage.layers for stage in settings.stages]
    if sorted(layers) != layers:
        raise InputError("stages", f"layers {layers}", "all first, then last", "mend identify.*.stages")
    return settings


@dataclass(frozen=True)
class PinnTrained:
    """What the loop found for L lanes.

    Attributes:
        trained: parameters, states, losses and misfit.
        epochs: trained.
        weights: (L, size) network weights at the end.
        masked: (L, 4) unknowns in masked space at the end.
    """

    trained: Trained
    epochs: int
    weights: Tensor
    masked: Tensor


class _Columns:
    """Where things stand in a lane's columns: networks, unknowns, pointwise weights, single weights."""

    def __init__(self, networks: StateNetworks) -> None:
        self.networks = networks
        self.unknowns = networks.size
        self.weights = self.unknowns + len(HEALTH)
        self.end = self.weights + 4 * networks.n + 2

    def live(self, stage: Stage) -> slice:
        """Columns that a stage trains: one contiguous block."""
        first = 0 if stage.layers == "all" else self.networks.hidden_size
        return slice(first, self.end if stage.rate_weights > 0.0 else self.weights)

    def rates(self, stage: Stage, dtype: torch.dtype) -> Tensor:
        """Learning rate of each column; the weights climb, so theirs is negative."""
        rates = torch.full((self.end,), -stage.rate_weights, dtype=dtype)
        rates[: self.unknowns] = stage.rate_networks
        rates[self.unknowns : self.weights] = stage.rate_unknowns
        return rates


def start_values(
    lanes: Sequence[Lane], program: Program, networks: StateNetworks, settings: PinnConfig,
    sources: tuple[Tensor, Tensor] | None = None,
) -> Tensor:  # fmt: skip
    """Starting columns of the lanes.

    Args:
        lanes: the runs.
        program: their tensor program.
        networks: their networks.
        settings: settings.
        sources: network weights (L, size) and masked unknowns (L, 4) to take over; None draws them.

    Returns:
        (L, M) networks, unknowns and fresh self-adaptive weights.
    """
    rows = []
    for number, lane in enumerate(lanes):
        generator = torch.Generator().manual_seed(lane.generator_seed)
        if sources is None:
            own, masked = networks.start(generator, settings.first_layer_slopes), torch.tensor(lane.masked)
        else:
            own, masked = sources[0][number].double(), sources[1][number].double()
        readings = program.observed.readings[number : number + 1].double()
        weights = starting_weights(readings, generator, settings.weight_start)
        rows.append(torch.cat([own, masked, weights.pointwise.flatten(), weights.single.flatten()]))
    return torch.stack(rows).to(program.dtype)


def train(
    program: Program, networks: StateNetworks, values: Tensor, stages: Sequence[Stage], sigma: NDArray[np.float64],
    progress: Callable[[int], None] | None = None, average_share: float = 0.0, compiled: bool | None = None,
) -> PinnTrained:  # fmt: skip
    """Run the stages over L lanes of one sample grid.

    Args:
        program: loss of linear outputs, unknowns and weights.
        networks: from weights to linear outputs.
        values: (L, M) of `start_values`; changed in place.
        stages: the schedule.
        sigma: (L, 5) noise of the five channels [SI], for the misfit.
        progress: called with the epoch now and then.
        average_share: of the epochs, at the end, whose mean is the estimate; 0 is the last epoch (`averaging`).
        compiled: whether an epoch is compiled (`network_loops`); None: where it pays.

    Returns:
        Parameters, states, losses and the networks at the end.
    """
    columns, epochs = _Columns(networks), stages[-1].until_epoch
    first, second, gradient = (torch.zeros_like(values) for _ in range(3))
    keep = np.unique(np.linspace(0, epochs, min(CURVE_POINTS, epochs + 1)).round().astype(int))
    kept, curve = set(keep.tolist()), _Curve()
    place = Place.within(values, gradient, columns.unknowns, program)
    masked = place.masked
    evaluate = epoch_function(program, networks, (values, gradient), place, epochs, compiled)
    mean = TailMean(epochs, average_share, masked)
    epoch = 0
    for stage in stages:
        live, rates = columns.live(stage), columns.rates(stage, values.dtype)
        g, m, v, x = (t[:, live] for t in (gradient, first, second, values))
        rates = rates[..., live]
        while epoch < stage.until_epoch:
            program.renew()
            total = evaluate(stage.layers == "last", stage.rate_weights > 0.0)
            if epoch in kept:
                curve.add(masked, total, place.terms)
                if progress is not None:
                    progress(epoch)
            m.lerp_(g, 1.0 - BETA_1)
            v.mul_(BETA_2).addcmul_(g, g, value=1.0 - BETA_2)
            correct = (1.0 - BETA_2 ** (epoch + 1)) ** 0.5
            x.addcmul_(m / v.sqrt().add_(EPSILON * correct), rates, value=-correct / (1.0 - BETA_1 ** (epoch + 1)))
            epoch += 1
            mean.add(epoch, masked)
    with torch.no_grad():
        for target, z in zip(place.z, networks.outputs(values), strict=True):
            target.copy_(z)
        loss = program(place.z, masked, place.weights)
        curve.add(masked, loss.total, torch.stack(loss.terms, 1))
        states, _ = program.states(place.z)
        misfit = data_misfit(loss, program.observed, torch.tensor(sigma, dtype=values.dtype))
    found = Trained(
        torch.stack(curve.health, 1).double().numpy(), mean.physical().numpy(),
        torch.stack(states, -1).double().numpy(), torch.stack(curve.loss, 1).double().numpy(),
        misfit.double().numpy(), torch.zeros(len(misfit), len(curve.loss)).double().numpy(),
        torch.stack(curve.terms, 1).double().numpy(),
    )  # fmt: skip
    return PinnTrained(found, epochs, values[:, : networks.size].clone(), masked.clone())


class _Curve:
    """Parameters and losses at the epochs that are kept."""

    def __init__(self) -> None:
        self.health: list[Tensor] = []
        self.loss: list[Tensor] = []
        self.terms: list[Tensor] = []

    def add(self, masked: Tensor, total: Tensor, terms: Tensor) -> None:
        self.health.append(to_physical(masked, torch))
        self.loss.append(total.clone())
        self.terms.append(terms.clone())


def make_lanes(
    problems: Sequence[SegmentProblem], group: Sequence[int], runs: int, seed: int, start: StartConfig,
    first_run: int = 0,
) -> list[Lane]:  # fmt: skip
    """Lanes of some segments, run by run from `first_run` on; a run's draws depend on (seed, segment, run) alone."""
    numbers = range(first_run, first_run + runs)
    return [draw_lane(problems[i], i, run, seed, start) for i in group for run in numbers]


def train_lanes(
    lanes: Sequence[Lane],
    operators: ActuatorOperators | None,
    maps: EmpiricalMaps | None,
    settings: PinnConfig,
    sources: tuple[Tensor, Tensor] | None = None,
    dtype: torch.dtype = torch.float32,
) -> PinnTrained:
    """Train lanes of one sample grid, `LANES` at a time.

    Args:
        lanes: the runs.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, dropout on, or None for the exact formulae.
        settings: settings.
        sources: network weights (L, size) and masked unknowns (L, 4) to start from; None draws them.
        dtype: float32 or float64.

    Returns:
        What was found for all lanes.
    """
    found = []
    for a in range(0, len(lanes), LANES):
        part = lanes[a : a + LANES]
        actuations = {lane.index: actuate(lane.problem.inputs, lane.problem.parameters) for lane in part}
        program = make_program(part, actuations, None, operators, maps, settings, dtype)
        networks = StateNetworks(part[0].problem.time_s, dtype=dtype)
        taken = None if sources is None else (sources[0][a : a + len(part)], sources[1][a : a + len(part)])
        values = start_values(part, program, networks, settings, taken)
        sigma = np.stack([lane.problem.sigma[:5] for lane in part])
        found.append(train(program, networks, values, settings.stages, sigma, average_share=settings.average_share))
    whole = Trained.joined([f.trained for f in found])
    weights, masked = torch.cat([f.weights for f in found]), torch.cat([f.masked for f in found])
    return PinnTrained(whole, found[0].epochs, weights, masked)


def estimates_of(
    problems: Sequence[SegmentProblem],
    found: PinnTrained,
    runs: int,
    began: float,
    method: str,
    average_share: float,
    identifiable_below: float,
) -> list[SegmentEstimate]:
    """Estimates of segments whose runs follow each other in `found`.

    Args:
        problems: the segments, in the order of the lanes.
        found: of `train_lanes`.
        runs: runs of each segment.
        began: `time.perf_counter()` when the work began [s].
        method: name of the method.
        average_share: of the training.
        identifiable_below: largest relative bound that counts as identifiable [-].

    Returns:
        One estimate for each segment, with curves: total loss and parameters of each run, the other losses over runs.
    """
    seconds = (time.perf_counter() - began) / (runs * len(problems))
    results = []
    for row, problem in enumerate(problems):
        of = slice(row * runs, (row + 1) * runs)
        one = estimate_of(
            problem, found.trained.lanes(of), average_share, seconds, found.epochs,
            identifiable_below=identifiable_below, pace_below=STILL_PACE,
        )  # fmt: skip
        results.append(replace(one, method=method))
    return results
