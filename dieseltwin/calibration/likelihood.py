"""Coefficients from relations between noisy readings: generalised least squares with latent states.

Every reading is noisy and every relation only nearly right. For each point the true states x are unknown:

    sum over points (ln x_m - ln x)' N^-1 (ln x_m - ln x) + r(x, theta)' S^-1 r(x, theta)  +  prior

is minimised over theta and x (Gauss-Helmert model). Linearised in x, the states drop out: the whitened residual of
a point is L^-1 (r(x^, theta) + J (ln x_m - ln x^)) with L L' = J N J' + S. So noise on both sides of a relation does
not bias the coefficients, and a valve with a small pressure difference counts as little as it knows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import gammaln

from dieseltwin.arrays import MAD_TO_STD, Array
from dieseltwin.calibration.coefficients import Coefficient
from dieseltwin.calibration.steady_model import SteadyModel
from dieseltwin.recordings.noise import SETTLED_NOISE, flat_below
from dieseltwin.recordings.steady_points import STATES, SteadyPoints

STATE_STEP = 5e-4  # relative, of central differences in the states
COEFFICIENT_STEP = 1e-4  # of a prior standard deviation
STEEPEST = 200.0  # d ln r/d ln x is cut there: a speed line that is flat
STEP = 1e-4  # of coefficients and of the cost, relative: a step of the minimiser that changes less is the last one
SETTLED = 0.03  # prior standard deviations: an iteration that changes less is the last one
SETTLED_ERRORS = 0.03  # relative, of each relation's own error: likewise
CURVATURE = 1.0  # second-order error of a relation over the square of the noise that it carries [-]
LARGEST_SHIFT = 0.3  # of ln x in one iteration
ROBUST = 2.0  # whitened residuals beyond this count ever less
FLOOR = 0.003  # a submodel is never believed better than this [-]; `floors` of a call can say more
FULL_ITERATIONS = 20  # of a fit of all coefficients
FIRST_STEPS, MORE_STEPS = 14, 8  # of the inner minimiser
DEGREES = 4.0  # of Student's t
FAR = 3.0  # of a balance's logarithm, where it is cut
UNKNOWN = 1.0  # relative prior spread of a state that was not measured


@dataclass(frozen=True)
class Estimate:
    """Estimated coefficients and states.

    Attributes:
        coefficients: the P free ones.
        theta: (P,) values [unit]; covariance: (P, P).
        x: (n, 6) states after reconciliation.
        discrepancy: (R,) standard deviation of each relation beyond sensor noise [-].
        residual: (n, R) whitened residuals.
        cost: half the sum of robust squares, with the prior and with what normalises the errors.
        inflation: how many times the information was divided because neighbouring points err alike.
        converged: whether the last iterations changed nothing of note.
    """

    coefficients: tuple[Coefficient, ...]
    theta: Array
    covariance: Array
    x: Array
    discrepancy: Array
    residual: Array
    cost: float
    inflation: float
    converged: bool

    def values(self) -> dict[str, float]:
        """Name -> value."""
        return {c.name: float(v) for c, v in zip(self.coefficients, self.theta, strict=True)}

    def std(self) -> dict[str, float]:
        """Name -> standard deviation."""
        return {c.name: float(s) for c, s in zip(self.coefficients, np.sqrt(np.diag(self.covariance)), strict=True)}


def reading_noise(x: Array, noise: Mapping[str, float] | None = None) -> Array:
    """Standard deviation of readings over what they read, (n, 6) [-]: below `flat_below` it is as unsure as there.

    Args:
        x: (n, 6) readings, nan where there is none.
        noise: relative standard deviation of each in the middle of its range and above [-]; None: `SETTLED_NOISE`.
    """
    size, relative = np.abs(x), np.array([(noise or SETTLED_NOISE)[name] for name in STATES])
    return np.asarray(relative * np.maximum(1.0, flat_below(x) / np.where(size > 0.0, size, np.inf)))


def state_jacobian(model: SteadyModel, points: SteadyPoints, x: Array, values: Mapping[str, float]) -> Array:
    """d residual / d ln x, (n, R, 6), by central differences."""
    moved = 1.0 + STATE_STEP * np.concatenate([np.eye(x.shape[1]), -np.eye(x.shape[1])])
    up, down = np.split(model.relations(points, x * moved[:, None], values).residual, 2)
    slopes = np.moveaxis((up - down) / (2.0 * STATE_STEP), 0, -1)
    return np.clip(np.nan_to_num(slopes), -STEEPEST, STEEPEST)


def reading_covariance(model: SteadyModel, points: SteadyPoints, x: Array, values: Mapping[str, float],
                       sigma: Array) -> Array:  # fmt: skip
    """What the noise of readings makes of the balances of each point, (n, R, R), second order in flat places included.

    Args:
        x: (n, 6) readings; sigma: (n, 6) or (6,) relative standard deviation of each [-].
    """
    J = state_jacobian(model, points, x, values)
    return _carried(J, np.broadcast_to(sigma**2, x.shape))


def _carried(J: Array, variance: Array) -> Array:
    """Covariance (n, R, R) of the balances by slopes (n, R, 6) and variances (n, 6) of ln x. What the straight line
    leaves out grows with the square of the noise carried."""
    C = np.einsum("nij,nj,nkj->nik", J, variance, J)
    bent = np.einsum("nii->ni", C)
    return np.asarray(C + np.eye(C.shape[1]) * (CURVATURE * bent)[:, None, :] ** 2)


def balance_deviation(model: SteadyModel, points: SteadyPoints, values: Mapping[str, float],
                      errors: Array) -> Array:  # fmt: skip
    """What each balance may be off by, (n, R) [-]: the noise of its readings, large where pressures nearly agree, and
    its own errors (R,)."""
    known, x = np.isfinite(points.states()), points.states_filled()
    sigma = np.where(known, reading_noise(x), 0.0)
    noise = np.einsum("nii->ni", reading_covariance(model, points, x, values, sigma))
    return np.asarray(np.sqrt(noise + errors**2))


class _WithSlopes:
    """Residual and slopes of one call for a minimiser that asks for them apart.

    It takes nearly every step that it tries, and then wants the slopes there; a residual alone costs half as much.
    """

    def __init__(self, both: Callable[[Array], tuple[Array, Array]]) -> None:
        self._both = both
        self._last: tuple[Array, tuple[Array, Array]] | None = None

    def residual(self, z: Array) -> Array:
        """At z (P,)."""
        return self._at(z)[0]

    def slopes(self, z: Array) -> Array:
        """At z (P,), one column for each of its numbers."""
        return self._at(z)[1]

    def _at(self, z: Array) -> tuple[Array, Array]:
        if self._last is None or not np.array_equal(self._last[0], z):
            self._last = z.copy(), self._both(z)
        return self._last[1]


@dataclass(frozen=True)
class _Linear:
    whiten: Array  # (n, R, R) L^-1
    shift: Array  # (n, R) J (ln x_m - ln x^)
    jacobian: Array
    covariance: Array
    keep: NDArray[np.bool_]  # (R,) relations that count

    def shifted(self, residual: Array) -> Array:
        """Residuals (.., n, R) as the readings themselves would have them; none where a relation doesn't count."""
        return np.where(np.isfinite(residual) & self.keep, residual + self.shift, 0.0)

    def whitened(self, residual: Array) -> Array:
        """Residuals (n, R), whitened."""
        return np.einsum("nij,nj->ni", self.whiten, self.shifted(residual))


