"""A recording whose circumstances are known is put right: clocks, fuel's scale, ambient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import we2011
from dieseltwin.recordings.circumstances import applicable, put_right
from dieseltwin.recordings.reader import Recording, recording

N = 200
TIME_S = 0.2 * np.arange(N)


def _signal(time_s: np.ndarray) -> np.ndarray:
    return 1500.0 + 20.0 * time_s


@pytest.fixture
def source() -> Recording:
    """Steady rise of everything; engine speed and exhaust pressure late, without ambient columns."""
    steady = {name: np.full(N, value) for name, value in (
        ("u_delta_mg", 100.0), ("u_egr_pct", 20.0), ("u_vgt_pct", 60.0), ("p_im_pa", 1.5e5), ("omega_t_rad_s", 6e3),
        ("w_egr_kg_s", 0.02), ("t_em_k", 800.0),
    )}  # fmt: skip
    late = {"n_e_rpm": 0.5 * _signal(TIME_S - 0.3), "p_em_pa": 100.0 * _signal(TIME_S - 0.4)}
    return recording(pd.DataFrame({"time_s": TIME_S, **steady, **late}))


def test_clocks_are_put_right(source: Recording) -> None:
    right, engine = put_right(
        source, we2011.PARAMETERS, {"time_shift:n_e_rpm": 0.3, "time_shift:p_em_pa": 0.4, "scale:u_delta_mg": 1.02}
    )
    assert engine == we2011.PARAMETERS
    np.testing.assert_allclose(right.columns["n_e_rpm"][:-2], 0.5 * _signal(TIME_S)[:-2], rtol=1e-12)
    np.testing.assert_allclose(right.columns["p_em_pa"][:-2], 100.0 * _signal(TIME_S)[:-2], rtol=1e-12)
    assert np.isnan(right.columns["p_em_pa"][-2:]).all()  # nobody read them
    np.testing.assert_allclose(right.columns["u_delta_mg"], 102.0)
    assert np.isfinite(source.columns["p_em_pa"]).all()


def test_a_clock_does_not_move_where_the_engine_runs(source: Recording) -> None:
    speed = source.columns["n_e_rpm"].copy()
    speed[[50, 51, 120]] = 100.0  # three readings say that it stood
    stood = replace(source, columns={**source.columns, "n_e_rpm": speed})
    right, _ = put_right(stood, we2011.PARAMETERS, {"time_shift:n_e_rpm": 0.3, "time_shift:u_delta_mg": -0.5})
    assert right.pieces() == stood.pieces() and len(right.pieces()) == 3


def test_the_ambient_is_the_one_that_is_known(source: Recording) -> None:
    assert source.p_amb_pa == we2011.PARAMETERS.p_amb
    right, engine = put_right(source, we2011.PARAMETERS, {"p_amb_pa": 93e3, "t_amb_k": 285.0, "t_im_k": 310.0})
    assert (right.p_amb_pa, right.t_amb_k, engine.T_im) == (93e3, 285.0, 310.0)


def test_sensors_move_by_whole_rows(source: Recording) -> None:
    """Between rows their noise would be averaged."""
    assert applicable(source, "time_shift:p_em_pa", 0.29) == pytest.approx(0.2)
    assert applicable(source, "time_shift:n_e_rpm", 0.29) == 0.29
    assert applicable(source, "drift:p_amb_pa", 500.0) == 0.0
