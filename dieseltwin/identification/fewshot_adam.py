"""Few-shot estimator as printed: Adam on the heads of frozen bodies, the unknowns and the self-adaptive weights.

Source: paper, section "Results: Few-shot transfer learning" and appendix "Detailed loss function". All runs of all
segments are lanes of one tensor program. The derivative of a state is dh/dt W with dh/dt computed once; the eight Adam
optimisers of the paper differ in nothing but their learning rate, and Adam works element by element, so one update
over the concatenated unknowns with a rate for each is the same thing (the weights' rate is negative: they ascend).

float32 is safe here: the loop's own noise (learning rates of 1e-3) is four orders above its rounding, and rates are
sums of flows whose relative rounding of 1e-7 is 1e-3 of the least residual. Lanes never mix, but a product over more
lanes is summed in another order: a batch equals its runs alone to rounding, not to the bit.

Not printed, and chosen in `params.yaml` on validation driving: learning rates and the units of the residuals (see
`losses`). Temperatures over 30 K: with 300 K the readings of T_em hardly count, x_r and T_1 wander and h_tot ends
25-40 % off. The self-adaptive weights of 1e3 let the heads fit the noise, so the unknowns are regressed on noisy states and
rates: A_egrmax stays 3 % low however long the loop runs, and h_tot drifts on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dieseltwin.engine import Actuation, actuate, bind, constants
from dieseltwin.identification.bound import cramer_rao
from dieseltwin.identification.fused_maps import fused_replacements
from dieseltwin.identification.heads import body_basis
from dieseltwin.identification.losses import (
    PAPER_WEIGHTS,
    Observed,
    Scales,
    Weights,
    starting_weights,
    total_loss,
    weights_gradient,
)
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.residuals import HEALTH, DrivenInputs, PointModel, driven_inputs, physics_residuals
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.identification.shooting import by_grid
from dieseltwin.identification.unknowns import START_SIGMA, health_of, starts, to_masked, to_physical

METHOD = "few-shot-adam"
BODIES = ("pressures", "pressures", "omega_t", "x_r", "T_1")
"""Body of p_im, p_em, omega_t, x_r, T_1; the first three are also differentiated."""
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Adam's own constants (Kingma & Ba 2014), left at their defaults by the paper."""
CURVE_POINTS = 200
"""Points of the curves that are kept."""
STILL_BELOW = 0.01
"""Relative change of every parameter over the last tenth of the epochs that counts as converged."""


@dataclass(frozen=True)
class AdamSettings:
    """Settings; `from_config` takes them from params.yaml.

    Attributes:
        start_at: "lab" or "truth" (only to show how much that flatters).
        start_sigma: spread of the starts in masked space [-] (paper: 0.2).
        epochs: epochs (paper: 30,000).
        weights_until_epoch: the self-adaptive weights rest from here on (paper: 20,000).
        rate_heads, rate_unknowns, rate_weights: learning rates (not printed).
        weight_start: alpha of the weights by channel (paper).
        scales: units of the residuals (not printed).
        lanes: runs in one tensor program; more lanes make longer vectors until they leave the cache.
        dtype: float32 or float64.
    """

    start_at: str = "lab"
    start_sigma: float = START_SIGMA
    epochs: int = 30000
    weights_until_epoch: int = 20000
    rate_heads: float = 1e-2
    rate_unknowns: float = 3e-3
    rate_weights: float = 1e-2
    weight_start: dict[str, float] = field(default_factory=lambda: dict(PAPER_WEIGHTS))
    scales: Scales = field(default_factory=lambda: Scales(T_1=30.0, T_em=30.0))
    lanes: int = 150
    dtype: torch.dtype = torch.float32

    @classmethod
    def from_config(cls, config: Any) -> AdamSettings:
        """Take the settings from `config.IdentifyConfig`, its section `adam`, `AdamSettings` or None."""
        if config is None:
            return cls()
        if isinstance(config, cls):
            return config
        own = getattr(config, "adam", config)
        common = {"start_at": config.start.at, "start_sigma": config.start.sd_masked} if own is not config else {}
        names = ("epochs", "weights_until_epoch", "rate_heads", "rate_unknowns", "rate_weights")
        given = {name: getattr(own, name) for name in names}
        scales = Scales(T_1=own.scale_t_1_k, T_em=own.scale_t_em_k, rate=own.scale_rates)
        return cls(weight_start=dict(own.weight_start), scales=scales, **given, **common)


