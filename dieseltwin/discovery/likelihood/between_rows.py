"""What the inputs may have done between slow rows, as covariance of the readings, and the noise beside it."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from dieseltwin.discovery.likelihood.circumstances import clock_scatter
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.twins.interface import Array, Lanes, Twin
from dieseltwin.discovery.twins.offers import Offer
from dieseltwin.recordings.noise import Noise

_MEDIAN_CHI2 = 0.4549364231195724  # of one degree of freedom
_LEAST = 0.05  # of the noise that is seen: below, what the inputs may have done explains it all
_HALVINGS = 40

_FREEDOM = 4.0  # of Student's distribution of a window's errors: tails as heavy as a fourth moment allows
_FACTORS = np.geomspace(1.0, 25.0, 33)  # of a window's variance; beyond, something else happens
_MOST_BEYOND = 1.0 / 3.0  # of the windows; with more, it is the engine that isn't understood


@runtime_checkable
class WithOpenInputs(Offer, Protocol):
    """A twin whose inputs may have moved between the rows."""

    def covariance_between_rows(self, lanes: Lanes) -> tuple[Array, ...]:
        """Covariance (r C, r C) of the readings of each window of r rows about one lane; none where rows are fast."""
        ...


@runtime_checkable
class WithInputsToOpen(Offer, Protocol):
    """A twin of a recording whose rows are fast enough where an engine is driven calmly."""

    def with_inputs_between_rows(self) -> Twin | None:
        """The twin whose inputs may have moved between the rows; None where they may already, or surely didn't."""
        ...


def scatter_about(twin: Twin, lanes: Lanes) -> ModelScatter:
    """What the readings scatter by about one lane: clocks that were put right, and inputs between slow rows."""
    return ModelScatter(clock_scatter(twin, lanes), windows_between_rows(twin, lanes))


def windows_between_rows(twin: Twin, lanes: Lanes) -> tuple[Array, ...]:
    """`WithOpenInputs.covariance_between_rows`, none of a twin without it."""
    return twin.covariance_between_rows(lanes) if isinstance(twin, WithOpenInputs) else ()


def noise_beside(noise: Noise, residual: Array, starts: np.ndarray, windows: tuple[Array, ...]) -> Noise:
    """The noise that sensors have beside what inputs between the rows do: white, of rows that lie far apart.

    Second differences of a residual hold both. Of the noise that makes the median of their squares, in shares of what
    is expected of each, that of one Gaussian, none is believed larger than without the inputs.

    Args:
        noise: as the residual shows it.
        residual: (n, C) readings less a simulation, NaN where missing.
        starts: (W,) first sample of each window.
        windows: their covariances; none leaves the noise as it is.
    """
    if not windows:
        return noise
    channels = residual.shape[1]
    seen: list[list[Array]] = [[] for _ in range(channels)]
    expected: list[list[Array]] = [[] for _ in range(channels)]
    for start, covariance in zip(starts, windows, strict=True):
        size = len(covariance) // channels
        if size < 3:
            continue
        second = np.diff(np.eye(size), 2, axis=0)
        for j in range(channels):
            own = covariance[j::channels, j::channels]
            seen[j].append((second @ residual[start : start + size, j]) ** 2)
            expected[j].append(np.einsum("ik,kl,il->i", second, own, second))
    sigma = noise.sigma.copy()
    for j, (squares, variances) in enumerate(zip(seen, expected, strict=True)):
        if not squares:
            continue
        square, variance = np.concatenate(squares), np.concatenate(variances)
        there = np.isfinite(square)
        if there.any():
            sigma[j] = _smallest(square[there], variance[there], float(sigma[j]))
    return Noise(sigma, np.zeros_like(noise.rho))


def widened(at: Linearisation, noise: Noise, scatter: ModelScatter) -> tuple[ModelScatter, np.ndarray]:
    """Inputs that erred more in some windows than their channels let expect, by what a fit leaves there.

    The paths of inputs have heavy tails: between two rows a pedal is kicked and let go. So the variance of a window is
    multiplied by the likeliest factor; a priori the errors are Student's, and none is believed smaller than said.

    Args:
        at: fit of health alone; noise: of the sensors; scatter: as it was there.

    Returns:
        The scatter with these factors, and (W,) windows in which no believable factor is enough, at most a third of
        all: rows as slow as these don't tell what happened there.
    """
    residual = at.without_nuisances(np.nan_to_num(at.residual))
    apart = Whitening.of(at.twin.measured, noise, at.twin.starts, replace(scatter, windows=(), bent=()))
    left = apart.apply(residual[None])[0]
    prior = (_FREEDOM + 2.0) * np.log(_FACTORS) + _FREEDOM / _FACTORS
    chosen = []
    whitened = apart.whitened(at.twin.starts, scatter.windows)
    for block, spread in whitened:
        sizes, directions = np.linalg.eigh(spread)
        variance = 1.0 + _FACTORS[:, None] * np.maximum(sizes, 0.0)
        cost = (np.log(variance) + (directions.T @ left[block]) ** 2 / variance).sum(axis=1)
        chosen.append(int(np.argmin(cost + prior)))
    beyond = np.array(chosen) == _FACTORS.size - 1
    windows = tuple(  # as they are where nothing is added: those of ten minutes at 10 Hz take 170 MiB
        _FACTORS[k] * covariance if k else covariance for k, covariance in zip(chosen, scatter.windows, strict=True)
    )
    return replace(scatter, windows=windows), beyond & (beyond.mean() <= _MOST_BEYOND)


def _smallest(square: Array, variance: Array, seen: float) -> float:
    """Standard deviation with which squares of second differences have the median that their variances ask for."""
    low, high = _LEAST * seen, seen
    for _ in range(_HALVINGS):
        middle = np.sqrt(low * high)
        if np.median(square / (6.0 * middle**2 + variance)) > _MEDIAN_CHI2:
            low = middle
        else:
            high = middle
    return float(np.sqrt(low * high))
