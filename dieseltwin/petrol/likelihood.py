"""Robust likelihood of the balances with the maps' own uncertainty as nuisances.

y = B (theta + delta) + e: theta are the calibrated coefficients, delta what may differ in this recording (their
covariance, a level, a smooth field, a slow drift, the throttle's zero), e is Student-t. delta is fitted to its most
probable value and integrated out (Laplace), so a map that is poorly known in a region can't be evidence there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]

FREEDOM = 4.0  # of Student's t: tip-ins and gear changes are outliers
ITERATIONS = 4  # of the reweighting; it starts at the null fit
LEAST_SUPPORT = 1e-4  # columns with less weight than this anywhere are left out


@dataclass(frozen=True)
class BalanceFit:
    """The fit of one balance: log-likelihood, delta, residual (m,), weights (m,), factor of the posterior precision."""

    log_likelihood: float
    delta: Array
    residual: Array
    weight: Array
    factor: tuple[Array, bool]
    design: Array
    row_log_likelihood: Array

    def project(self, direction: Array) -> Array:
        """Direction with what the nuisances explain taken out, weighted: P s with P = W - W B A^-1 B' W."""
        weighted = self.weight * direction
        return np.asarray(weighted - self.weight * (self.design @ cho_solve(self.factor, self.design.T @ weighted)))


def fit_balance(
    y: Array, design: Array, theta: Array, prior: Array, scale: Array, tempering: float, start: Array | None = None
) -> BalanceFit:
    """Robust posterior mode of delta and the marginal log-likelihood (up to what no hypothesis changes).

    Args:
        y: (m,) balance [-].
        design: (m, k) basis columns.
        theta: (k,) expected coefficients; 0 for nuisances without a calibrated value.
        prior: (k, k) covariance of delta.
        scale: (m,) Student-t scale [-]; infinite where a block says nothing.
        tempering: divides the log-likelihood.
        start: (m,) residuals to take the first weights from.
    """
    used = np.abs(design).max(axis=0) > LEAST_SUPPORT
    B, C = design[:, used], prior[np.ix_(used, used)]
    target = y - B @ theta[used]
    precision = np.linalg.inv(C)
    inverse_square = 1.0 / (scale * scale)
    residual = target if start is None else start
    for _ in range(ITERATIONS):
        w = (FREEDOM + 1.0) / (FREEDOM + residual * residual * inverse_square) * inverse_square / tempering
        factor = cho_factor(precision + B.T @ (B * w[:, None]))
        delta = cho_solve(factor, B.T @ (w * target))
        residual = target - B @ delta
    rows = -0.5 * (FREEDOM + 1.0) / tempering * np.log1p(residual * residual * inverse_square / FREEDOM)
    log_det = 2.0 * float(np.log(np.diag(factor[0])).sum()) + float(np.linalg.slogdet(C)[1])
    value = float(rows.sum()) - 0.5 * float(delta @ precision @ delta) - 0.5 * log_det
    full = np.zeros(len(theta))
    full[used] = delta
    return BalanceFit(value, full, residual, w, factor, B, rows)
