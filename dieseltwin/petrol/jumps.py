"""By how much the misfit of a second is off those of the seconds about it."""

from __future__ import annotations

import warnings

import numpy as np

from dieseltwin.arrays import Array, robust_std

NEIGHBOURS = 7  # blocks
OUTLIER = 4.0  # scales off its neighbours before and after: a tip-in, whatever the hypothesis


def with_jumps(scales: Array, left: Array) -> Array:
    """Scales (n, C) of misfits (n, C), larger where these jump and infinite where one stands alone."""
    out = scales.copy()
    for j in range(out.shape[1]):
        known = np.flatnonzero(np.isfinite(out[:, j]))
        if not known.size:  # its reading stands still all the time, or all of its driving is beyond the learned
            continue
        values = left[known, j]
        lone = _off_both_sides(values) > OUTLIER * out[known, j]
        out[known, j] = np.where(lone, np.inf, np.fmax(out[known, j], _local_spread(values)))
    return out


def _local_spread(values: Array) -> Array:
    """Robust standard deviation among NEIGHBOURS values about each: seconds in which a balance jumps weigh less."""
    half = NEIGHBOURS // 2
    some = np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="edge"), NEIGHBOURS)
    return robust_std(some, axis=1)


def _off_both_sides(values: Array) -> Array:
    """Lesser distance of each value from the medians of the NEIGHBOURS before and after it: small at a step."""
    none = np.full(NEIGHBOURS, np.nan)
    some = np.lib.stride_tricks.sliding_window_view(np.concatenate([none, values, none]), NEIGHBOURS)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the ends have neighbours on one side alone
        medians = np.nanmedian(some, axis=1)
    before, after = np.abs(values - medians[: len(values)]), np.abs(values - medians[NEIGHBOURS + 1 :])
    return np.asarray(np.fmin(before, after))
