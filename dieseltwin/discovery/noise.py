"""Noise of each channel, from differences of the data alone (DISCOVERY.md, step 0): never from a model's residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dieseltwin.discovery.twin import Array

_MAD_TO_STD = 1.482602218505602  # of a Gaussian
_LARGEST_RHO = 0.9
_ROWS_FOR_RHO = 200  # fewer rows can't tell correlation from chance; the noise is then taken as white


@dataclass(frozen=True)
class Noise:
    """Stationary AR(1) noise per channel.

    Attributes:
        sigma: (C,) standard deviation [unit of the channel].
        rho: (C,) correlation of neighbouring samples [-].
    """

    sigma: Array
    rho: Array


def _robust_variance(values: Array) -> float:
    return float((_MAD_TO_STD * np.median(np.abs(values - np.median(values)))) ** 2)


def _second_difference_covariances(rho: Array) -> tuple[Array, Array]:
    """Variance of the second difference d, and of d_t + d_(t+1), for AR(1) noise of variance 1."""

    def gamma(lag: int) -> Array:
        return rho ** abs(lag)

    def of_difference(lag: int) -> Array:
        return (
            6.0 * gamma(lag) - 4.0 * (gamma(lag - 1) + gamma(lag + 1)) + gamma(lag - 2) + gamma(lag + 2)
        )

    variance = of_difference(0)
    return variance, 2.0 * (variance + of_difference(1))


def estimate_noise(measured: Array, starts: np.ndarray | None = None, floor: Array | None = None) -> Noise:
    """Standard deviation and AR(1) correlation of each channel.

    Second differences take the slow signal out; their robust variance, and that of sums of neighbours, are two
    equations for sigma and rho. The median ignores the transients, where the signal itself bends.

    Args:
        measured: (n, C) readings, NaN where missing.
        starts: first rows of pieces between which no difference is taken.
        floor: (C,) smallest believed sigma.
    """
    grid = np.linspace(0.0, _LARGEST_RHO, 181)
    variance, of_sums = _second_difference_covariances(grid)
    ratio_of = of_sums / variance  # increases with rho
    sigma, rho = np.empty(measured.shape[1]), np.zeros(measured.shape[1])
    for j, values in enumerate(measured.T):
        second = values[2:] - 2.0 * values[1:-1] + values[:-2]
        if starts is not None:
            for start in starts:
                second[max(start - 2, 0) : start] = np.nan
        sums = second[1:] + second[:-1]
        second, sums = second[np.isfinite(second)], sums[np.isfinite(sums)]
        if second.size < 3:
            sigma[j] = np.nan
            continue
        observed = _robust_variance(second)
        if second.size >= _ROWS_FOR_RHO and observed > 0.0:
            rho[j] = np.interp(_robust_variance(sums) / observed, ratio_of, grid)
        sigma[j] = np.sqrt(observed / np.interp(rho[j], grid, variance))
    if floor is not None:
        sigma = np.fmax(sigma, floor)
    return Noise(sigma, rho)
