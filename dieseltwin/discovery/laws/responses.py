"""Response of the readings to any signal at a point, linearised once: thousands of features cost a few products.

An impulse at the k-th sample of every window at once is one lane, as windows don't touch. So the response of the
readings to whatever signal takes as many lanes as a window has samples, and is exact for small signals. What the search
needs of it are three things in the metric: the gradient of the residual, the information matrix of each window, and the
few directions (nuisances, parameters) that join the windows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.twins.interface import Array, Lanes, repeated
from dieseltwin.discovery.twins.windows import ends_of, window_of_rows

_IMPULSE = 1e-3  # of a point's scale
_MOST_KNOTS = 32  # of a window; longer windows carry hats of several samples
_LANES_AT_ONCE = 64


@dataclass(frozen=True)
class PointResponse:
    """A point in the metric.

    Attributes:
        rows: (W, K) sample of each knot.
        gradient: (W, K) of half the log likelihood for the knots' signals.
        information: (W, K, K) before the joining directions are taken out.
        joining: (D, W, K) directions that join windows.
    """

    rows: np.ndarray
    gradient: Array
    information: Array
    joining: Array

    def at_knots(self, features: Array) -> Array:
        """Features (F, n) -> their values at the knots (F, W, K)."""
        return features[:, self.rows]

    def gradients(self, at_knots: Array) -> Array:
        """(F,)"""
        return np.einsum("fwk,wk->f", at_knots, self.gradient)

    def products(self, left: Array, right: Array) -> Array:
        """Information between features given at the knots: (F, W, K), (G, W, K) -> (F, G)."""
        moved = np.einsum("fwk,wkl->fwl", left, self.information, optimize=True)
        flat = left.reshape(len(left), -1), right.reshape(len(right), -1)
        joining = self.joining.reshape(len(self.joining), -1)
        return moved.reshape(len(left), -1) @ flat[1].T - (flat[0] @ joining.T) @ (flat[1] @ joining.T).T

    def norms(self, at_knots: Array) -> Array:
        """Information of each feature, (F,)."""
        moved = np.einsum("fwk,wkl->fwl", at_knots, self.information, optimize=True)
        own = np.einsum("fwk,fwk->f", moved, at_knots)
        joined = at_knots.reshape(len(at_knots), -1) @ self.joining.reshape(len(self.joining), -1).T
        return np.asarray(own - (joined**2).sum(1))


class Responses:
    """Responses at one linearisation, point by point, kept once computed.

    Args:
        at: the linearisation.
        lanes: one lane at its estimate, with whatever signals and effects it holds.
    """

    def __init__(self, at: Linearisation, lanes: Lanes) -> None:
        self.at, self.lanes = at, lanes
        twin = at.twin
        n = len(twin.time_s)
        self._ends = ends_of(twin.starts, n)
        within = np.arange(n) - twin.starts[window_of_rows(twin.starts, n)]
        longest = int(np.max(self._ends - twin.starts))
        stride = -(-longest // _MOST_KNOTS)
        count = (longest - 1) // stride + 2
        self.knots = np.maximum(0.0, 1.0 - np.abs(within[:, None] / stride - np.arange(count)[None, :]))
        self.knots = self.knots[:, self.knots.any(axis=0)]  # (n, K): shares of the knots (hats)
        self._rows = np.minimum(
            twin.starts[:, None] + stride * np.arange(self.knots.shape[1])[None, :], self._ends[:, None] - 1
        )
        self._low_rank, self._half = self._joining_directions()
        self._points: dict[int, PointResponse] = {}

    def add_to_residual(self, response: Array) -> None:
        """Explain the residual plus a response (n, C) instead of the residual: what a law that is in must explain."""
        at = self.at
        projected = at.metric.project(response[None])[0]
        left = projected - (projected @ at.projected.T) @ at.covariance @ at.projected
        self._half = self._half + left[: at.whitening.present.size].reshape(self._half.shape)
        self._points.clear()

    def _joining_directions(self) -> tuple[Array, Array]:
        """Directions (D, n C) that join windows, and what is left of the residual (n, C) in the metric."""
        at = self.at
        rows = at.whitening.present.size
        if not np.isfinite(at.covariance).all():
            raise np.linalg.LinAlgError("the machine runs away")
        remaining = at.projected_residual - (at.projected_residual @ at.projected.T) @ at.covariance @ at.projected
        parts = [cholesky(at.covariance, lower=True).T @ at.projected[:, :rows]]
        if at.metric.nuisance_basis is not None:
            parts.append(at.metric.nuisance_basis[:, :rows])
        return np.vstack(parts), remaining[:rows].reshape(at.residual.shape)

    def point(self, index: int) -> PointResponse:
        """Response of the readings to signals at one point."""
        if index not in self._points:
            self._points[index] = self._respond(index)
        return self._points[index]

    def signals(self, index: int, signals: Array) -> Array:
        """Exact responses (F, n, C) to small signals (F, n) at a point, by simulation."""
        size = _IMPULSE * self.at.twin.points[index].scale / np.maximum(np.abs(signals).max(axis=1), 1e-300)
        return self._simulated(index, signals * size[:, None]) / size[:, None, None]

    def _simulated(self, index: int, signals: Array) -> Array:
        twin, base = self.at.twin, self.lanes
        out = np.empty((len(signals), *self.at.residual.shape))
        for first in range(0, len(signals), _LANES_AT_ONCE):
            some = signals[first : first + _LANES_AT_ONCE]
            lanes = replace(
                repeated(base, len(some)), lane_points=np.full(len(some), index),
                lane_signals=np.ascontiguousarray(some), linear=False,
            )  # fmt: skip
            out[first : first + len(some)] = twin.simulate(lanes) - self.at.simulated
        return out

    def _respond(self, index: int) -> PointResponse:
        at, count = self.at, self.knots.shape[1]
        channels = at.residual.shape[1]
        size = _IMPULSE * at.twin.points[index].scale
        response = self._simulated(index, np.ascontiguousarray(size * self.knots.T)) / size  # (K, n, C)
        whitened = at.whitening.apply(response)
        windows = len(at.twin.starts)
        along = at.metric.along_local(whitened).reshape(count, windows, -1)
        gradient, information = np.empty((windows, count)), np.empty((windows, count, count))
        joining = np.empty((len(self._low_rank), windows, count))
        half = self._half.reshape(-1)
        for w, (start, end) in enumerate(zip(at.twin.starts, self._ends, strict=True)):
            block = slice(int(start) * channels, int(end) * channels)
            own = whitened[:, block]
            gradient[w] = own @ half[block]
            information[w] = own @ own.T - along[:, w] @ along[:, w].T
            joining[:, w] = self._low_rank[:, block] @ own.T
        return PointResponse(self._rows, gradient, information, joining)
