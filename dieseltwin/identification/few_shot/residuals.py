"""Physics residuals and predicted readings at given states, over (runs, time), with pointwise derivatives.

Every formula is the engine's own: this module only asks for `quantities` and their derivatives. Those of the published
equations are compiled (`engine.tangents`); learned maps (`bind("torch", replace=maps)`) and the terms of an engine are
differentiated by torch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from dieseltwin.engine import HEALTH, Actuation, Constants, EngineParameters, bind, constants
from dieseltwin.engine._compiled_tangents import N_RESULTS, linearise_points
from dieseltwin.engine.array_namespace import with_charge
from dieseltwin.engine.tangents import VALUES
from dieseltwin.identification.few_shot.term_model import TermModel

N_HEALTH = len(HEALTH)

X_R_START, T_1_START = 0.03, 310.0
"""Start of the cylinder's fixed point as in the published simulation, x_r [-] and T_1 [K]."""
COLD_SWEEPS, WARM_SWEEPS = 4, 2
"""Pairs of sweeps of the fixed point; each pair shrinks the error 400-fold, a warm start is off by a step's
change."""


class DrivenInputs(NamedTuple):
    """What drives the equations at n points: n_e [rpm], u_delta [mg], u~_egr, u~_vgt [%]; each (.., n)."""

    n_e: Tensor
    u_delta: Tensor
    u_egr: Tensor
    u_vgt: Tensor


def driven_inputs(actuation: Actuation) -> DrivenInputs:
    """Inputs and actuator positions at the sample times of a segment, (n,) each."""
    return DrivenInputs(*(torch.tensor(c, dtype=torch.float64) for c in actuation.at_samples()))


class Cylinder(NamedTuple):
    """Fixed point of the cylinder equations: x_r [-] and T_1 [K], each (.., n)."""

    x_r: Tensor
    T_1: Tensor


@dataclass(frozen=True)
class Point:
    """The model at given states with x_r and T_1 eliminated.

    Attributes:
        values: (R, V, n) `tangents.VALUES`: dp_im/dt, dp_em/dt [Pa/s], domega_t/dt [rad/s2], and the readings that are
            not states [SI].
        cylinder: x_r and T_1, also the warm start of the next call.
        slopes: (R, V, 7, n) derivatives of the values with respect to p_im, p_em, omega_t and the log-parameters; None
            if not asked.
    """

    values: Tensor
    cylinder: Cylinder
    slopes: Tensor | None = None

    @property
    def rates(self) -> Tensor:
        """(R, n, 3) rates of the states."""
        return self.values[:, :3].mT

    @property
    def readings(self) -> Tensor:
        """(R, n, V - 3) readings that are not states."""
        return self.values[:, 3:].mT


