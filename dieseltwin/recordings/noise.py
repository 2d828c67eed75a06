"""Noise of each channel, from the data alone (docs/discovery.md): never from a model's residuals.

Where a message has no number below the lowest reading (a bus without negative flows, boost that is counted from zero),
noise is cut off on one side: with the EGR valve shut readings lie 0.4 standard deviations too high on average.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from dieseltwin.arrays import Array, robust_std
from dieseltwin.recordings.held import number_step, rows_between_readings

SETTLED_NOISE: Mapping[str, float] = {
    "p_im_pa": 0.005, "p_em_pa": 0.005, "omega_t_rad_s": 0.005, "w_c_kg_s": 0.01, "w_egr_kg_s": 0.02, "t_em_k": 0.01,
}  # fmt: skip
"""Relative standard deviation of a settled point's reading on a test bed, if none is given [-]."""

_FLAT = 0.5  # of the middle reading: below, a sensor's error no longer falls with what it reads

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
STEP_TO_STD = 12.0**-0.5  # of the error of rounding to a step, which is uniform

_FEWEST_CUT, _SHARE_CUT = 10, 0.005  # readings at the very lowest number, and of all readings
_OVER_NEXT = 2.0  # times the readings at the next number: noise that isn't cut off thins out towards its end
_LEAST_SCATTER = 0.2  # of the readings at the lowest number; a shut valve without noise has fewer just above it
_REACH = 3.0  # standard deviations of the noise, from which next to nothing is cut off
_BESIDE = 3  # readings on either side, whose medians say how high the channel is: not the reading itself, which is cut


def flat_below(readings: Array) -> Array:
    """Size of readings (n, C) below which their error no longer falls with it, (C,): at settled points. Where most are
    exactly nothing, as the flow of a shut valve may be, it is that of the others; 0 where all are."""
    size = np.abs(readings)
    middle = np.nanmedian(size, axis=0)
    for j in np.flatnonzero(middle == 0.0):
        middle[j] = np.median(size[size[:, j] > 0.0, j]) if np.any(size[:, j] > 0.0) else 0.0
    return np.asarray(_FLAT * middle)


@dataclass(frozen=True)
class CutOff:
    """Noise that is cut off at the lowest number of a channel.

    Attributes:
        lowest: that number [unit of the channel].
        sigma: standard deviation of the noise where it isn't cut off [unit of the channel].
        near: (n,) rows so near to it that some of their noise is lost.
    """

    lowest: float
    sigma: float
    near: NDArray[np.bool_]

    def expected(self, values: Array) -> Array:
        """Mean readings where the channel is at `values`: that of a Gaussian whose lower end is put at `lowest`."""
        z = (values - self.lowest) / self.sigma
        return np.asarray(self.lowest + self.sigma * (z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)))


@dataclass(frozen=True)
class Noise:
    """Stationary AR(1) noise per channel, or of each reading where it isn't the same in all.

    Attributes:
        sigma: (C,) or (n, C) standard deviation [unit of the channel].
        rho: (C,) or (n, C) correlation of neighbouring samples [-].
    """

    sigma: Array
    rho: Array

    @property
    def overall(self) -> Noise:
        """(C,) of each: the root of the mean variance of all readings, and the mean correlation."""
        if self.sigma.ndim == 1:
            return self
        known = np.isfinite(self.sigma)
        count = np.maximum(known.sum(axis=0), 1)
        square, rho = (np.where(known, of, 0.0).sum(axis=0) / count for of in (self.sigma**2, self.rho))
        return Noise(np.where(known.any(axis=0), np.sqrt(square), np.nan), rho)


def white_sigma(values: Array) -> float:
    """Robust standard deviation of the noise of readings (n,) from row to row, by second differences: a slope leaves
    none; NaN of fewer than three."""
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    second = second[np.isfinite(second)]
    if second.size < 3:
        return float("nan")
    return float(robust_std(second) / np.sqrt(6.0))


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
    rho, signal = np.linspace(0.0, _LARGEST_RHO, 91), omega**-4.0
    noise = 1.0 / (1.0 + rho[:, None] ** 2 - 2.0 * rho[:, None] * np.cos(omega))
    a, b = noise / power, np.broadcast_to(signal / power, noise.shape)  # relative errors are alike at all frequencies
    gram = np.stack([a, b], axis=1) @ np.stack([a, b], axis=2)
    sums = np.stack([a.sum(axis=1), b.sum(axis=1)], axis=1)
    share, rest = np.linalg.solve(gram * (1.0 + 1e-9 * np.eye(2)), sums[..., None])[..., 0].T
    alone = clean | (rest < 0.0)
    share, rest = np.where(alone, sums[:, 0] / gram[:, 0, 0], share), np.where(alone, 0.0, rest)
    possible = share > 0.0
    if not possible.any():
        return 0.0, float(power[-1])
    rho, noise, share, rest = rho[possible], noise[possible], share[possible], rest[possible]
    misfit = np.log(power / (share[:, None] * noise + rest[:, None] * signal))
    best = int(np.argmin((misfit**2).sum(axis=1) / _SPECTRUM_ERROR**2 + (rho / _USUAL_RHO) ** 2))
    level = np.exp(np.log(power / noise[best]).mean()) if clean else share[best]
    return float(rho[best]), float(_MEDIAN_BIAS * level)


