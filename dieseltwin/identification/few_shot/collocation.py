"""Negative log-likelihood of heads and log-parameters over one segment, its gradient and Gauss-Newton
Hessian.

A residual at time t depends on the linear outputs z of the three states, their rates dz/dt at t, and four
parameters.
So the Hessian of all points is assembled from a 10 x 10 matrix at each point, H_jk = Q_j' S Q_k + ...,
where Q and dQ/dt
are the heads' columns: a few matrix products an iteration, whatever the number of residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dieseltwin.identification.few_shot.heads import Heads
from dieseltwin.identification.few_shot.residuals import N_HEALTH, Cylinder, DrivenInputs, PointModel

N_STATES = 3


@dataclass(frozen=True)
class Data:
    """Readings of R runs on one segment and what corrects the model for the basis.

    Attributes:
        readings: (R, n, 6) in the order of `MEASURED` [SI]; any finite value where masked.
        weights: (n, 6) or (R, n, 6) one over sigma, 0 where masked.
        process_noise: (3,), (n, 3) or (R, n, 3) standard deviation of the physics residuals [Pa/s, Pa/s,
            rad/s2].
        rate_defect: (R or 1, n, 3) residual that the projected exact solution leaves [Pa/s, Pa/s, rad/s2].
        reading_defect: (R or 1, n, 6) exact minus projected solution as the sensors see it [SI].
    """

    readings: Tensor
    weights: Tensor
    process_noise: Tensor
    rate_defect: Tensor
    reading_defect: Tensor

    def take(self, lanes: Tensor) -> Data:
        """The same for some of the runs."""

        def rows(value: Tensor) -> Tensor:
            return value[lanes] if value.dim() == 3 and value.shape[0] > 1 else value

        return Data(*(rows(v) for v in vars(self).values()))


@dataclass(frozen=True)
class Quadratic:
    """Objective of R runs and its local model.

    Attributes:
        cost: (R,) negative log-likelihood up to a constant; infinite where the model fails.
        gradient: (R, m); None where not asked.
        hessian: (R, m, m) Gauss-Newton, tails of the physics residuals included as weights.
        physics: (R, n, 3) physics residuals over process noise [-].
        data: (R, n, 6) data residuals over sigma [-].
        cylinder: x_r and T_1 at the points.
    """

    cost: Tensor
    gradient: Tensor | None
    hessian: Tensor | None
    physics: Tensor
    data: Tensor
    cylinder: Cylinder


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
        derivatives: bool = True,
        start: Cylinder | None = None,
    ) -> Quadratic:
        """Evaluate R runs.

        Data residuals are Gaussian. A physics residual r over its process noise costs (dof + 1)/2 log(1 +
        r^2/dof), a
        Student tail: points that the basis cannot follow pull with bounded force.

        Args:
            unknowns: (R, m) heads and log-parameters.
            data: of the same R runs.
            dof: degrees of freedom of the tails; infinite for Gaussian residuals.
            derivatives: also return gradient and Hessian.
            start: warm start of x_r and T_1.

        Returns:
            The objective.
        """
        heads, log_health = unknowns[:, :-N_HEALTH], unknowns[:, -N_HEALTH:]
        path = self.heads.trajectory(heads)
        point = self.model(path.states, log_health, self.inputs, derivatives=derivatives, start=start)
        physics = (path.rates - point.rates - data.rate_defect) / data.process_noise
        predicted = torch.cat([path.states, point.readings], -1) + data.reading_defect
        misfit = (predicted - data.readings) * data.weights
        if dof == float("inf"):
            tail, pull = 0.5 * physics**2, torch.ones_like(physics)
        else:
            tail = 0.5 * (dof + 1.0) * torch.log1p(physics**2 / dof)
            pull = ((dof + 1.0) / (dof + physics**2)).sqrt()
        cost = 0.5 * (misfit**2).sum((-1, -2)) + tail.sum((-1, -2))
        cost = torch.where(torch.isfinite(cost), cost, torch.full_like(cost, float("inf")))
        if point.d_rates is None or point.d_readings is None:
            return Quadratic(cost, None, None, physics, misfit, point.cylinder)

        runs, n = physics.shape[:2]
        local = physics.new_zeros(runs, n, 9, 10)  # rows: 3 physics, 6 channels; columns: z, dz/dt, log-parameters
        over = (pull / data.process_noise).unsqueeze(-1)
        local[..., :3, :3] = -point.d_rates[..., :3] * path.slope.unsqueeze(-2)
        local[..., :3, 6:] = -point.d_rates[..., 3:]
        for j in range(N_STATES):
            local[..., j, j] += path.bend[..., j]
            local[..., j, 3 + j] = path.slope[..., j]
            local[..., 3 + j, j] = path.slope[..., j]
        local[..., :3, :] *= over
        local[..., 6:, :3] = point.d_readings[..., :3] * path.slope.unsqueeze(-2)
        local[..., 6:, 6:] = point.d_readings[..., 3:]
        local[..., 3:, :] *= data.weights.unsqueeze(-1)
        residual = torch.cat([physics * pull, misfit], -1).unsqueeze(-1)
        transposed = local.transpose(-1, -2)
        gradient, hessian = self._assemble((transposed @ residual).squeeze(-1), transposed @ local)
        return Quadratic(cost, gradient, hessian, physics, misfit, point.cylinder)

    def _assemble(self, g: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        """Chain pointwise gradients (R, n, 10) and Hessians (R, n, 10, 10) with the heads' columns."""
        runs, widths = g.shape[0], self.heads.widths
        at = [sum(widths[:j]) for j in range(N_STATES + 1)]
        hessian = g.new_empty(runs, self.size, self.size)
        gradient = g.new_empty(runs, self.size)
        n = g.shape[1]
        for j in range(N_STATES):
            both = torch.cat([self.heads.columns[j], self.heads.rates[j]]).T  # (K_j, 2 n)
            right = g.new_empty(runs, 2 * n, self.size - at[j] + 1)
            for k in range(j, N_STATES):
                q, dq = self.heads.columns[k], self.heads.rates[k]
                there = slice(at[k] - at[j], at[k + 1] - at[j])
                upper, lower = right[:, :n, there], right[:, n:, there]
                torch.mul(s[:, :, j, k, None], q, out=upper)
                upper.addcmul_(s[:, :, j, 3 + k, None], dq)
                torch.mul(s[:, :, 3 + j, k, None], q, out=lower)
                if j == k:
                    lower.addcmul_(s[:, :, 3 + j, 3 + k, None], dq)
            right[:, :n, -5:-1], right[:, n:, -5:-1] = s[:, :, j, 6:], s[:, :, 3 + j, 6:]
            right[:, :n, -1], right[:, n:, -1] = g[:, :, j], g[:, :, 3 + j]
            block = torch.matmul(both, right)  # (R, K_j, remaining columns + gradient)
            rows = slice(at[j], at[j + 1])
            hessian[:, rows, at[j] :] = block[..., :-1]
            hessian[:, at[j] :, rows] = block[..., :-1].transpose(1, 2)
            gradient[:, rows] = block[..., -1]
        hessian[:, at[-1] :, at[-1] :] = s[..., 6:, 6:].sum(1)
        gradient[:, at[-1] :] = g[..., 6:].sum(1)
        return gradient, hessian
