"""Robust likelihood of the balances with the maps' own uncertainty as nuisances.

y = B (theta + delta) + e: theta are the calibrated coefficients, delta what may differ in this recording (their
covariance, a level, a smooth field, a slow drift, the throttle's zero), e is Student-t. delta is fitted to its most
probable value and integrated out (Laplace), so a map that is poorly known in a region can't be evidence there.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
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


@dataclass(frozen=True)
class Prior:
    """Covariance (k, k) of the nuisances; inverses of its parts are kept, hypotheses ask for the same ones."""

    covariance: Array
    _known: dict[bytes, tuple[Array, float]] = field(default_factory=dict)

    def restricted(self, used: NDArray[np.bool_]) -> tuple[Array, float]:
        """Precision and log determinant of the covariance of the coefficients in `used`."""
        key = used.tobytes()
        if key not in self._known:
            part = self.covariance[np.ix_(used, used)]
            self._known[key] = np.asarray(np.linalg.inv(part), dtype=np.float64), float(np.linalg.slogdet(part)[1])
        return self._known[key]


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def normal_equations(design, weight, target, precision):  # type: ignore[no-untyped-def]
    """precision + B' W B and B' W y for a design with few entries a row; about 20 of 140 here."""
    m, k = design.shape
    A = precision.copy()
    b = np.zeros(k)
    places = np.empty(k, dtype=np.int64)
    for i in range(m):
        w = weight[i]
        if w == 0.0:
            continue
        count = 0
        for j in range(k):
            if design[i, j] != 0.0:
                places[count] = j
                count += 1
        for p in range(count):
            j = places[p]
            scaled = w * design[i, j]
            b[j] += scaled * target[i]
            for q in range(p + 1):
                A[j, places[q]] += scaled * design[i, places[q]]
    for j in range(k):
        for q in range(j):
            A[q, j] = A[j, q]
    return A, b


def fit_balance(
    y: Array, design: Array, theta: Array, prior: Prior, scale: Array, tempering: float, start: Array | None = None
) -> BalanceFit:
    """Robust posterior mode of delta and the marginal log-likelihood (up to what no hypothesis changes).

    Args:
        y: (m,) balance [-].
        design: (m, k) basis columns.
        theta: (k,) expected coefficients; 0 for nuisances without a calibrated value.
        prior: of delta.
        scale: (m,) Student-t scale [-]; infinite where a block says nothing.
        tempering: divides the log-likelihood.
        start: (m,) residuals to take the first weights from.
    """
    used = np.abs(design).max(axis=0) > LEAST_SUPPORT
    B = np.ascontiguousarray(design[:, used])
    precision, log_det_prior = prior.restricted(used)
    target = y - B @ theta[used]
    inverse_square = 1.0 / (scale * scale)
    residual = target if start is None else start
    for _ in range(ITERATIONS):
        w = (FREEDOM + 1.0) / (FREEDOM + residual * residual * inverse_square) * inverse_square / tempering
        A, b = normal_equations(B, w, target, precision)
        factor = cho_factor(A)
        delta = cho_solve(factor, b)
        residual = target - B @ delta
    rows = -0.5 * (FREEDOM + 1.0) / tempering * np.log1p(residual * residual * inverse_square / FREEDOM)
    log_det = 2.0 * float(np.log(np.diag(factor[0])).sum()) + log_det_prior
    value = float(rows.sum()) - 0.5 * float(delta @ precision @ delta) - 0.5 * log_det
    full = np.zeros(len(theta))
    full[used] = delta
    return BalanceFit(value, full, residual, w, factor, B, rows)