def cut_off(values: Array) -> CutOff | None:
    """Whether and where the noise of a channel is cut off at its lowest number; None where it isn't.

    A channel that rests at its lowest number without scattering above it has no noise there that could be lost.

    Args:
        values: (n,) one column, NaN where missing.
    """
    rows = np.flatnonzero(np.isfinite(values))
    numbers, counts = np.unique(values[rows], return_counts=True)
    if numbers.size < 2 or counts[0] < max(_FEWEST_CUT, _SHARE_CUT * rows.size, _OVER_NEXT * counts[1]):
        return None
    readings = np.pad(values[rows], _BESIDE, mode="edge")
    least = np.lib.stride_tricks.sliding_window_view(readings, 2 * _BESIDE + 1).min(axis=1)
    away = np.full(values.size, np.nan)
    away[rows] = np.where(least > numbers[0], values[rows], np.nan)
    sigma = _noise_of(away, np.array([], dtype=int), None)[0]
    reach = numbers[0] + _REACH * sigma
    if not np.count_nonzero((values[rows] > numbers[0]) & (values[rows] < reach)) >= _LEAST_SCATTER * counts[0]:
        return None
    beside = np.median(np.lib.stride_tricks.sliding_window_view(readings, _BESIDE), axis=1)
    near = np.zeros(values.size, dtype=bool)
    near[rows] = np.minimum(beside[: rows.size], beside[_BESIDE + 1 :]) < reach
    return CutOff(float(numbers[0]), sigma, near)


def cut_offs(measured: Array) -> dict[int, CutOff]:
    """Those columns of readings (n, C) whose noise is cut off, by their number."""
    return {j: cut for j, values in enumerate(measured.T) if (cut := cut_off(values)) is not None}


def estimate_noise(measured: Array, breaks: np.ndarray | None = None, *, explained: Array | None = None) -> Noise:
    """Standard deviation and AR(1) correlation of each channel from the upper part of its spectrum.

    A channel that is read in every second row or less often is judged by its own readings, one after another; they are
    taken as uncorrelated. Where rows are few, noise counts as white before a model explains the signal, and behind it
    as more correlated than it shows by the error of that estimate: taken for white, it would make an offset of a sensor
    out of chance. No noise is believed smaller than what rounding to the channel's own step leaves. Readings whose
    noise is cut off don't count.

    Args:
        measured: (n, C) readings, NaN where missing.
        breaks: first rows of pieces that don't continue the one before.
        explained: (n, C) a model's readings, or None. Only what is faster than `_LOWEST_EXPLAINED` is used of the
            difference: a model that lacks physics errs slowly, and correlation can't be told from the raw signal
            (its standard deviation is 0.14 from second differences of 3,000 rows).

    Returns:
        Noise; sigma is NaN for a channel without readings.
    """
    breaks = np.array([], dtype=int) if breaks is None else breaks
    sigma, rho = np.empty(measured.shape[1]), np.zeros(measured.shape[1])
    cut = cut_offs(measured)
    for j, values in enumerate(measured.T):
        kept = np.where(cut[j].near, np.nan, values) if j in cut else values
        sigma[j], rho[j] = _noise_of(kept, breaks, None if explained is None else explained[:, j])
    sigma = np.fmax(sigma, [STEP_TO_STD * number_step(values) or np.nan for values in measured.T])
    return Noise(sigma, rho)


def _noise_of(values: Array, breaks: np.ndarray, explained: Array | None) -> tuple[float, float]:
    """Standard deviation and correlation of one column (n,), as `estimate_noise` says."""
    rest = values if explained is None else values - explained
    slow = rows_between_readings(rest) > 1.0
    sigma, rho = white_sigma(rest[np.isfinite(rest)] if slow else rest), 0.0
    few = values.size < _ROWS_FOR_RHO
    if slow or (few and explained is None):
        return sigma, rho
    lowest = _LOWEST if explained is None else _LOWEST_EXPLAINED
    spectrum = _high_frequency_spectrum(_bridged(rest), breaks, lowest)
    if spectrum is not None and sigma > 0.0:
        rho, innovation = _fit_spectrum(*spectrum, clean=explained is not None)
        sigma = float(np.sqrt(innovation / (1.0 - rho**2)))
        if few:
            rho = min(rho + _RHO_ERROR_OF_FEW, _LARGEST_RHO)
    elif few:  # second differences of correlated noise are smaller
        rho = _USUAL_RHO
        sigma *= float(np.sqrt(3.0 / (3.0 - 4.0 * _USUAL_RHO + _USUAL_RHO**2)))
    return sigma, rho
