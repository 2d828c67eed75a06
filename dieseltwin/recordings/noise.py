"""Noise of each channel, from the data alone (docs/discovery.md): never from a model's residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dieseltwin.recordings.held import number_step, rows_between_readings

Array = NDArray[np.float64]

_MEDIAN_BIAS = 1.01  # of a logarithm of medians over about 90 overlapping blocks, measured on 20 draws at three rho
_LARGEST_RHO = 0.9
_BLOCK = 64  # samples of one periodogram
_LOWEST = 0.3  # of the Nyquist frequency: below, the signal itself moves
_SPECTRUM_ERROR = 0.25  # of the logarithm of one frequency's power, neighbours being correlated
_USUAL_RHO = 0.35  # loggers smooth a little; strong correlation must show clearly
_LOWEST_EXPLAINED = 0.1  # of the Nyquist frequency, where a model has explained the signal
_ROWS_FOR_RHO = 512  # fewer rows can't tell little correlation from none
_RHO_ERROR_OF_FEW = 0.13  # standard deviation of the estimate from 350 rows, 40 draws at three rho
_LONGEST_BRIDGE = 4  # samples
_STEP_TO_STD = 12.0**-0.5  # of the error of rounding to a step, which is uniform
_MAD_TO_STD = 1.482602218505602  # of a Gaussian


@dataclass(frozen=True)
class Noise:
    """Stationary AR(1) noise per channel.

    Attributes:
        sigma: (C,) standard deviation [unit of the channel].
        rho: (C,) correlation of neighbouring samples [-].
    """

    sigma: Array
    rho: Array


def _white_sigma(values: Array) -> float:
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    second = second[np.isfinite(second)]
    if second.size < 3:
        return float("nan")
    return float(_MAD_TO_STD * np.median(np.abs(second - np.median(second))) / np.sqrt(6.0))


def _bridged(values: Array) -> Array:
    """Holes of a few samples closed by straight lines; longer ones stay."""
    missing = ~np.isfinite(values)
    if not missing.any() or missing.all():
        return values
    at = np.arange(values.size)
    out = np.where(missing, np.interp(at, at[~missing], values[~missing]), values)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a > _LONGEST_BRIDGE:
            out[a:b] = np.nan
    return out


def _high_frequency_spectrum(values: Array, breaks: np.ndarray, lowest: float) -> tuple[Array, Array] | None:
    """Frequencies [rad/sample] and the median spectrum over half-overlapping blocks; None without enough of them.

    Differences are analysed and the difference's own gain divided out: the slow signal doesn't leak then. The median
    over blocks ignores those in which the signal jumps.
    """
    difference = np.diff(values)
    for at in breaks:
        if 0 < at <= difference.size:
            difference[at - 1] = np.nan
    taper = np.hanning(_BLOCK)
    blocks = [
        difference[a : a + _BLOCK]
        for a in range(0, difference.size - _BLOCK + 1, _BLOCK // 2)
        if np.isfinite(difference[a : a + _BLOCK]).all()
    ]
    if len(blocks) < 8:
        return None
    power = np.abs(np.fft.rfft(np.asarray(blocks) * taper, axis=1)) ** 2 / (taper**2).sum()
    omega = 2.0 * np.pi * np.arange(power.shape[1]) / _BLOCK
    keep = omega >= lowest * np.pi
    gain = 2.0 - 2.0 * np.cos(omega[keep])
    return omega[keep], np.median(power[:, keep], axis=0) / np.log(2.0) / gain


def _fit_spectrum(omega: Array, power: Array, clean: bool) -> tuple[float, float]:
    """Correlation and innovation variance of AR(1) noise beside what is left of the signal, falling as omega**-4."""
    signal = omega**-4.0
    best, found = np.inf, (0.0, float(power[-1]))
    for rho in np.linspace(0.0, _LARGEST_RHO, 91):
        noise = 1.0 / (1.0 + rho**2 - 2.0 * rho * np.cos(omega))
        a, b = noise / power, signal / power  # relative errors are alike at all frequencies
        gram = np.array([[a @ a, a @ b], [a @ b, b @ b]])
        share, rest = np.linalg.solve(gram + 1e-9 * np.diag(np.diag(gram)), [a.sum(), b.sum()])
        if clean or rest < 0.0:
            share, rest = a.sum() / (a @ a), 0.0
        if share <= 0.0:
            continue
        misfit = np.log(power / (share * noise + rest * signal))
        score = float(misfit @ misfit) / _SPECTRUM_ERROR**2 + (rho / _USUAL_RHO) ** 2
        if score < best:
            level = float(np.exp(np.log(power / noise).mean())) if clean else float(share)
            best, found = score, (float(rho), _MEDIAN_BIAS * level)
    return found


def estimate_noise(
    measured: Array, breaks: np.ndarray | None = None, floor: Array | None = None, *, explained: Array | None = None
) -> Noise:
    """Standard deviation and AR(1) correlation of each channel from the upper part of its spectrum.

    A channel that is read in every second row or less often is judged by its own readings, one after another; they are
    taken as uncorrelated. Where rows are few, noise counts as white before a model explains the signal, and behind it
    as more correlated than it shows by the error of that estimate: taken for white, it would make an offset of a sensor
    out of chance. No noise is believed smaller than what rounding to the channel's own step leaves.

    Args:
        measured: (n, C) readings, NaN where missing.
        breaks: first rows of pieces that don't continue the one before.
        floor: (C,) smallest believed sigma.
        explained: (n, C) a model's readings, or None. Only what is faster than `_LOWEST_EXPLAINED` is used of the
            difference: a model that lacks physics errs slowly, and correlation can't be told from the raw signal
            (its standard deviation is 0.14 from second differences of 3,000 rows).

    Returns:
        Noise; sigma is NaN for a channel without readings.
    """
    sigma, rho = np.empty(measured.shape[1]), np.zeros(measured.shape[1])
    breaks = np.array([], dtype=int) if breaks is None else breaks
    lowest = _LOWEST if explained is None else _LOWEST_EXPLAINED
    rest = measured if explained is None else measured - explained
    for j, values in enumerate(rest.T):
        slow = rows_between_readings(values) > 1.0
        sigma[j] = _white_sigma(values[np.isfinite(values)] if slow else values)
        few = values.size < _ROWS_FOR_RHO
        if slow or (few and explained is None):
            continue
        spectrum = _high_frequency_spectrum(_bridged(values), breaks, lowest)
        if spectrum is not None and sigma[j] > 0.0:
            rho[j], innovation = _fit_spectrum(*spectrum, clean=explained is not None)
            sigma[j] = np.sqrt(innovation / (1.0 - rho[j] ** 2))
            if few:
                rho[j] = min(rho[j] + _RHO_ERROR_OF_FEW, _LARGEST_RHO)
        elif few:  # second differences of correlated noise are smaller
            rho[j] = _USUAL_RHO
            sigma[j] *= np.sqrt(3.0 / (3.0 - 4.0 * _USUAL_RHO + _USUAL_RHO**2))
    sigma = np.fmax(sigma, [_STEP_TO_STD * number_step(values) or np.nan for values in measured.T])
    if floor is not None:
        sigma = np.fmax(sigma, floor)
    return Noise(sigma, rho)
