"""What nearly every module handles: an array of numbers of double precision, and robust measures of their scatter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAD_TO_STD = 1.482602218505602
"""Standard deviation over median absolute deviation, of a Gaussian: scatter that few far readings don't set."""

_MOST, _ROUNDS = 2.5, 50  # standard deviations, from which on a value counts as one there; rounds of a fixed point
_WITHIN = math.erf(_MOST / math.sqrt(2.0))
_KEPT = _WITHIN - _MOST * math.sqrt(2.0 / math.pi) * math.exp(-0.5 * _MOST**2) + _MOST**2 * (1.0 - _WITHIN)


def robust_std(values: Array, axis: int | None = None) -> Array:
    """Standard deviation [unit of values] from the median distance to the median, of all values or along an axis."""
    middle = np.median(values, axis=axis, keepdims=True)
    return np.asarray(MAD_TO_STD * np.median(np.abs(values - middle), axis=axis))


def rms_of_most(values: Array, own: Array, known: float) -> float:
    """Size of Gaussian values that is 1 as far as is known, few far ones setting nothing (Huber 1981, proposal 2).

    Args:
        values: (n,) residuals behind a fit.
        own: (n,) share of the variance of each that the fit left it, above 0.
        known: number of values that tell as much of the size as is known before.
    """
    squared, size = values**2 / own, 1.0
    for _ in range(_ROUNDS):
        counted = np.minimum(squared, _MOST**2 * size) / _KEPT
        size = float((known + own @ counted) / (known + own.sum()))
    return size**0.5
