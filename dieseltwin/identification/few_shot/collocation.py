"""Negative log-likelihood of heads and log-parameters over one segment, its gradient and Gauss-Newton Hessian.

A residual at time t depends on the linear outputs z of the three states, their rates dz/dt at t, and four parameters.
So cost and gradient need little more than the point's own equations, and the Hessian of all points is assembled from a
10 x 10 matrix at each point, H_jk = Q_j' S Q_k + ..., where Q and dQ/dt are the heads' columns: a few matrix products
of some 40 million multiplications, whatever the number of residuals. That is most of an iteration, and is done where it
is asked for only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from dieseltwin.arrays import Array
from dieseltwin.identification.few_shot._compiled import (
    CURVATURE_ROWS,
    N_CHANNELS,
    N_STATES,
    curvature,
    residuals,
    weighted_columns,
)
from dieseltwin.identification.few_shot.heads import Heads
from dieseltwin.identification.few_shot.residuals import N_HEALTH, Cylinder, DrivenInputs, PointModel


@dataclass(frozen=True)
class Data:
    """Readings of R runs on one segment and what corrects the model for the basis.

    Attributes:
        readings: (R, n, C) in the order of `MEASURED` [SI]; any finite value where masked.
        weights: (n, C) or (R, n, C) one over sigma, 0 where masked.
        process_noise: (3,), (n, 3) or (R, n, 3) standard deviation of the physics residuals [Pa/s, Pa/s, rad/s2].
        rate_defect: (R or 1, n, 3) residual that the projected exact solution leaves [Pa/s, Pa/s, rad/s2].
        reading_defect: (R or 1, n, C) exact minus projected solution as the sensors see it [SI].
    """

    readings: Tensor
    weights: Tensor
    process_noise: Tensor
    rate_defect: Tensor
    reading_defect: Tensor

    @cached_property
    def rows(self) -> dict[str, Array]:
        """The same for the compiled kernels: (R, 3 or C, n) each."""
        runs, n = self.readings.shape[:2]
        return {name: value.expand(runs, n, -1).mT.contiguous().numpy() for name, value in vars(self).items()}


@dataclass(frozen=True)
class Curvature:
    """What the Gauss-Newton Hessian of R runs is assembled from.

    Attributes:
        points: (R, 45, n) of each point, see `_compiled.CURVATURE_ROWS`.
        corner: (R, 4, 4) of the log-parameters among each other, summed over the points.
    """

    points: Tensor
    corner: Tensor


@dataclass(frozen=True)
class Objective:
    """Objective of R runs.

    Attributes:
        cost: (R,) negative log-likelihood up to a constant; infinite where the model fails.
        gradient: (R, m).
        curvature: of the Gauss-Newton Hessian, tails of the physics residuals included as weights.
        physics: (R, 3, n) physics residuals over process noise [-].
        data: (R, C, n) data residuals over sigma [-].
        cylinder: x_r and T_1 at the points.
    """

    cost: Tensor
    gradient: Tensor
    curvature: Curvature
    physics: Tensor
    data: Tensor
    cylinder: Cylinder

    def tensors(self) -> list[Tensor]:
        """All of them; the first axis is that of the runs."""
        return [self.cost, self.gradient, *vars(self.curvature).values(), self.physics, self.data, *self.cylinder]

    def take(self, lanes: Tensor) -> Objective:
        """The same for some of the runs."""
        cost, gradient, points, corner, physics, data, x_r, T_1 = (v[lanes] for v in self.tensors())
        return Objective(cost, gradient, Curvature(points, corner), physics, data, Cylinder(x_r, T_1))

    def put(self, lanes: Tensor, other: Objective, of: Tensor) -> None:
        """Replace runs by some of another objective's."""
        for mine, others in zip(self.tensors(), other.tensors(), strict=True):
            mine[lanes] = others[of]


@dataclass(frozen=True)
class Collocation:
    """Heads, driven inputs and model of one segment.

    Attributes:
        heads: orthonormal heads.
        inputs: (n,) driven inputs.
        model: equations with x_r and T_1 eliminated.
    """

    heads: Heads
    inputs: DrivenInputs
    model: PointModel

    @property
    def size(self) -> int:
        """Number of unknowns m: heads, then four log-parameters."""
        return self.heads.size + N_HEALTH

    def __call__(
        self,
        unknowns: Tensor,
        data: Data,
        dof: float,
        *,
        lanes: Tensor | None = None,
        start: Cylinder | None = None,
    ) -> Objective:
        """Evaluate K runs.

        Data residuals are Gaussian. A physics residual r over its process noise costs (dof + 1)/2 log(1 + r^2/dof), a
        Student tail: points that the basis cannot follow pull with bounded force.

        Args:
            unknowns: (K, m) heads and log-parameters.
            data: of R runs.
            dof: degrees of freedom of the tails; infinite for Gaussian residuals.
            lanes: (K,) runs of `data` that are evaluated; None for all.
            start: warm start of x_r and T_1.

        Returns:
            The objective.
        """
        heads, log_health = unknowns[:, :-N_HEALTH], unknowns[:, -N_HEALTH:]
        count, n = len(unknowns), len(self.heads.columns[0])
        which = (torch.arange(count) if lanes is None else lanes).numpy()
        path = self.heads.trajectory(heads)
        point = self.model(path.states, log_health, self.inputs, start=start)
        if point.slopes is None:
            raise ValueError("the model returned no derivatives")
        of = data.rows
        cost, by_health = unknowns.new_empty(count), unknowns.new_empty(count, N_HEALTH)
        physics, misfit = unknowns.new_empty(count, N_STATES, n), unknowns.new_empty(count, N_CHANNELS, n)
        by_point = unknowns.new_empty(count, N_STATES, 2 * n)
        found = Curvature(unknowns.new_empty(count, CURVATURE_ROWS, n), unknowns.new_empty(count, N_HEALTH, N_HEALTH))
        rows, values = path.rows.numpy(), point.values.contiguous().numpy()
        residuals(
            which, rows, values, of["readings"], of["weights"], of["process_noise"], of["rate_defect"],
            of["reading_defect"], dof, cost.numpy(), physics.numpy(), misfit.numpy(),
        )  # fmt: skip
        curvature(
            which, rows, point.slopes.contiguous().numpy(), of["weights"], of["process_noise"], dof, physics.numpy(),
            misfit.numpy(), by_point.numpy(), by_health.numpy(), found.points.numpy(), found.corner.numpy(),
        )  # fmt: skip
        by_heads = [by_point[:, j] @ both for j, both in enumerate(self.heads.stacked)]
        return Objective(cost, torch.cat([*by_heads, by_health], -1), found, physics, misfit, point.cylinder)

    def hessian(self, of: Curvature, lane: int, out: Array) -> None:
        """Write the Gauss-Newton Hessian (m, m) of one run: below its diagonal blocks nothing is written."""
        stacked = [both.numpy() for both in self.heads.stacked]
        points = of.points[lane].numpy()
        at = 0
        for j, both in enumerate(stacked):
            end = at + both.shape[1]
            own, others = np.empty_like(both), np.empty((len(both), self.size - end))
            weighted_columns(points, j, *stacked, own, others)
            out[at:end, at:end] = own.T @ own
            out[at:end, end:] = both.T @ others
            at = end
        out[at:, at:] = of.corner[lane].numpy()
