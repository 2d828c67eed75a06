"""The error of one cell of the paper's tables: one parameter in one minute, over runs."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def cell_rmse(ratios: NDArray[np.float64]) -> float:
    """sqrt((mean - 1)^2 + std^2) of estimates over the truth (R,) [-]; one run has no spread, NaN without any.

    The deviation is that of a sample, by R - 1.
    """
    if not len(ratios):
        return math.nan
    spread = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else 0.0
    return math.hypot(float(np.mean(ratios)) - 1.0, spread)
