"""Inputs between slow rows: what they do to the readings; a leak is named, and a healthy engine isn't accused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal

import dieseltwin as dt
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.discovery.likelihood.between_rows import noise_beside
from dieseltwin.discovery.likelihood.fit import first_fit
from dieseltwin.discovery.likelihood.metric import ModelScatter, Whitening
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.engine import MEASURED, we2011
from dieseltwin.recordings.between_rows import BRIDGE, NODES, unseen, with_nodes
from dieseltwin.recordings.noise import Noise
from dieseltwin.recordings.reader import recording

NOISE = (0.03, 0.03, 0.01, 0.05, 0.03, 0.03)
INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")


def driven(seconds: float, effects: dict[str, float] | None = None) -> pd.DataFrame:
    """A drive at 5 Hz without noise."""
    drive = draw_driving("random", seconds, we2011.PARAMETERS.model_dump(), np.random.default_rng(11))
    inputs = pd.DataFrame(drive.columns())
    simulated = dt.simulate(inputs, effects=effects or {}).table()
    return pd.concat([inputs[["time_s", *INPUTS]], simulated[list(MEASURED)]], axis=1)


def once_a_second(fine: pd.DataFrame) -> pd.DataFrame:
    """Every fifth row with the paper's noise."""
    rows, rng = fine.iloc[::5].reset_index(drop=True), np.random.default_rng(12)
    for column, share in zip(MEASURED, NOISE, strict=True):
        rows[column] += share * rows[column].mean() * rng.standard_normal(len(rows))
    return rows


def test_the_readings_scatter_as_inputs_between_the_rows_let_them() -> None:
    rows = driven(70.0).iloc[::5].reset_index(drop=True)
    twin = EngineTwin(recording({name: rows[name].to_numpy() for name in rows}), we2011.PARAMETERS)
    windows = twin.covariance_between_rows(first_fit(twin).lanes())
    assert len(windows) == twin.starts.size
    first = int(twin.starts[1])
    said = np.sqrt(np.diag(windows[0]).reshape(first, -1))
    # the same by drawing paths between the rows, with the published simulator
    rng, fine_s = np.random.default_rng(13), with_nodes(rows.time_s.to_numpy())
    straight = {"time_s": fine_s, **{name: np.interp(fine_s, rows.time_s, rows[name]) for name in INPUTS}}
    mixed = np.linalg.cholesky(BRIDGE)
    upto = slice(0, (NODES + 1) * first + 1)

    def shown(inputs: dict[str, np.ndarray]) -> np.ndarray:
        some = pd.DataFrame({name: values[upto] for name, values in inputs.items()})
        return dt.simulate(some).table()[list(MEASURED)].to_numpy()[:: NODES + 1][:first]

    base, draws = shown(straight), []
    for _ in range(60):
        moved = {"time_s": fine_s}
        for name in INPUTS:
            path = straight[name].copy()
            steps = unseen(rows[name].to_numpy())[:, None] * (rng.standard_normal((len(rows) - 1, NODES)) @ mixed.T)
            for node in range(NODES):
                path[node + 1 :: NODES + 1] += steps[:, node]
            moved[name] = path
        draws.append(shown(moved) - base)
    seen = np.std(draws, axis=0)
    for j in (0, 1, 2, 5):
        assert np.linalg.norm(said[2:, j]) == pytest.approx(np.linalg.norm(seen[2:, j]), rel=0.35), MEASURED[j]


def test_fast_rows_leave_nothing_open() -> None:
    rows = driven(70.0)
    twin = EngineTwin(recording({name: rows[name].to_numpy() for name in rows}), we2011.PARAMETERS)
    assert twin.covariance_between_rows(first_fit(twin).lanes()) == ()


def test_whitening_with_the_covariance_of_windows_is_the_gaussian_density() -> None:
    rng = np.random.default_rng(3)
    starts, noise = np.array([0, 4]), Noise(np.array([0.5, 2.0]), np.array([0.4, 0.0]))
    measured = rng.standard_normal((9, 2))
    measured[5, 1] = np.nan
    factors = [rng.standard_normal((size * 2, 3)) for size in (4, 5)]
    windows = tuple(factor @ factor.T for factor in factors)
    whitening = Whitening.of(measured, noise, starts, ModelScatter(None, windows))
    whitened = whitening.apply(measured[None])[0]
    found = -0.5 * whitened @ whitened - whitening.log_normaliser(whitening.present)
    dense = np.zeros((18, 18))
    for at, covariance in zip((0, 8), windows, strict=True):
        dense[at : at + len(covariance), at : at + len(covariance)] = covariance
    for i in range(9):
        for k in range(9):
            if (i < 4) == (k < 4):
                dense[2 * i, 2 * k] += 0.25 * 0.4 ** abs(i - k)
        dense[2 * i + 1, 2 * i + 1] += 4.0
    there = np.isfinite(measured).reshape(-1)
    seen = dense[np.ix_(there, there)]
    expected = multivariate_normal(np.zeros(len(seen)), seen).logpdf(measured.reshape(-1)[there])
    assert found == pytest.approx(expected, rel=1e-9)


def test_noise_is_told_from_what_the_inputs_do() -> None:
    rng, starts = np.random.default_rng(4), np.arange(0, 600, 10)
    factors = [np.diag(rng.exponential(2.0, 10)) for _ in starts]
    residual = np.concatenate([factor @ rng.standard_normal(10) for factor in factors])[:, None]
    residual = residual + 0.7 * rng.standard_normal(residual.shape)
    found = noise_beside(Noise(np.array([2.0]), np.array([0.3])), residual, starts, tuple(f @ f.T for f in factors))
    assert found.sigma[0] == pytest.approx(0.7, rel=0.2) and found.rho[0] == 0.0


@pytest.mark.thorough
def test_a_leak_is_named_from_rows_of_a_second_and_a_healthy_engine_raises_no_alarm() -> None:
    healthy = dt.discover(once_a_second(driven(200.0))).document
    assert not healthy.mismatch
    leaking = dt.discover(once_a_second(driven(200.0, {"boost_leak": 3e-5}))).document
    (leak,) = leaking.effects
    assert leak.name == "boost_leak" and abs(leak.magnitude - 3e-5) < 3.0 * leak.std
    assert 4e-6 < leaking.minimum_detectable["boost_leak"] < 2e-5
