"""Compiled parts of the objective: output transform, residuals with their curvature at each point, weighted columns.

Arrays are (runs, row, points): a run's rows lie together, and neighbouring points fill the vector registers.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.engine import HEALTH, MEASURED
from dieseltwin.engine._compiled import _OPTIONS
from dieseltwin.engine._fastmath import fast_exp, fast_log
from dieseltwin.inner import kernel

N_STATES, N_CHANNELS, N_HEALTH = 3, len(MEASURED), len(HEALTH)
N_READ = N_CHANNELS - N_STATES
N_ROWS = max(N_STATES, N_READ)  # of equations, and of readings beside them
PATH_ROWS = 12
"""Rows of a trajectory: three states, their rates, slopes and bends (`heads.Trajectory`)."""
ZZ, DZ, DD, ZP, DP = 0, 9, 18, 21, 33
CURVATURE_ROWS = 45
"""Rows of the curvature of a point in linear outputs z, their rates dz and the log-parameters p: z with z (3 x 3), dz
with z (3 x 3), dz with itself (3), z with p (3 x 4), dz with p (3 x 4)."""


@kernel(**_OPTIONS)
def transform(z, scale, path):  # type: ignore[no-untyped-def]
    """Linear outputs (R, 3, 2 n), values then rates, -> rows (R, 12, n) of the trajectory behind scale * softplus."""
    runs, n = z.shape[0], z.shape[2] // 2
    for r in range(runs):
        for j in range(N_STATES):
            for i in range(n):
                value, rate = z[r, j, i], z[r, j, n + i]
                small = fast_exp(-abs(value))
                share = 1.0 / (1.0 + small)
                slope = scale[j] * (share if value >= 0.0 else small * share)
                path[r, j, i] = scale[j] * (max(value, 0.0) + fast_log(1.0 + small))
                path[r, 3 + j, i] = slope * rate
                path[r, 6 + j, i] = slope
                path[r, 9 + j, i] = slope * (small * share if value >= 0.0 else share) * rate


@kernel(**_OPTIONS)
def residuals(rows, path, values, readings, weights, noise, rate_defect, reading_defect, dof, cost, physics, misfit):  # type: ignore[no-untyped-def]
    """Cost (K,), physics (K, 3, n) and data (K, C, n) residuals over their noise at K runs, those `rows` of the data.

    path (K, 12, n), values (K, C, n): rates, then readings that are not states; readings (R, C, n), weights (R, C, n),
    noise (R, 3, n), rate_defect (R, 3, n), reading_defect (R, C, n); dof of the physics residuals' Student tails.
    """
    n = path.shape[2]
    for k in range(rows.shape[0]):
        r = rows[k]
        total = 0.0
        for j in range(N_STATES):
            for i in range(n):
                v = (path[k, 3 + j, i] - values[k, j, i] - rate_defect[r, j, i]) / noise[r, j, i]
                physics[k, j, i] = v
                total += 0.5 * (v * v if np.isinf(dof) else (dof + 1.0) * np.log1p(v * v / dof))  # nan stays nan
        for j in range(N_CHANNELS):
            for i in range(n):
                at = path[k, j, i] if j < N_STATES else values[k, j, i]
                v = (at + reading_defect[r, j, i] - readings[r, j, i]) * weights[r, j, i]
                misfit[k, j, i] = v
                total += 0.5 * v * v
        cost[k] = total if np.isfinite(total) else np.inf


@kernel(**_OPTIONS)
def curvature(rows, path, slopes, weights, noise, dof, physics, misfit, gradient, by_health, points, corner):  # type: ignore[no-untyped-def]
    """Gauss-Newton curvature and gradient of each point; tails of the physics residuals enter as weights.

    slopes (K, C, 7, n): derivatives of `values` by states and log-parameters; others as in `residuals`. -> gradient
    (K, 3, 2 n) by z and dz, by_health (K, 4), points (K, 45, n), corner (K, 4, 4): log-parameters among each other.
    """
    n = path.shape[2]
    equation = np.zeros((N_ROWS, N_STATES + N_HEALTH))  # of a physics residual: by z, by log-parameters
    reading = np.zeros((N_ROWS, N_STATES + N_HEALTH))
    state, inertia, pulled, read = np.empty(N_STATES), np.empty(N_STATES), np.zeros(N_ROWS), np.zeros(N_ROWS)
    for k in range(rows.shape[0]):
        r = rows[k]
        by_health[k], corner[k] = 0.0, 0.0
        for i in range(n):
            for j in range(N_STATES):
                v = physics[k, j, i]
                pull = 1.0 if np.isinf(dof) else np.sqrt((dof + 1.0) / (dof + v * v))
                over = pull / noise[r, j, i]
                inertia[j] = over * path[k, 6 + j, i]
                pulled[j] = pull * v
                state[j] = weights[r, j, i] * path[k, 6 + j, i]
                for m in range(N_STATES):
                    equation[j, m] = -over * slopes[k, j, m, i] * path[k, 6 + m, i]
                for m in range(N_STATES, N_STATES + N_HEALTH):
                    equation[j, m] = -over * slopes[k, j, m, i]
                equation[j, j] += over * path[k, 9 + j, i]
            for j in range(N_READ):
                w, read[j] = weights[r, N_STATES + j, i], misfit[k, N_STATES + j, i]
                for m in range(N_STATES):
                    reading[j, m] = w * slopes[k, N_STATES + j, m, i] * path[k, 6 + m, i]
                for m in range(N_STATES, N_STATES + N_HEALTH):
                    reading[j, m] = w * slopes[k, N_STATES + j, m, i]
            for j in range(N_STATES):
                g = state[j] * misfit[k, j, i]
                for e in range(N_ROWS):
                    g += equation[e, j] * pulled[e] + reading[e, j] * read[e]
                for m in range(N_STATES):
                    points[k, DZ + 3 * j + m, i] = inertia[j] * equation[j, m]
                    s = state[j] * state[j] if m == j else 0.0
                    for e in range(N_ROWS):
                        s += equation[e, j] * equation[e, m] + reading[e, j] * reading[e, m]
                    points[k, ZZ + 3 * j + m, i] = s
                gradient[k, j, i] = g
                gradient[k, j, n + i] = inertia[j] * pulled[j]
                points[k, DD + j, i] = inertia[j] * inertia[j]
                for m in range(N_HEALTH):
                    at = N_STATES + m
                    s = 0.0
                    for e in range(N_ROWS):
                        s += equation[e, j] * equation[e, at] + reading[e, j] * reading[e, at]
                    points[k, ZP + 4 * j + m, i] = s
                    points[k, DP + 4 * j + m, i] = inertia[j] * equation[j, at]
            for m in range(N_HEALTH):
                for e in range(N_ROWS):
                    a, b = equation[e, N_STATES + m], reading[e, N_STATES + m]
                    by_health[k, m] += a * pulled[e] + b * read[e]
                    for o in range(N_HEALTH):
                        corner[k, m, o] += a * equation[e, N_STATES + o] + b * reading[e, N_STATES + o]


@kernel(**_OPTIONS)
def weighted_columns(points, j, first, second, third, own, others):  # type: ignore[no-untyped-def]
    """What the Hessian's rows of state j are products of.

    points (45, n) of one run; first, second, third (2 n, K): columns of the states, and below them their rates. -> own
    (2 n, K_j), whose square own' own is the block of j with itself, and others (2 n, columns of the later states and of
    the log-parameters), with which the columns of j are multiplied.
    """
    n = points.shape[1]
    at = 0
    for k in range(j, N_STATES):
        both = first if k == 0 else second if k == 1 else third
        width = both.shape[1]
        for i in range(n):
            zz, zd, dz = points[ZZ + 3 * j + k, i], points[DZ + 3 * k + j, i], points[DZ + 3 * j + k, i]
            if k == j:  # zz z z + 2 dz z dz + dd dz dz = (inertia dz + share z)^2 + rest z z
                inertia = np.sqrt(points[DD + j, i])
                share = dz / inertia
                rest = np.sqrt(max(zz - share * share, 0.0))
                for q in range(width):
                    own[i, q] = inertia * both[n + i, q] + share * both[i, q]
                    own[n + i, q] = rest * both[i, q]
            else:
                for q in range(width):
                    others[i, at + q] = zz * both[i, q] + zd * both[n + i, q]
                    others[n + i, at + q] = dz * both[i, q]
        if k > j:
            at += width
    for i in range(n):
        for m in range(N_HEALTH):
            others[i, at + m] = points[ZP + 4 * j + m, i]
            others[n + i, at + m] = points[DP + 4 * j + m, i]