class PointModel:
    """The engine's equations at points, x_r and T_1 eliminated exactly.

    The fixed point of x_r and T_1 (A.9, A.10) is solved by the engine's own sweeps. Its derivative follows from the
    implicit function theorem, (I - dg/d(x_r, T_1))^-1 dg/d(states, parameters), a 2 x 2 system at each point; nothing
    is unrolled. With learned maps or terms derivatives are reverse mode, one sweep an output: each touches its own part
    of the equations only. The exact engine's are compiled tangents (`engine.tangents`).

    Args:
        parameters: known parameters (the health values in it are not used).
        maps: equation name -> learned map over torch tensors, or None for the exact formulae.
        lanes: runs R that the maps hold a member for each, 1 where all runs share one.
        actuation: of the segment, needed where the parameters have terms: these may depend on time.
    """

    def __init__(
        self,
        parameters: EngineParameters,
        maps: Mapping[str, Callable[..., Tensor]] | None = None,
        lanes: int = 1,
        actuation: Actuation | None = None,
    ) -> None:
        self.model: Any = bind("torch", replace=maps)
        if parameters.terms:
            if actuation is None:
                raise ValueError("equations with terms need the segment's actuation")
            self.model = TermModel(maps, parameters, [actuation], pointwise=True)
        self.lanes = lanes
        self.compiled = maps is None and not parameters.terms
        self.constants: Constants = constants(parameters)

    def with_health(self, health: tuple[Tensor, ...] | list[Tensor]) -> Constants:
        """The constants with tensors (broadcasting against the points) in place of the four health values."""
        return self.constants._replace(**dict(zip(HEALTH, health, strict=True)))

    def cylinder(self, states: Tensor, health: list[Tensor], inputs: DrivenInputs, start: Cylinder | None) -> Cylinder:
        """Fixed point x_r, T_1 at states (.., n, 3); `start` None starts cold."""
        c = self.with_health(health)
        p_im, p_em = states[..., 0], states[..., 1]
        now = start or Cylinder(torch.full_like(p_im, X_R_START), torch.full_like(p_im, T_1_START))
        for _ in range(COLD_SWEEPS if start is None else WARM_SWEEPS):
            if isinstance(self.model, TermModel):
                q = self.model.settle((p_im, p_em, states[..., 2]), inputs, now.x_r, now.T_1, c)
                now = Cylinder(q.x_r_next, q.T_1_next)
            else:
                sweep = self.model.settle_cylinder(p_im, p_em, inputs.n_e, inputs.u_delta, now.x_r, now.T_1, c)
                now = Cylinder(sweep.x_r, sweep.T_1)
        return now

    @torch.no_grad()
    def __call__(
        self,
        states: Tensor,
        log_health: Tensor,
        inputs: DrivenInputs,
        *,
        derivatives: bool = True,
        start: Cylinder | None = None,
    ) -> Point:
        """Rates and readings at given states.

        Args:
            states: (R, n, 3) p_im, p_em [Pa], omega_t [rad/s].
            log_health: (R, 4) logarithms of the health values [log SI].
            inputs: of shape (n,) or (R, n).
            derivatives: also return the pointwise Jacobians.
            start: warm start of the fixed point.

        Returns:
            The point values; R may be 1.
        """
        if self.compiled:
            return self._compiled(states, log_health, inputs, derivatives, start)
        health = list(torch.exp(log_health).unsqueeze(1).unbind(-1))  # four of (R, 1)
        cylinder = self.cylinder(states, health, inputs, start)
        x = [*states.unbind(-1), *cylinder]
        if not derivatives:
            values = _columns(self.model.quantities(*x, *inputs, self.with_health(health)), VALUES, x[0])
            return Point(torch.stack(values, 1), cylinder)

        shape = states.shape[:-1]
        with torch.enable_grad():
            point = [v.detach().expand(shape).clone().requires_grad_() for v in (*x, *health)]
            q = self.model.quantities(*point[:5], *inputs, self.with_health(point[5:]))
            columns = _columns(q, (*VALUES, *FOLLOWED), point[0])
            # Points don't mix: the gradient of a sum over points is each point's own row of the Jacobian.
            rows = [
                torch.autograd.grad(column.sum(), point, retain_graph=True, materialize_grads=True)
                for column in columns
            ]
        # A health value moves by itself in the direction of its logarithm.
        size = [1.0] * 5 + [v.detach() for v in point[5:]]
        jacobian = torch.stack([torch.stack([g * s for g, s in zip(row, size, strict=True)], -1) for row in rows], -2)
        values = torch.stack([column.detach() for column in columns[: len(VALUES)]], 1)
        return Point(values, cylinder, _eliminate(jacobian).movedim(1, -1).contiguous())

    def _compiled(
        self, states: Tensor, log_health: Tensor, inputs: DrivenInputs, derivatives: bool, start: Cylinder | None
    ) -> Point:
        """The same, from the compiled kernel of the published equations."""
        runs, n = states.shape[:2]
        begin = start or (states.new_tensor(X_R_START), states.new_tensor(T_1_START))
        cylinder = torch.stack([v.expand(runs, n) for v in begin], 1)
        driven = torch.stack([v.expand(-1, n) for v in torch.atleast_2d(*inputs)], 1)
        results = states.new_empty(runs, N_RESULTS, n)
        linearise_points(
            states.mT.contiguous().numpy(), cylinder.numpy(), driven.numpy(),
            torch.exp(log_health).expand(runs, -1).contiguous().numpy(), np.array(self.constants),
            COLD_SWEEPS if start is None else WARM_SWEEPS, results.numpy(),
        )  # fmt: skip
        slopes = results[:, len(VALUES) :].unflatten(1, (len(VALUES), -1)) if derivatives else None
        return Point(results[:, : len(VALUES)], Cylinder(*cylinder.unbind(1)), slopes)


