"""Smooth maps as cubic B-splines: a tensor product over two arguments, or a sum over two arguments."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline

from dieseltwin.arrays import Array
from dieseltwin.inner import kernel

DEGREE = 3
FREEDOM = 4.0  # of Student's t: tip-ins and gear changes are outliers
STRAIGHT = 1.0  # steps of the knots that a map is believed to go straight on beyond them, within what it may bend
BEND = 0.3  # standard deviation of a map's second differences: a wavy eta_vol (cam phasing) needs as much [-]


def spline_basis(x: Array, knots: Array) -> Array:
    """Cubic B-spline basis (n, len(knots) + 2) over `knots` (ascending); beyond them a straight line for STRAIGHT of
    their steps, then its end's value."""
    inside = np.clip(x, knots[0], knots[-1] - 1e-9 * (knots[-1] - knots[0]))
    basis = np.asarray(_splines(tuple(knots))(inside))
    further = DEGREE * np.clip(beyond(x, knots), -STRAIGHT, STRAIGHT)  # times the difference of the last coefficients
    if further.any():
        low, high = np.minimum(further, 0.0), np.maximum(further, 0.0)
        basis[:, :2] += np.stack([-low, low], axis=1)
        basis[:, -2:] += np.stack([-high, high], axis=1)
    return basis


@lru_cache(maxsize=16)
def _splines(knots: tuple[float, ...]) -> BSpline:
    """All of a basis at once; `BSpline.design_matrix` goes by a sparse matrix and takes three times as long."""
    padded = np.array([knots[0]] * DEGREE + list(knots) + [knots[-1]] * DEGREE)
    return BSpline(padded, np.eye(len(knots) + DEGREE - 1), DEGREE)


def beyond(x: Array, knots: Array) -> Array:
    """(n,) distance beyond the first (negative) or last of `knots`, 0 between them [their steps]."""
    low = np.minimum(x - knots[0], 0.0) / (knots[1] - knots[0])
    return np.asarray(low + np.maximum(x - knots[-1], 0.0) / (knots[-1] - knots[-2]))


def tensor_basis(x: Array, y: Array, knots_x: Array, knots_y: Array) -> Array:
    """Tensor product basis (n, nx*ny) of two cubic splines."""
    a, b = spline_basis(x, knots_x), spline_basis(y, knots_y)
    return (a[:, :, None] * b[:, None, :]).reshape(len(x), -1)


def tensor_value(x: Array, y: Array, knots_x: Array, knots_y: Array, theta: Array) -> Array:
    """(n,) value of a tensor product spline with coefficients theta (nx*ny,), without its basis."""
    a, b = spline_basis(x, knots_x), spline_basis(y, knots_y)
    return np.asarray(((a @ theta.reshape(a.shape[1], -1)) * b).sum(axis=1))


def sum_basis(x: Array, y: Array, knots_x: Array, knots_y: Array) -> Array:
    """Basis (n, nx + ny) of a sum of two cubic splines."""
    return np.hstack([spline_basis(x, knots_x), spline_basis(y, knots_y)])


def roughness(size: int) -> Array:
    """Penalty matrix of second differences (size, size) (Eilers and Marx 1996)."""
    second = np.diff(np.eye(size), 2, axis=0)
    return np.asarray(second.T @ second)


def tensor_roughness(size_x: int, size_y: int) -> Array:
    """Second-difference penalty of a tensor product, both directions alike."""
    return np.kron(roughness(size_x), np.eye(size_y)) + np.kron(np.eye(size_x), roughness(size_y))


def sum_roughness(size_x: int, size_y: int) -> Array:
    """Second-difference penalty of a sum of two splines."""
    both = np.zeros((size_x + size_y, size_x + size_y))
    both[:size_x, :size_x], both[size_x:, size_x:] = roughness(size_x), roughness(size_y)
    return both


@kernel()  # type: ignore[untyped-decorator]
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
