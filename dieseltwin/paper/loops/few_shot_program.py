"""The tensor program of the few-shot loop: lanes (runs of segments), their draws, states, residuals and loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dieseltwin.engine import HEALTH, Actuation, bind, constants
from dieseltwin.identification.few_shot.heads import SCALES, body_basis
from dieseltwin.identification.few_shot.residuals import (
    DrivenInputs,
    PhysicsResiduals,
    PointModel,
    driven_inputs,
    physics_residuals,
)
from dieseltwin.identification.few_shot.term_model import TermModel
from dieseltwin.identification.in_place import told_actuation
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.unknowns import health_of, start_centre, starts, to_masked, to_physical
from dieseltwin.paper.loop_settings import AdamConfig, PinnConfig
from dieseltwin.paper.loops.fused_maps import Dropout, fused_replacements
from dieseltwin.paper.loops.losses import (
    Loss,
    Observed,
    Weights,
    starting_weights,
    total_loss,
)
from dieseltwin.surrogates.output_transforms import TRANSFORMS

if TYPE_CHECKING:
    from dieseltwin.settings.params import StartConfig
    from dieseltwin.surrogates.bodies import Bodies
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from dieseltwin.surrogates.operators import ActuatorOperators

METHOD = "few-shot-adam"
LANES = 150
"""Runs in one tensor program: more make longer vectors until they leave the cache."""
BODIES = ("pressures", "pressures", "omega_t", "x_r", "T_1")
"""Body of p_im, p_em, omega_t, x_r, T_1; the first three are also differentiated."""
_T_1 = TRANSFORMS["t_1_k"]


@dataclass(frozen=True)
class Lane:
    """One run on one segment: what is drawn for it.

    Attributes:
        problem, index, run: the segment, its place, and the number of the run.
        readings: (n, 5) readings, NaN where masked.
        masked: (4,) starting unknowns in masked space.
        generator_seed: seed of heads and weights.
        held_out: (n, 5) readings that no loss sees; None = none.
    """

    problem: SegmentProblem
    index: int
    run: int
    readings: NDArray[np.float64]
    masked: NDArray[np.float64]
    generator_seed: int
    held_out: NDArray[np.bool_] | None = None


def draw_lane(
    problem: SegmentProblem, index: int, run: int, seed: int, start: StartConfig, held_out_share: float = 0.0
) -> Lane:
    """Draw what run `run` of the segment `index` needs; no loss sees `held_out_share` of its readings."""
    rng = np.random.default_rng([seed, index, run])
    centre = start_centre(problem.parameters, problem.truth, start.at)
    masked = to_masked(starts(centre, 1, rng, start.sd_masked))[0]
    draws = problem.noise_draws
    readings = problem.measured if draws is None else draws[run % len(draws)]
    lane = Lane(problem, index, run, readings[:, :5], masked, int(rng.integers(2**62)))
    return lane if held_out_share <= 0.0 else replace(lane, held_out=rng.random(lane.readings.shape) < held_out_share)


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
        held_out: (L, n, 5) 1 where a reading exists that no loss sees; None = none.
        dropout: renews the learned maps' realisations; None = they stay.
    """

    columns: tuple[Tensor, ...]
    inputs: DrivenInputs
    observed: Observed
    model: Any
    c: Any
    n: int
    held_out: Tensor | None = None
    dropout: Dropout | None = None

    @property
    def dtype(self) -> torch.dtype:
        """float32 or float64."""
        return self.observed.readings.dtype

    def renew(self) -> None:
        """Draw the dropout of the next epoch."""
        if self.dropout is not None:
            self.dropout.draw()

    def widths(self) -> list[int]:
        """Heads of each state, bias included."""
        return [int(h.shape[0]) for h in self.columns]

    def points(self, z: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Linear outputs (L, n or 2 n) cut into eight (L, n): values of the five states, rates of the first three."""
        n = self.n
        return (*(v[:, :n] for v in z[:3]), *z[3:], *(v[:, n:] for v in z[:3]))

    def states(self, z: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """States and rates from the linear outputs (paper, Eq. "mult-head derivative softplus")."""
        return self._states(self.points(z))

    def _states(self, points: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        outputs, rates = [], []
        for value, rate, factor in zip(points[:3], points[5:], SCALES, strict=True):
            outputs.append(factor * torch.nn.functional.softplus(value))
            rates.append(factor * torch.sigmoid(value) * rate)
        x_r = torch.sigmoid(points[3])
        T_1 = _T_1.scale * torch.nn.functional.softplus(points[4]) + _T_1.scale * _T_1.offset
        return (*outputs, x_r, T_1), tuple(rates)

    def __call__(self, z: Sequence[Tensor], masked: Tensor, weights: Weights) -> Loss:
        """Loss of the linear outputs (L, n or 2 n) and masked unknowns (L, 4)."""
        residuals, states = self.residuals(z, masked)
        return total_loss(residuals, states, weights, self.observed)

    def residuals(self, z: Sequence[Tensor], masked: Tensor) -> tuple[PhysicsResiduals, tuple[Tensor, ...]]:
        """Physics residuals with the predicted flows, and the states, of linear outputs and masked unknowns."""
        states, rates = self.states(z)
        health = to_physical(masked, torch).unsqueeze(-1).unbind(1)
        return self._residuals(states, rates, health), states

    def _residuals(
        self, states: tuple[Tensor, ...], rates: tuple[Tensor, ...], health: Sequence[Tensor]
    ) -> PhysicsResiduals:
        c = self.c._replace(**dict(zip(HEALTH, health, strict=True)))
        return physics_residuals(self.model, states, rates, self.inputs, c)

    def at_points(self, points: Sequence[Tensor], health: Sequence[Tensor], weights: Weights) -> Loss:
        """Loss of `points` and four health values, each (L, n): every operation but the sums is one point's own."""
        states, rates = self._states(points)
        return total_loss(self._residuals(states, rates, health), states, weights, self.observed)

    @torch.no_grad()
    def held_out_misfit(self, z: Sequence[Tensor], masked: Tensor, sigma: Tensor) -> Tensor:
        """(L,) mean square over sigma (L, 5) of the readings that no loss sees; infinite where it isn't finite."""
        if self.held_out is None:
            return torch.zeros(masked.shape[0], dtype=masked.dtype)
        residuals, states = self.residuals(z, masked)
        predicted = torch.stack([*states[:3], residuals.W_egr, residuals.T_em], -1)
        error = (predicted - self.observed.readings) / sigma[:, None] * self.held_out
        misfit = error.square().sum((1, 2)) / self.held_out.sum((1, 2)).clamp(min=1.0)
        return torch.where(torch.isfinite(misfit), misfit, torch.full_like(misfit, float("inf")))


def make_program(
    lanes: Sequence[Lane],
    actuations: dict[int, Actuation],
    bodies: Bodies | None,
    operators: ActuatorOperators | None,
    maps: EmpiricalMaps | None,
    settings: AdamConfig | PinnConfig,
    dtype: torch.dtype = torch.float32,
) -> Program:
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
            told = driven_inputs(told_actuation(actuations[lane.index], operators, lane.problem.parameters))
            inputs[lane.index] = told
            initial[lane.index] = _initial(lane.problem, told, actuations[lane.index])
    stacked = DrivenInputs(
        *(torch.stack(v).to(dtype) for v in zip(*(inputs[lane.index] for lane in lanes), strict=True))
    )
    c = _shared_constants(lanes, dtype)
    readings = torch.tensor(np.stack([lane.readings for lane in lanes]))
    present, held_out = torch.isfinite(readings).to(dtype), None
    unseen = [lane.held_out for lane in lanes if lane.held_out is not None]
    if unseen:
        held_out = present * torch.tensor(np.stack(unseen), dtype=dtype)
        present = present - held_out
    begin = torch.tensor(np.stack([initial[lane.index] for lane in lanes]), dtype=dtype)
    by_channel = torch.nan_to_num(readings).to(dtype).transpose(1, 2).contiguous()  # contiguous in time
    observed = Observed(by_channel.transpose(1, 2), present, begin, settings.scales)
    learned, dropout = None, None
    if maps is not None:
        if settings.fresh_dropout and maps.dropout > 0.0:
            dropout = Dropout([lane.generator_seed for lane in lanes])
        learned = fused_replacements(maps, [lane.run + 1 for lane in lanes], stacked.u_egr, c, dtype, dropout)
    model: Any = bind("torch", replace=learned)
    if lanes[0].problem.parameters.terms:
        own = [actuations[lane.index] for lane in lanes]
        model = TermModel(learned, lanes[0].problem.parameters, own, dtype=dtype)
    return Program(tuple(columns), stacked, observed, model, c, len(time_s), held_out, dropout)


def _shared_constants(lanes: Sequence[Lane], dtype: torch.dtype) -> Any:
    """Constants of the lanes: floats where all agree, (L, 1) tensors where segments differ (ambient)."""
    sets = [constants(lane.problem.parameters) for lane in lanes]
    columns = []
    for values in zip(*sets, strict=True):
        same = all(v == values[0] for v in values)
        columns.append(values[0] if same else torch.tensor(values, dtype=dtype)[:, None])
    return type(sets[0])(*columns)


def _initial(problem: SegmentProblem, inputs: DrivenInputs, actuation: Actuation) -> NDArray[np.float64]:
    """True initial states where the problem has them (as in the paper), else first readings and the fixed point."""
    if problem.true_initial is not None:
        return np.asarray(problem.true_initial, dtype=np.float64)
    states = torch.tensor(problem.first_states())
    model = PointModel(problem.parameters, actuation=actuation)
    health = [torch.tensor([[v]]) for v in health_of(problem.parameters)]
    first = DrivenInputs(*(v[:1] for v in inputs))
    cylinder = model.cylinder(states[None, None], health, first, None)
    return np.array([*states.numpy(), float(cylinder.x_r), float(cylinder.T_1)])


def start_values(lanes: Sequence[Lane], program: Program, settings: AdamConfig) -> tuple[Tensor, Tensor]:
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
        alpha = {name: settings.weight_share * value for name, value in settings.weight_start.items()}
        weights = starting_weights(readings, generator, alpha)
        parts += [weights.pointwise.flatten(), weights.single.flatten()]
        rows.append(torch.cat(parts))
    values = torch.stack(rows).to(program.dtype)
    n_heads = sum(program.widths())
    rates = torch.full((values.shape[1],), -settings.rate_weights, dtype=program.dtype)
    rates[:n_heads] = settings.rate_heads
    rates[n_heads : n_heads + len(HEALTH)] = settings.rate_unknowns
    return values, rates
