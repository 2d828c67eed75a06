"""What a gain is worth where no model reaches the noise: a likelihood with unknown size and correlation of the misfit.

A twin of a real machine never explains a recording down to its sensor noise. Chi-square gains then are huge for all,
and the largest model always wins. So the size of the misfit counts as unknown (profile likelihood), and as many
readings are counted as are independent in it. Where a model does reach the noise, both give the ordinary gain.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.twins.interface import Array


def independent(residual: Array, starts: np.ndarray, states: int) -> float:
    """Number of independent readings in a misfit (n, C): half of all pairs of neighbours change sign in white noise."""
    crossings = 0
    for column in np.asarray(residual).T:
        kept = column[np.isfinite(column)]
        crossings += int(np.sum(np.signbit(kept[1:]) != np.signbit(kept[:-1])))
    return float(np.clip(2 * crossings, len(starts) * (states + 1), np.isfinite(residual).sum()))
