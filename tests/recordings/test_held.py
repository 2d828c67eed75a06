"""A slow channel in a quick table counts at its own readings, and its noise is theirs."""

from __future__ import annotations

import numpy as np
import pytest

from dieseltwin.recordings.held import between_readings, number_step, own_readings, rows_between_readings
from dieseltwin.recordings.noise import estimate_noise

N = 3000
FEW = 350
TIME_S = 0.2 * np.arange(N)
SIGMA = 3.0


@pytest.fixture(scope="module")
def signal() -> np.ndarray:
    """Slow driving with noise of 3, at 5 Hz."""
    rng = np.random.default_rng(4)
    knots = rng.uniform(100.0, 300.0, 61)
    return np.interp(TIME_S, 10.0 * np.arange(knots.size), knots) + SIGMA * rng.standard_normal(N)


def _held(signal: np.ndarray, rate_hz: float, step: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The last reading of a channel at `rate_hz` in every row, rounded to `step`; rows of the readings."""
    read = np.searchsorted(TIME_S, np.floor(TIME_S * rate_hz + 1e-9) / rate_hz + 1e-9, side="right") - 1
    values = signal[read]
    return (np.round(values / step) * step if step else values), np.unique(read)


@pytest.mark.parametrize(("rate_hz", "step"), [(1.0, 0.0), (1.0, 2.0), (2.0, 0.0), (2.0, 2.0), (2.5, 0.0), (0.5, 0.0)])
def test_readings_are_told_from_repetitions(signal: np.ndarray, rate_hz: float, step: float) -> None:
    values, read = _held(signal, rate_hz, step)
    found = own_readings(values)
    assert found is not None
    assert found.sum() == pytest.approx(read.size, abs=2)
    changes = 1 + np.flatnonzero(np.diff(values))
    assert found[changes].all()
    assert np.isin(np.flatnonzero(found), np.concatenate([read - 1, read, read + 1])).all()


@pytest.mark.parametrize("step", [0.0, 0.1, 2.0, 10.0])
def test_a_channel_that_is_read_in_every_row_is_not_held(signal: np.ndarray, step: float) -> None:
    assert own_readings(np.round(signal / step) * step if step else signal) is None


def test_a_value_that_moves_seldom_is_not_held() -> None:
    rng = np.random.default_rng(2)
    ambient = 290.0 + np.round(np.cumsum(0.02 * rng.standard_normal(N)))
    assert own_readings(ambient) is None


def test_missing_rows_stay_missing(signal: np.ndarray) -> None:
    values, _ = _held(signal, 1.0)
    values[500:600] = np.nan
    found = own_readings(values)
    assert found is not None and not found[500:600].any() and found.mean() == pytest.approx(0.193, abs=0.003)


def test_lines_between_readings(signal: np.ndarray) -> None:
    sparse = np.where(np.arange(N) % 5 == 0, np.arange(N) * 1.0, np.nan)
    sparse[1000:1200] = np.nan
    assert rows_between_readings(sparse) == 5.0
    filled = between_readings(sparse)
    np.testing.assert_allclose(filled[:996], np.arange(996.0))
    assert np.isnan(filled[1000:1200]).all()
    assert between_readings(signal) is signal


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_noise_of_a_slow_channel_is_that_of_its_readings(signal: np.ndarray, step: float) -> None:
    values, _ = _held(signal, 1.0, step)
    masked = np.where(own_readings(values), values, np.nan)
    found = estimate_noise(masked[:, None])
    # Driving moves between readings a second apart, so that the raw readings give a little more than their noise.
    assert SIGMA < found.sigma[0] < 2.0 * SIGMA and found.rho[0] == 0.0
    explained = np.convolve(signal, np.ones(15) / 15, mode="same")
    assert estimate_noise(masked[:, None], explained=explained[:, None]).sigma[0] == pytest.approx(SIGMA, rel=0.15)


def test_no_noise_is_smaller_than_the_rounding() -> None:
    smooth = 100.0 + 50.0 * np.sin(TIME_S / 20.0)
    rounded = np.round(smooth / 2.0) * 2.0
    assert number_step(rounded) == 2.0
    assert estimate_noise(rounded[:, None]).sigma[0] == pytest.approx(2.0 / np.sqrt(12.0))
    assert number_step(np.full(5, 3.0)) == 0.0
    # What a conversion of units leaves behind the comma is no step.
    assert number_step(np.array([101.3, 101.4, 101.5]) * 1000.0) == pytest.approx(100.0)
    assert number_step(np.array([1.0, 2.0, 2.0 + 1e-12, 3.0])) == pytest.approx(1.0)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_noise_of_few_rows_is_never_taken_for_whiter_than_usual(rho: float) -> None:
    """A slow error counts by the noise's power at low frequencies, a factor of three off were it taken for white."""
    rng = np.random.default_rng(5)
    shares = []
    for _ in range(20):
        white = rng.standard_normal(FEW)
        values = np.empty(FEW)
        values[0] = white[0]
        for i in range(1, FEW):
            values[i] = rho * values[i - 1] + np.sqrt(1.0 - rho**2) * white[i]
        noise = estimate_noise(values[:, None], explained=np.zeros((FEW, 1)))
        power = noise.sigma[0] ** 2 * (1.0 + noise.rho[0]) / (1.0 - noise.rho[0])
        shares.append(power * (1.0 - rho) / (1.0 + rho))
    assert np.median(shares) > 0.9 and np.quantile(shares, 0.1) > 0.6 and np.median(shares) < 2.5