def estimate(
    model: SteadyModel,
    points: SteadyPoints,
    coefficients: Sequence[Coefficient],
    start: Mapping[str, float],
    *,
    rows: Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
    discrepancy: Mapping[str, float] | None = None,
    iterations: int = 6,
    inflate: bool = False,
    floors: Mapping[str, float] | None = None,
) -> Estimate:
    """Fit coefficients to points.

    Args:
        model, points: relations and n points.
        coefficients: what is free; all others as in `start` or the engine.
        start: name -> starting value (fixed values too).
        rows: relations that count; all of the model's by default.
        noise: relative standard deviation of each reading [-].
        discrepancy: first guess of each relation's own error [-]; 0.02 by default, re-estimated at every iteration.
        iterations: of the latent states.
        inflate: divide the information by the number of points that err alike (`correlation_inflation`).
        floors: least error believed of a relation [-], by name; `FLOOR` for the others.

    Returns:
        The estimate; `converged` tells whether to trust it.
    """
    chosen = tuple(rows or model.rows)
    keep = np.array([name in chosen for name in model.rows])
    mean, std = np.array([c.mean for c in coefficients]), np.array([c.std for c in coefficients])
    low, high = np.array([c.low for c in coefficients]), np.array([c.high for c in coefficients])
    values = dict(start)
    theta = np.clip(np.array([values.get(c.name, c.mean) for c in coefficients]), low, high)
    values.update({c.name: float(t) for c, t in zip(coefficients, theta, strict=True)})
    measured = points.states()
    sigma = reading_noise(measured, noise)
    x = points.states_filled()
    S = np.array([(discrepancy or {}).get(name, 0.02) for name in model.rows])
    least = np.array([(floors or {}).get(name, FLOOR) for name in model.rows])
    inflation, change, solution = 1.0, np.inf, None
    P = len(coefficients)
    for iteration in range(iterations):
        linear = _linearised(model, points, x, measured, values, sigma, S, keep)
        plain = linear.whitened(model.relations(points, x, values).residual[0])
        scale = np.sqrt(1.0 / np.sqrt(1.0 + (plain / ROBUST) ** 2) / inflation)  # soft_l1 by reweighting: readings
        # are robust, beliefs are not (a robust prior would let go of what it is there to hold)

        def whitened(columns: Mapping[str, float | Array], linear: _Linear = linear, scale: Array = scale,
                     x: Array = x) -> Array:
            r = linear.shifted(model.relations(points, x, {**values, **columns}).residual)
            return (linear.whiten @ np.clip(r, -FAR, FAR)[..., None])[..., 0] * scale

        def with_slopes(z: Array, whitened=whitened) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
            shifts = np.concatenate([np.zeros((1, P)), np.eye(P)]) * COEFFICIENT_STEP
            lanes = (z + shifts) * std + mean
            columns = {c.name: lanes[:, i] for i, c in enumerate(coefficients)}
            all_lanes = whitened(columns).reshape(P + 1, -1)
            r, J = all_lanes[0], ((all_lanes[1:] - all_lanes[0]) / COEFFICIENT_STEP).T
            return np.concatenate([r, z]), np.vstack([J, np.eye(P)])

        at = _WithSlopes(with_slopes)
        z_low, z_high = (low - mean) / std, (high - mean) / std
        z = np.clip((theta - mean) / std, z_low + 1e-9, z_high - 1e-9)
        solution = least_squares(at.residual, z, at.slopes, bounds=(z_low, z_high), x_scale=1.0, xtol=STEP, ftol=STEP,
                                 max_nfev=FIRST_STEPS if iteration == 0 else MORE_STEPS)
        change = float(np.max(np.abs(solution.x - z))) if P else 0.0
        theta = solution.x * std + mean
        values.update({c.name: float(t) for c, t in zip(coefficients, theta, strict=True)})
        x = _reconciled(model, points, x, measured, values, linear, sigma)
        before, S = S, np.maximum(_discrepancy(model, points, x, values, S, linear), least)
        if change < SETTLED and iteration >= 3 and np.all(np.abs(S - before) < SETTLED_ERRORS * before):
            break
        if inflate and iteration >= 2:
            inflation = correlation_inflation(points, linear.whitened(model.relations(points, x, values).residual[0]))
    linear = _linearised(model, points, x, measured, values, sigma, S, keep)
    residual = linear.whitened(model.relations(points, x, values).residual[0])
    # with what normalises it: a wide error of the relation would make any coefficients cheap
    robust = ROBUST**2 * float(np.sum(np.sqrt(1.0 + (residual / ROBUST) ** 2) - 1.0))
    normaliser = float(np.sum(np.log(np.einsum("nii->ni", linear.whiten))))
    cost = robust - normaliser + 0.5 * float(np.sum(((theta - mean) / std) ** 2))
    J = solution.jac if solution is not None else np.zeros((1, P))
    information = J.T @ J + 1e-12 * np.eye(P)
    covariance = np.linalg.pinv(information) * np.outer(std, std)
    return Estimate(tuple(coefficients), theta, covariance, x, S, residual, cost, inflation, change < 0.1)


