"""Noise of several recordings of one engine: each has its own."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dieseltwin.discovery.likelihood.noise import noise_of
from dieseltwin.discovery.search.preparation import prepare
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.several import Occasion, SeveralTwin
from dieseltwin.engine import we2011
from dieseltwin.recordings.noise import estimate_noise
from dieseltwin.recordings.reader import recording
from dieseltwin.settings.defaults import default_search
from tests.api.simulated import NOISE, drive

SECONDS = 160.0


def _louder(seed: int, times: float) -> pd.DataFrame:
    """A drive whose sensors are so many times as noisy as those of others."""
    table, rng = drive(SECONDS, seed=seed), np.random.default_rng(seed + 100)
    for name, sigma in NOISE.items():
        table[name] += np.sqrt(times**2 - 1.0) * sigma * rng.standard_normal(len(table))
    return table


@pytest.fixture(scope="module")
def twin() -> SeveralTwin:
    parts = [EngineTwin(recording(_louder(k, times)), we2011.PARAMETERS) for k, times in ((1, 1.0), (2, 1.6))]
    return SeveralTwin(parts, [Occasion(0.0, 298.0), Occasion(30.0, 298.0)])


def test_every_recording_has_its_own_noise(twin: SeveralTwin):
    """One noise for all left 1.4 of chi-square a reading in the louder recording and 0.6 in the quieter."""
    noise = noise_of(twin)
    assert noise.sigma.shape == noise.rho.shape == twin.measured.shape
    for part, rows in zip(twin.parts, twin.rows, strict=True):
        alone = estimate_noise(part.measured)
        assert np.array_equal(noise.sigma[rows], np.tile(alone.sigma, (rows.stop - rows.start, 1)))
        assert np.array_equal(noise.rho[rows], np.tile(alone.rho, (rows.stop - rows.start, 1)))
    first, second = (noise.sigma[rows][0] for rows in twin.rows)
    assert np.all(second > 1.3 * first)
    both = noise.overall
    assert both.sigma.shape == (len(twin.channels),) and np.all((first < both.sigma) & (both.sigma < second))
    assert noise_of(twin.parts[0]).sigma.shape == (len(twin.channels),)


def test_what_recordings_of_a_healthy_engine_leave_is_alike(twin: SeveralTwin):
    found = prepare(twin, default_search().driving)
    rows = found.null.metric.project(np.nan_to_num(found.null.residual)[None])[0][: twin.measured.size]
    squares = (rows**2).reshape(twin.measured.shape)
    left = [squares[part].sum() / found.whitening.present[part].sum() for part in twin.rows]
    assert all(0.85 < share < 1.15 for share in left)
    assert found.noise.sigma.shape == twin.measured.shape
