"""Baseline: retune the four health parameters and look at what is left: chi-square and whiteness of the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dieseltwin.challenge.baselines.model import Bound, Net
from dieseltwin.engine import HEALTH

ITERATIONS = 8
HALVINGS = 4
LAGS = 25  # samples over which whiteness is tested: 5 s
_STEP = 1e-4  # of differences, relative
_CONVERGED = 0.1  # of chi-square


@dataclass(frozen=True)
class HealthFit:
    """Health parameters, initial states (W, 3) and whitened residuals (n, C) of the fit."""

    health: dict[str, float]
    local: np.ndarray
    residual: np.ndarray

    @property
    def chi2(self) -> float:
        """Sum of squares of the whitened residuals."""
        return float(np.sum(self.residual**2))


def fit_health(
    bound: Bound, *, start: Mapping[str, float] | None = None, local: np.ndarray | None = None, free: bool = True,
    net: Net | None = None, iterations: int = ITERATIONS,
) -> HealthFit:  # fmt: skip
    """Gauss-Newton over the logarithms of the health parameters and every window's initial states.

    Args:
        start: health parameters to start at, laboratory values by default; local: initial states to start at;
        free: False holds the health parameters; net: a correction.
    """
    health = {name: float((start or bound.laboratory)[name]) for name in HEALTH}
    names = HEALTH if free else ()
    local = bound.first_local() if local is None else local
    bounds = np.append(bound.starts, bound.time_s.size)

    def residual(h: Mapping[str, float], x: np.ndarray) -> np.ndarray:
        return bound.whiten(bound.measured - bound.simulate(h, x, net))

    r = residual(health, local)
    for _ in range(iterations):
        base = bound.simulate(health, local, net)
        by_health = [
            bound.whiten(bound.simulate({**health, n: health[n] * (1.0 + _STEP)}, local, net) - base) / _STEP
            for n in names
        ]
        by_local = []
        for k in range(3):
            moved = local.copy()
            moved[:, k] *= 1.0 + _STEP
            by_local.append(bound.whiten(bound.simulate(health, moved, net) - base) / _STEP)
        step_h, step_x = _step(r, np.array(by_health).reshape(len(names), *r.shape), np.array(by_local), bounds)
        factor, before = 1.0, float(np.sum(r**2))
        for _ in range(HALVINGS):
            h = {**health, **{n: health[n] * float(np.exp(np.clip(factor * s, -0.5, 0.5)))
                              for n, s in zip(names, step_h, strict=True)}}  # fmt: skip
            x = local * np.exp(np.clip(factor * step_x, -0.2, 0.2))
            tried = residual(h, x)
            if np.sum(tried**2) < before:
                health, local, r = h, x, tried
                break
            factor *= 0.3
        if before - float(np.sum(r**2)) < _CONVERGED:
            break
    return HealthFit(health, local, r)


def _step(
    r: np.ndarray, by_health: np.ndarray, by_local: np.ndarray, bounds: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares step with the initial states eliminated window by window: (4,), (W, 3) relative."""
    p = by_health.shape[0]
    normal, right = 1e-9 * np.eye(p), np.zeros(p)
    kept = []
    for a, b in pairwise(bounds):
        j = by_health[:, a:b].reshape(p, (b - a) * r.shape[1]).T
        s = by_local[:, a:b].reshape(3, -1).T
        y = r[a:b].ravel()
        inverse = np.linalg.inv(s.T @ s + 1e-3 * np.eye(3))
        project_j, project_y = inverse @ (s.T @ j), inverse @ (s.T @ y)
        normal += j.T @ (j - s @ project_j)
        right += j.T @ (y - s @ project_y)
        kept.append((project_j, project_y))
    step = np.linalg.solve(normal, right) if p else np.zeros(0)
    return step, np.array([y - (j @ step if p else 0.0) for j, y in kept])


def statistics(fit: HealthFit) -> dict[str, float]:
    """Chi-square over its degrees of freedom and the Ljung-Box sum, both in standard deviations of a perfect twin."""
    n, channels = fit.residual.shape
    dof = n * channels - 4 - fit.local.size
    box = 0.0
    for values in fit.residual.T:
        centred = values - values.mean()
        variance = float(np.mean(centred**2))
        for k in range(1, LAGS + 1):
            box += float(np.mean(centred[k:] * centred[:-k]) / variance) ** 2 * (n - k)
    expected = LAGS * channels
    return {"chi2": float((fit.chi2 - dof) / np.sqrt(2.0 * dof)),
            "whiteness": float((box - expected) / np.sqrt(2.0 * expected))}  # fmt: skip