def _linearised(model: SteadyModel, points: SteadyPoints, x: Array, measured: Array, values: Mapping[str, float],
                sigma: Array, S: Array, keep: NDArray[np.bool_]) -> _Linear:  # fmt: skip
    J = state_jacobian(model, points, x, values) * keep[:, None]
    known = np.isfinite(measured)
    variance = np.where(known, sigma**2, UNKNOWN**2)
    dx = np.where(known, np.log(np.where(known, measured, 1.0) / np.where(known, x, 1.0)), 0.0)
    C = _carried(J, variance) + np.diag(S**2)
    extra = np.array([name in ("T_im", "T_c", "p_es", "p_bc") for name in model.rows])
    C = C + np.diag(np.where(extra, 0.01**2, 0.0))
    whiten = np.linalg.inv(np.linalg.cholesky(C))
    return _Linear(whiten, np.einsum("nij,nj->ni", J, dx), J, C, keep)


def _reconciled(model: SteadyModel, points: SteadyPoints, x: Array, measured: Array, values: Mapping[str, float],
                linear: _Linear, sigma: Array) -> Array:  # fmt: skip
    r = linear.shifted(model.relations(points, x, values).residual[0])
    weighted = np.linalg.solve(linear.covariance, r[..., None])[..., 0]
    known = np.isfinite(measured)
    variance = np.where(known, sigma**2, UNKNOWN**2)
    step = -variance * np.einsum("nij,ni->nj", linear.jacobian, weighted)
    target = np.log(np.where(known, measured, x)) + step
    return np.exp(np.log(x) + np.clip(target - np.log(x), -LARGEST_SHIFT, LARGEST_SHIFT))