FOLLOWED = ("x_r_next", "T_1_next")
"""What the fixed point's x_r and T_1 are equal to."""


def _columns(q: Any, names: Sequence[str], like: Tensor) -> list[Tensor]:
    """Quantities by name in the shape of another, also those that are a constant of the published model."""
    found = (getattr(q, name) for name in names)
    return [value.expand_as(like) if isinstance(value, Tensor) else value + 0.0 * like for value in found]


def _eliminate(jacobian: Tensor) -> Tensor:
    """Total derivatives (R, n, V, 7) from partial ones (R, n, V + 2, 9), the last rows and columns 3-4 being the fixed
    point."""
    outer = torch.cat([jacobian[..., :3], jacobian[..., 5:]], -1)
    last = len(VALUES)
    gain = jacobian[..., last:, 3:5]
    a, b = 1.0 - gain[..., 0, 0], -gain[..., 0, 1]
    c, d = -gain[..., 1, 0], 1.0 - gain[..., 1, 1]
    det = (a * d - b * c).unsqueeze(-1)
    rhs_x, rhs_t = outer[..., last, :], outer[..., last + 1, :]
    d_x = (d.unsqueeze(-1) * rhs_x - b.unsqueeze(-1) * rhs_t) / det
    d_t = (a.unsqueeze(-1) * rhs_t - c.unsqueeze(-1) * rhs_x) / det
    inner = jacobian[..., :last, 3:5]
    return outer[..., :last, :] + inner[..., :1] * d_x.unsqueeze(-2) + inner[..., 1:] * d_t.unsqueeze(-2)


class PhysicsResiduals(NamedTuple):
    """Residuals of the five equations and the predicted readings, each (.., n).

    p_im, p_em [Pa/s], omega_t [rad/s2], x_r [-], T_1 [K]; W_egr [kg/s], T_em [K], W_c [kg/s].
    """

    p_im: Tensor
    p_em: Tensor
    omega_t: Tensor
    x_r: Tensor
    T_1: Tensor
    W_egr: Tensor
    T_em: Tensor
    W_c: Tensor


def physics_residuals(
    model: Any, states: tuple[Tensor, ...], rates: tuple[Tensor, ...], inputs: DrivenInputs, c: Constants
) -> PhysicsResiduals:
    """Residuals with x_r and T_1 as unknown functions of their own, as the paper has them.

    Source: paper, appendix "Detailed loss function", A.56a-e: r(p_im), r(p_em), r(omega_t), r(x_r), r(T_1). The last is
    T_1 - (x_r T_e + (1 - x_r) T_im) with the x_r of `states`; `q.T_1_next`, which the simulator sweeps with, has the
    x_r that follows from A.10, and x_r as an unknown function would drop out of it.

    Args:
        model: `engine.bind("torch", ...)` or a `TermModel`.
        states: p_im, p_em [Pa], omega_t [rad/s], x_r [-], T_1 [K], each (.., n).
        rates: time derivatives of the first three [Pa/s, Pa/s, rad/s2].
        inputs: driven inputs.
        c: constants, health values as tensors.

    Returns:
        Residuals and predicted readings, differentiable.
    """
    q = model.quantities(*states, *inputs, c)
    mixed = model.intake_valve_closing_temperature(states[3], q.T_e, with_charge(c, q.T_im, c.eta_sc))
    return PhysicsResiduals(
        rates[0] - q.dp_im, rates[1] - q.dp_em, rates[2] - q.domega_t,
        states[3] - q.x_r_next, states[4] - mixed, q.W_egr, q.T_em, q.W_c,
    )  # fmt: skip
