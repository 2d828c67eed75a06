"""What nearly every module handles: an array of numbers of double precision, and a robust measure of its scatter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAD_TO_STD = 1.482602218505602
"""Standard deviation over median absolute deviation, of a Gaussian: scatter that few far readings don't set."""


def robust_std(values: Array, axis: int | None = None) -> Array:
    """Standard deviation [unit of values] from the median distance to the median, of all values or along an axis."""
    middle = np.median(values, axis=axis, keepdims=True)
    return np.asarray(MAD_TO_STD * np.median(np.abs(values - middle), axis=axis))