def _discrepancy(model: SteadyModel, points: SteadyPoints, x: Array, values: Mapping[str, float], S: Array,
                 linear: _Linear) -> Array:  # fmt: skip
    """The error of each relation itself: the reconciled residual's spread, its own share of it undone."""
    r = model.relations(points, x, values).residual[0]
    spread = MAD_TO_STD * np.nanmedian(np.abs(r), axis=0)
    share = np.median(np.einsum("nii->ni", np.linalg.inv(linear.covariance)), axis=0) * S**2  # of S in the total, 0..1
    fresh = np.clip(spread / np.sqrt(np.clip(share, 0.05, 1.0)), FLOOR, 0.3)
    return np.where(linear.keep, np.sqrt(0.5 * S**2 + 0.5 * fresh**2), S)


def correlation_inflation(points: SteadyPoints, residual: Array) -> float:
    """(1 + rho)/(1 - rho) of neighbouring points' residuals [-], from 1 to 10: map errors are smooth, not noise."""
    place = np.stack([_unit(points["n_e_rpm"]), _unit(points["u_delta_mg"])], axis=1)
    distance = np.sum((place[:, None] - place[None]) ** 2, axis=-1)
    np.fill_diagonal(distance, np.inf)
    nearest = np.argmin(distance, axis=1)
    bounded = np.clip(residual, -3.0, 3.0)
    power = np.mean(bounded**2)
    rho = float(np.mean(bounded * bounded[nearest]) / power) if power > 0 else 0.0
    return float(np.clip((1.0 + max(rho, 0.0)) / (1.0 - min(max(rho, 0.0), 0.82)), 1.0, 10.0))


def _unit(values: Array) -> Array:
    spread = float(np.std(values))
    return (values - np.mean(values)) / spread if spread > 0 else np.zeros_like(values)


def log_student(x: Array) -> Array:
    """Logarithm of Student's density with `DEGREES` degrees of freedom (scipy.stats takes half a second to import)."""
    level = gammaln(0.5 * (DEGREES + 1.0)) - gammaln(0.5 * DEGREES) - 0.5 * np.log(np.pi * DEGREES)
    return np.asarray(level - 0.5 * (DEGREES + 1.0) * np.log1p(x**2 / DEGREES))


def log_density(model: SteadyModel, points: SteadyPoints, values: Mapping[str, float], errors: Array) -> Array:
    """Log-density of the balances of each point, (n,).

    The noise of one reading is in several balances, and what is added to a model changes by how much: residuals are
    whitened by what readings and balances are off by before they are judged.

    Args:
        errors: (R,) of the balances themselves, one standard deviation [-].
    """
    known, x = np.isfinite(points.states()), points.states_filled()
    r = np.clip(np.nan_to_num(model.relations(points, x, values).residual[0]), -FAR, FAR)
    sigma = np.where(known, reading_noise(x), UNKNOWN)
    root = np.linalg.cholesky(reading_covariance(model, points, x, values, sigma) + np.diag(errors**2))
    white = np.linalg.solve(root, r[..., None])[..., 0]
    return np.asarray(np.sum(log_student(white) - np.log(np.einsum("nii->ni", root)), axis=1))
