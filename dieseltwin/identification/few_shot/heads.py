"""Trajectories as heads on a frozen body: states and their rates are linear in the heads before the output transform.

Source: paper, section "Few-shot transfer learning", y = h W_out + b_out and dy/dt = (dh/dt) W_out, with the output
transforms of the table "Neural network for PINN". The bias is one more head on a constant column. The columns are made
orthonormal once (QR): a trained body's own columns have condition numbers of 1e8 to 1e16.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from torch import Tensor

from dieseltwin.errors import InputError
from dieseltwin.identification.few_shot._compiled import PATH_ROWS, transform
from dieseltwin.surrogates.output_transforms import TRANSFORMS

SCALES = tuple(TRANSFORMS[name].scale for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s"))
"""Output scaling of p_im, p_em [Pa] and omega_t [rad/s] behind the softplus (paper, table of networks)."""
RANK_TOLERANCE = 1e-9
"""Columns of a body whose singular value is below this share of the largest carry rounding errors only."""
SPLINE_WIDTHS = {"pressures": 125, "omega_t": 70, "x_r": 50, "T_1": 20}
"""Widths of the last hidden layers in the paper's table; splines of the same width stand in where no body
is given."""
SPLINE_DEGREE = 3
PAPER_SEGMENT_S = 60.0
"""Length of the segments that the paper's widths belong to [s]."""


class Body(Protocol):
    """A frozen body: h (n, k) and dh/dt (n, k) [1/s] at times in [0, 1] of a segment of `duration_s`."""

    def basis(self, time01: Any, duration_s: float = ...) -> tuple[Any, Any]: ...


@dataclass(frozen=True)
class SplineBody:
    """Cubic B-splines on uniform knots over a segment: a body that needs no training.

    Attributes:
        width: number of columns k.
    """

    width: int

    def basis(self, time01: ArrayLike, duration_s: float = 60.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Columns (n, k) [-] and their rates (n, k) [1/s]."""
        t = np.asarray(time01, dtype=np.float64)
        inner = np.linspace(0.0, 1.0, self.width - SPLINE_DEGREE + 1)
        knots = np.concatenate([np.zeros(SPLINE_DEGREE), inner, np.ones(SPLINE_DEGREE)])
        spline = BSpline(knots, np.eye(self.width), SPLINE_DEGREE)
        return spline(t), spline.derivative()(t) / duration_s


def body_basis(name: str, time_s: ArrayLike, bodies: Any | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns (n, k) and rates (n, k) [1/s] of one body at sample times [s]; splines where `bodies` is None."""
    t = np.asarray(time_s, dtype=np.float64)
    span = float(t[-1] - t[0])
    width = max(SPLINE_DEGREE + 1, round(SPLINE_WIDTHS[name] * span / PAPER_SEGMENT_S))  # the same knots a second
    body: Body = SplineBody(width) if bodies is None else bodies[name]
    h, dh = body.basis((t - t[0]) / span, span)
    return np.asarray(h, dtype=np.float64), np.asarray(dh, dtype=np.float64)


@dataclass(frozen=True)
class Heads:
    """Orthonormal columns for p_im, p_em and omega_t at the n sample times of a segment.

    Attributes:
        columns: three (n, k) orthonormal bases, of p_im, p_em (the same one) and omega_t [-].
        rates: their time derivatives [1/s].
    """

    columns: tuple[Tensor, Tensor, Tensor]
    rates: tuple[Tensor, Tensor, Tensor]

    @property
    def widths(self) -> tuple[int, int, int]:
        """Number of heads of each state."""
        a, b, c = (int(q.shape[1]) for q in self.columns)
        return a, b, c

    @property
    def size(self) -> int:
        """Number of heads of all states."""
        return sum(self.widths)

    def split(self, heads: Tensor) -> tuple[Tensor, ...]:
        """(.., size) heads by state."""
        return torch.split(heads, list(self.widths), -1)

    @cached_property
    def stacked(self) -> tuple[Tensor, Tensor, Tensor]:
        """Columns and below them their rates, (2 n, k) of each state."""
        a, b, c = (torch.cat(pair) for pair in zip(self.columns, self.rates, strict=True))
        return a, b, c

    def trajectory(self, heads: Tensor) -> Trajectory:
        """States and rates of (R, size) heads."""
        n = self.columns[0].shape[0]
        z = heads.new_empty(heads.shape[0], len(self.columns), 2 * n)
        for j, (part, both) in enumerate(zip(self.split(heads), self.stacked, strict=True)):
            torch.matmul(part, both.T, out=z[:, j])
        path = heads.new_empty(heads.shape[0], PATH_ROWS, n)
        transform(z.numpy(), np.array(SCALES), path.numpy())
        return Trajectory(path)

    def project(self, states: Tensor) -> Tensor:
        """Heads (R, size) of the least-squares projection of states (R, n, 3) in inverse-transformed
        space."""
        z = inverse_transform(states)
        return torch.cat([z[..., j] @ q for j, q in enumerate(self.columns)], -1)


@dataclass(frozen=True)
class Trajectory:
    """States of heads over time in the order p_im, p_em, omega_t.

    Attributes:
        rows: (R, 12, n) states, their rates, slopes (derivative of a state with respect to the linear output z; of a
            rate with respect to dz/dt, too) and bends (derivative of a rate with respect to z), three rows each.
    """

    rows: Tensor

    @property
    def states(self) -> Tensor:
        """(R, n, 3) [Pa, Pa, rad/s]."""
        return self.rows[:, :3].mT

    @property
    def rates(self) -> Tensor:
        """(R, n, 3) time derivatives of the states [per s]."""
        return self.rows[:, 3:6].mT


def inverse_transform(states: Tensor) -> Tensor:
    """Linear outputs z of states (.., 3): the inverse of scale * softplus(z). States must be positive."""
    y = states / states.new_tensor(SCALES)
    return y + torch.log(-torch.expm1(-y))


def heads_for(time_s: ArrayLike, bodies: Any | None = None) -> Heads:
    """Orthonormal heads for a segment.

    Args:
        time_s: (n,) sample times [s].
        bodies: trained bodies with "pressures" and "omega_t", or None for B-splines of the paper's widths.

    Returns:
        The heads, float64.

    Raises:
        InputError: fewer samples than heads.
    """
    made = {name: _orthonormal(*body_basis(name, time_s, bodies), name) for name in ("pressures", "omega_t")}
    p, w = made["pressures"], made["omega_t"]
    return Heads((p[0], p[0], w[0]), (p[1], p[1], w[1]))


def _orthonormal(h: Any, dh: Any, name: str) -> tuple[Tensor, Tensor]:
    """Orthonormal columns that span a constant and the body, and their rates: Q = [1, h] T, dQ/dt = [0,
    dh/dt] T."""
    h, dh = torch.from_numpy(h), torch.from_numpy(dh)
    if h.shape[0] < h.shape[1]:
        raise InputError(
            f"few-shot heads of {name}",
            f"{h.shape[0]} samples",
            f"{h.shape[1]} or more",
            "use longer segments",
        )
    one = torch.ones(h.shape[0], 1, dtype=torch.float64)
    full, rate = torch.cat([one, h], 1), torch.cat([torch.zeros_like(one), dh], 1)
    u, s, vt = torch.linalg.svd(full, full_matrices=False)
    keep = s > RANK_TOLERANCE * s[0]
    # U = full V / s: the same combination of the rates. Splines sum to one, so the constant adds nothing
    # there.
    return u[:, keep].contiguous(), (rate @ (vt[keep].T / s[keep])).contiguous()
