"""Robust weighted least squares of a map: Student's t by reweighting, priors of the coefficients."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREEDOM = 4.0  # of Student's t: tip-ins and gear changes are outliers


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