def estimate(
    problems: Sequence[SegmentProblem],
    runs: int,
    seed: int,
    *,
    bodies: Any = None,
    operators: Any = None,
    maps: Any = None,
    config: Any = None,
) -> list[SegmentEstimate]:
    """Estimate the health parameters of each segment with the paper's loop.

    Args:
        problems: segments; `problem.parameters` gives the known parameters and the start (laboratory values).
        runs: runs R of each segment: other heads, weights, unknowns, map members, noise draws.
        seed: seed of all draws; a run's draws depend on (seed, segment, run) alone, not on the batch it runs in.
        bodies: trained bodies, or None for B-splines of the paper's widths.
        operators: trained actuator operators, or None for the exact actuators.
        maps: learned empirical maps, one dropout realisation a run, or None for the exact formulae.
        config: `params.identify`, its section `adam`, `AdamSettings` or None.

    Returns:
        One estimate for each segment, in order; standard deviations are left to the spread of the members.
    """
    settings = AdamSettings.from_config(config)
    results: dict[int, SegmentEstimate] = {}
    for group in by_grid(problems):
        began = time.perf_counter()
        lanes = [_lane(problems[i], i, run, seed, settings) for i in group for run in range(runs)]
        actuations = {i: actuate(problems[i].inputs, problems[i].parameters) for i in group}
        found = [
            train(lanes[a : a + settings.lanes], actuations, bodies, operators, maps, settings)
            for a in range(0, len(lanes), settings.lanes)
        ]
        health = np.concatenate([f.health for f in found]).reshape(len(group), runs, -1, len(HEALTH))
        states = np.concatenate([f.states for f in found]).reshape(len(group), runs, -1, 5)
        loss = np.concatenate([f.loss for f in found]).reshape(len(group), runs, -1)
        misfit = np.concatenate([f.misfit for f in found]).reshape(len(group), runs)
        seconds = (time.perf_counter() - began) / len(lanes)
        for row, i in enumerate(group):
            parts = (health[row], states[row], loss[row], misfit[row])
            results[i] = _estimate_of(problems[i], *parts, seconds, settings.epochs)
    return [results[i] for i in range(len(problems))]


@dataclass(frozen=True)
class Lane:
    """One run on one segment: what is drawn for it.

    Attributes:
        problem, index, run: the segment, its place, and the number of the run.
        readings: (n, 5) readings, NaN where masked.
        masked: (4,) starting unknowns in masked space.
        generator_seed: seed of heads and weights.
    """

    problem: SegmentProblem
    index: int
    run: int
    readings: NDArray[np.float64]
    masked: NDArray[np.float64]
    generator_seed: int


def _lane(problem: SegmentProblem, index: int, run: int, seed: int, settings: AdamSettings) -> Lane:
    rng = np.random.default_rng([seed, index, run])
    centre = health_of(problem.parameters)
    if settings.start_at == "truth" and problem.truth is not None:
        centre = health_of(problem.truth)
    masked = to_masked(starts(centre, 1, rng, settings.start_sigma))[0]
    draws = problem.noise_draws
    readings = problem.measured if draws is None else draws[run % len(draws)]
    return Lane(problem, index, run, readings[:, :5], masked, int(rng.integers(2**62)))


@dataclass(frozen=True)
class Trained:
    """What the loop found for L lanes.

    Attributes:
        health: (L, points, 4) parameters along the epochs [SI]; the last ones are the result.
        states: (L, n, 5) p_im, p_em, omega_t, x_r, T_1 [SI].
        loss: (L, points) total loss.
        misfit: (L,) sum of squared data residuals over sigma, divided by their number.
    """

    health: NDArray[np.float64]
    states: NDArray[np.float64]
    loss: NDArray[np.float64]
    misfit: NDArray[np.float64]


