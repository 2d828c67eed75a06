"""Where the labels of a map jump with the turbo speed.

The published turbine map changes its form within some 30 rad/s, and much of idle rests just there. A smooth network
fitted to labels on both sides smears that over hundreds of rad/s; it is given the place of the jump, which is read off
the labels here, not from the formula.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

BIN = 2.5e-4  # of the speed: width of the bins in which rows are summed
WINDOW = 0.12  # of the speed, on both sides of a place, in which the labels are looked at
REFINED_WINDOWS = (0.12, 0.02)  # the same for the two refinements
GRID = 200  # places tried
ROWS_MIN = 500  # rows in the window below which nothing is claimed
VARIANCE_MIN = 1e-10  # labels that hardly change in the window
GAIN_MIN = 0.02  # of the variance in the window that the jump must explain
NARROWEST = 2e-3  # of the speed: half distance of the knots in the search
SINGULAR = 1e-9  # of the trace, added to the normal matrix: labels may be flat on one side


@dataclass(frozen=True)
class _Sums:
    """Sums over bins of speed: g = sum(q q^T) (k, 3, 3), h = sum(q y) (k, 3), n and sums of y and y^2 (k,)."""

    speed: np.ndarray
    g: np.ndarray
    h: np.ndarray
    n: np.ndarray
    y: np.ndarray
    yy: np.ndarray

    def near(self, at: float, window: float) -> _Sums:
        """The bins within a window (relative to the speed) about a place."""
        rows = np.abs(self.speed - at) < window * at
        return _Sums(self.speed[rows], self.g[rows], self.h[rows], self.n[rows], self.y[rows], self.yy[rows])

    def variance(self) -> float:
        """Variance of the labels."""
        n = self.n.sum()
        return float(self.yy.sum() / n - (self.y.sum() / n) ** 2)

    def rest(self, low: float, high: float) -> float:
        """Mean square of the labels less a parabola over the ratio below `low` and another above `high`, blended."""
        after = np.clip((self.speed - low) / (high - low), 0.0, 1.0)
        before = 1.0 - after
        gram = np.empty((6, 6))
        gram[:3, :3] = np.tensordot(before * before, self.g, 1)
        gram[:3, 3:] = gram[3:, :3] = np.tensordot(before * after, self.g, 1)
        gram[3:, 3:] = np.tensordot(after * after, self.g, 1)
        gram[np.diag_indices(6)] += SINGULAR * np.trace(gram)
        moment = np.concatenate([before @ self.h, after @ self.h])
        return float(self.yy.sum() - moment @ np.linalg.solve(gram, moment)) / float(self.n.sum())


def _summed(speed: np.ndarray, ratio: np.ndarray, label: np.ndarray) -> _Sums:
    bins = np.floor(np.log(speed) / BIN).astype(np.int64)
    bins -= bins.min()
    _, of_row = np.unique(bins, return_inverse=True)
    powers = [np.bincount(of_row, ratio**k) for k in range(5)]
    g = np.stack([np.stack([powers[i + j] for j in range(3)], axis=-1) for i in range(3)], axis=-2)
    h = np.stack([np.bincount(of_row, ratio**k * label) for k in range(3)], axis=-1)
    n = powers[0]
    return _Sums(np.bincount(of_row, speed) / n, g, h, n, h[:, 0], np.bincount(of_row, label * label))


def find_jump(speed: np.ndarray, ratio: np.ndarray, label: np.ndarray) -> tuple[float, float] | None:
    """Speeds [rad/s] between which the labels change over, or None where no place stands out.

    Args:
        speed: turbo speed [rad/s]; ratio: blade speed ratio [-]; label: turbine efficiency [-]; all (n,).
    """
    sums = _summed(speed, ratio, label)
    best_gain, best_at = 0.0, np.nan
    slowest, fastest = np.quantile(speed, (0.01, 0.99))
    for at in np.geomspace(slowest, fastest, GRID):
        near = sums.near(at, WINDOW)
        below = near.n[near.speed < at].sum()
        if min(below, near.n.sum() - below) < ROWS_MIN or near.variance() < VARIANCE_MIN:
            continue
        # against a slow change over the whole window, so that a mere slope doesn't count
        slow = near.rest((1.0 - WINDOW) * at, (1.0 + WINDOW) * at)
        gain = (slow - near.rest(at * (1.0 - NARROWEST), at * (1.0 + NARROWEST))) / near.variance()
        if gain > best_gain:
            best_gain, best_at = gain, float(at)
    if best_gain < GAIN_MIN:
        return None
    knots = best_at * (1.0 - NARROWEST), best_at * (1.0 + NARROWEST)
    for window in REFINED_WINDOWS:
        # beside the jump the labels change too, so the last look is a close one
        knots = _refined(sums.near(best_at, window), knots)
    return knots


def _refined(near: _Sums, knots: tuple[float, float]) -> tuple[float, float]:
    """Knots of the least rest, from several starts about the given ones."""
    middle, half = 0.5 * (knots[0] + knots[1]), 0.5 * (knots[1] - knots[0])

    def at(q: np.ndarray) -> tuple[float, float]:
        width = max(abs(q[1]) * half, BIN * middle)
        return float(middle * (1.0 + q[0]) - width), float(middle * (1.0 + q[0]) + width)

    trials = [
        minimize(
            lambda q: near.rest(*at(q)), [shift, width], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 0.0}
        )
        for shift in (-0.005, 0.0, 0.005)
        for width in (1.0, 3.0)
    ]
    return at(min(trials, key=lambda t: float(t.fun)).x)