@dataclass(frozen=True)
class Program:
    """The tensor program of L lanes.

    Attributes:
        columns: five (k + 1, n) matrices, bias first, or (k + 1, 2 n) with the rates behind the columns.
        inputs: (L, n) driven inputs.
        observed: readings.
        model: bound equations, learned maps included.
        c: constants.
        n: samples.
    """

    columns: tuple[Tensor, ...]
    inputs: DrivenInputs
    observed: Observed
    model: Any
    c: Any
    n: int

    def widths(self) -> list[int]:
        """Heads of each state, bias included."""
        return [int(h.shape[0]) for h in self.columns]

    def states(self, z: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """States and rates from the linear outputs (paper, Eq. "mult-head derivative softplus")."""
        n, scale = self.n, self.observed.scales
        outputs, rates = [], []
        for value, factor in zip(z[:3], scale_of_states(scale), strict=True):
            outputs.append(factor * torch.nn.functional.softplus(value[:, :n]))
            rates.append(factor * torch.sigmoid(value[:, :n]) * value[:, n:])
        x_r = torch.sigmoid(z[3])
        T_1 = T_1_SCALE * torch.nn.functional.softplus(z[4]) + T_1_OFFSET
        return (*outputs, x_r, T_1), tuple(rates)

    def __call__(self, z: Sequence[Tensor], masked: Tensor, weights: Weights) -> Any:
        """Loss of the linear outputs (L, n or 2 n) and masked unknowns (L, 4)."""
        states, rates = self.states(z)
        health = to_physical(masked, torch).unsqueeze(-1).unbind(1)
        c = self.c._replace(**dict(zip(HEALTH, health, strict=True)))
        residuals = physics_residuals(self.model, states, rates, self.inputs, c)
        return total_loss(residuals, states, weights, self.observed)


T_1_SCALE, T_1_OFFSET = 300.0, 230.0
"""Output transform of T_1 [K]: 300 (softplus(z) + 230/300) (paper, table of networks)."""
P_SCALE, OMEGA_SCALE = 1e5, 5e3
"""Output scaling of the pressures [Pa] and of omega_t [rad/s] (paper, table of networks)."""


def scale_of_states(scales: Scales) -> tuple[float, float, float]:
    """Output scaling of p_im, p_em, omega_t (paper, table of networks); independent of the residuals' units."""
    return (P_SCALE, P_SCALE, OMEGA_SCALE)


def train(
    lanes: Sequence[Lane],
    actuations: dict[int, Actuation],
    bodies: Any,
    operators: Any,
    maps: Any,
    settings: AdamSettings,
    progress: Callable[[int], None] | None = None,
) -> Trained:
    """Run the loop over L lanes of one sample grid.

    Args:
        lanes: the runs.
        actuations: of the segments, by their index.
        bodies, operators, maps: as `estimate`.
        settings: settings.
        progress: called with the epoch now and then.

    Returns:
        Parameters, states and loss of each lane.
    """
    program = _program(lanes, actuations, bodies, operators, maps, settings)
    values, rates, sizes = _start(lanes, program, settings)
    count, n = len(lanes), program.n
    at = np.cumsum([0, *program.widths()])
    n_heads, n_down = int(at[-1]), int(at[-1]) + len(HEALTH)
    first, second = torch.zeros_like(values), torch.zeros_like(values)
    gradient = torch.zeros_like(values)
    keep = np.unique(np.linspace(0, settings.epochs, min(CURVE_POINTS, settings.epochs + 1)).round().astype(int))
    curve_health, curve_loss = [], []

    def forward(leaf: bool) -> tuple[list[Tensor], Tensor, Weights, Any]:
        z = [values[:, at[j] : at[j + 1]] @ program.columns[j] for j in range(5)]
        masked = values[:, n_heads:n_down].clone()
        weights = Weights(values[:, n_down : n_down + 4 * n].view(count, 4, n), values[:, n_down + 4 * n :])
        if leaf:
            for v in (*z, masked):
                v.requires_grad_()
        return z, masked, weights, program(z, masked, weights)

    for epoch in range(settings.epochs + 1):
        z, masked, weights, loss = forward(True)
        if epoch in keep:
            curve_health.append(to_physical(masked.detach(), torch))
            curve_loss.append(loss.total.detach())
            if progress is not None:
                progress(epoch)
        if epoch == settings.epochs:
            break
        *dz, d_masked = torch.autograd.grad(loss.total.sum(), [*z, masked])
        for j in range(5):
            gradient[:, at[j] : at[j + 1]] = dz[j] @ program.columns[j].T
        gradient[:, n_heads:n_down] = d_masked
        live = values.shape[1] if epoch < settings.weights_until_epoch else n_down
        if live > n_down:
            up = weights_gradient(loss, weights)
            gradient[:, n_down : n_down + 4 * n] = up.pointwise.reshape(count, -1)
            gradient[:, n_down + 4 * n :] = up.single
        g, m, v = gradient[:, :live], first[:, :live], second[:, :live]
        m.lerp_(g, 1.0 - BETA_1)
        v.mul_(BETA_2).addcmul_(g, g, value=1.0 - BETA_2)
        correct = (1.0 - BETA_2 ** (epoch + 1)) ** 0.5
        step = m / (v.sqrt().add_(EPSILON * correct))
        values[:, :live].addcmul_(step, rates[:live], value=-correct / (1.0 - BETA_1 ** (epoch + 1)))

    with torch.no_grad():
        z, masked, weights, loss = forward(False)
        states, _ = program.states(z)
    present = program.observed.present
    scale = torch.tensor(program.observed.scales.channels, dtype=values.dtype)
    sigma = torch.tensor(np.stack([lane.problem.sigma[:5] for lane in lanes]), dtype=values.dtype)
    pointwise = loss.mean_squares * present[..., :4].transpose(1, 2).sum(-1, keepdim=True)
    t_em = loss.single[:, 0] * present[..., 4].sum(-1)
    squares = torch.cat([pointwise.sum(-1), t_em[:, None]], 1) * (scale / sigma).square()
    misfit = squares.sum(-1) / present.sum((1, 2)).clamp(min=1.0)
    return Trained(
        torch.stack(curve_health, 1).double().numpy(), torch.stack(states, -1).double().numpy(),
        torch.stack(curve_loss, 1).double().numpy(), misfit.double().numpy(),
    )  # fmt: skip


def _program(
    lanes: Sequence[Lane],
    actuations: dict[int, Actuation],
    bodies: Any,
    operators: Any,
    maps: Any,
    settings: AdamSettings,
) -> Program:
    dtype = settings.dtype
    time_s = lanes[0].problem.time_s
    columns = []
    for j, name in enumerate(BODIES):
        h, dh = body_basis(name, time_s, bodies)
        one, zero = np.ones((len(h), 1)), np.zeros((len(h), 1))
        both = np.concatenate([np.hstack([one, h]), np.hstack([zero, dh])]) if j < 3 else np.hstack([one, h])
        columns.append(torch.tensor(both.T.copy(), dtype=dtype))
    inputs: dict[int, DrivenInputs] = {}
    initial: dict[int, NDArray[np.float64]] = {}
    for lane in lanes:
        if lane.index not in inputs:
            told = driven_inputs(actuations[lane.index])
            if operators is not None:
                states = operators.predict(lane.problem.inputs)
                k = lane.problem.parameters.K_egr
                told = told._replace(
                    u_egr=torch.tensor(k * states.u_egr1 - (k - 1.0) * states.u_egr2), u_vgt=torch.tensor(states.u_vgt)
                )
            inputs[lane.index] = told
            initial[lane.index] = _initial(lane.problem, told)
    stacked = DrivenInputs(
        *(torch.stack(v).to(dtype) for v in zip(*(inputs[lane.index] for lane in lanes), strict=True))
    )
    c = _shared_constants(lanes, dtype)
    readings = torch.tensor(np.stack([lane.readings for lane in lanes]))
    present = torch.isfinite(readings).to(dtype)
    begin = torch.tensor(np.stack([initial[lane.index] for lane in lanes]), dtype=dtype)
    observed = Observed(torch.nan_to_num(readings).to(dtype), present, begin, settings.scales)
    replace = None
    if maps is not None:
        replace = fused_replacements(maps, [lane.run + 1 for lane in lanes], stacked.u_egr, c, dtype)
    return Program(tuple(columns), stacked, observed, bind("torch", replace=replace), c, len(time_s))


def _shared_constants(lanes: Sequence[Lane], dtype: torch.dtype) -> Any:
    """Constants of the lanes: floats where all agree, (L, 1) tensors where segments differ (ambient)."""
    sets = [constants(lane.problem.parameters) for lane in lanes]
    columns = []
    for values in zip(*sets, strict=True):
        same = all(v == values[0] for v in values)
        columns.append(values[0] if same else torch.tensor(values, dtype=dtype)[:, None])
    return type(sets[0])(*columns)


def _initial(problem: SegmentProblem, inputs: DrivenInputs) -> NDArray[np.float64]:
    """True initial states where the problem has them (as in the paper), else first readings and the fixed point."""
    if problem.true_initial is not None:
        return np.asarray(problem.true_initial, dtype=np.float64)
    states = torch.tensor(problem.first_states())
    model = PointModel(problem.parameters)
    health = [torch.tensor([[v]]) for v in health_of(problem.parameters)]
    first = DrivenInputs(*(v[:1] for v in inputs))
    cylinder = model.cylinder(states[None, None], health, first, None)
    return np.array([*states.numpy(), float(cylinder.x_r), float(cylinder.T_1)])


def _start(lanes: Sequence[Lane], program: Program, settings: AdamSettings) -> tuple[Tensor, Tensor, list[int]]:
    """Draw heads, unknowns and weights, (L, M), and the signed learning rate of each column, (M,).

    Heads are N(0, 2 / (in + out)) and sorted, biases zero (paper).
    """
    rows = []
    for number, lane in enumerate(lanes):
        generator = torch.Generator().manual_seed(lane.generator_seed)
        parts = []
        for width in program.widths():
            draw = torch.randn(width - 1, generator=generator, dtype=torch.float64) * (2.0 / width) ** 0.5
            parts += [torch.zeros(1, dtype=torch.float64), torch.sort(draw).values]
        parts.append(torch.tensor(lane.masked))
        readings = program.observed.readings[number : number + 1].double()
        weights = starting_weights(readings, generator, settings.weight_start)
        parts += [weights.pointwise.flatten(), weights.single.flatten()]
        rows.append(torch.cat(parts))
    values = torch.stack(rows).to(settings.dtype)
    n_heads = sum(program.widths())
    rates = torch.full((values.shape[1],), -settings.rate_weights, dtype=settings.dtype)
    rates[:n_heads] = settings.rate_heads
    rates[n_heads : n_heads + len(HEALTH)] = settings.rate_unknowns
    return values, rates, program.widths()


def _estimate_of(
    problem: SegmentProblem, health: NDArray[np.float64], states: NDArray[np.float64], loss: NDArray[np.float64],
    misfit: NDArray[np.float64], seconds: float, epochs: int = 0,
) -> SegmentEstimate:  # fmt: skip
    final = health[:, -1]
    earlier = health[:, -max(2, health.shape[1] // 10)]
    finite = np.isfinite(final).all(axis=1) & np.isfinite(loss[:, -1])
    still = finite & (np.abs(final / earlier - 1.0) <= STILL_BELOW).all(axis=1)
    used = still if still.any() else (finite if finite.any() else np.ones_like(finite))
    pooled = np.exp(np.log(final[used]).mean(axis=0))
    pooled_states = states[used].mean(axis=0)
    bound = cramer_rao([problem], pooled, pooled_states[0, :3])[0]
    nothing = np.full(final.shape, np.nan)
    return SegmentEstimate(
        t0_s=problem.t0_s, t1_s=problem.t1_s, time_s=problem.time_s, parameters=final, std=nothing,
        interval_90=np.stack([nothing, nothing], -1), states=pooled_states, bound=bound.absolute,
        identifiable=bound.identifiable(), converged=still, seconds_per_run=seconds, method=METHOD,
        chi2_per_sample=misfit, state_samples=states[used], parameter_samples=final[used],
        curves={
            "epoch": np.linspace(0, epochs, loss.shape[1]).round(), "loss": loss.T,
            **{name: health[..., i].T for i, name in enumerate(HEALTH)},
        },
    )  # fmt: skip
