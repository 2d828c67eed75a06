"""Short simulated segments that the identification tests share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import HEALTH, MEASURED, EngineParameters, Inputs, simulate, we2011
from dieseltwin.identification.problem import NoiseLevels, SegmentProblem
from dieseltwin.settings.params import load_params

REFERENCE = Path(__file__).parent / "reference" / "field_random_300s.csv"
INPUTS = ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
PAPER = load_params(None, "paper").identify
"""Settings of the estimators as in the paper."""
STATES = ["p_im_pa", "p_em_pa", "omega_t_rad_s", "x_r", "t_1_k"]


def make_problem(
    inputs: Inputs, truth: EngineParameters, *, noise_seed: int | None = 0, t0_s: float = 0.0
) -> SegmentProblem:
    """Simulate a segment with `truth`; the problem starts at the laboratory values. No noise without a
    seed."""
    frame = simulate(inputs, truth, oxygen=False)
    clean = frame[list(MEASURED)].to_numpy()
    noise = NoiseLevels.from_signals(clean)
    measured = clean.copy()
    if noise_seed is not None:
        measured += np.random.default_rng(noise_seed).standard_normal(clean.shape) * noise.sigma
    measured[:, MEASURED.index("w_c_kg_s")] = np.nan
    return SegmentProblem(
        t0_s=t0_s + float(inputs.segment_time_s[0]),
        t1_s=t0_s + float(inputs.segment_time_s[-1]),
        inputs=inputs,
        measured=measured,
        sigma=noise.sigma,
        parameters=we2011.PARAMETERS,
        true_initial=frame[STATES].to_numpy()[0],
        truth={name: getattr(truth, name) for name in HEALTH},
    )


def driving(first: int, rows: int, shift_s: float = 0.0) -> Inputs:
    """A piece of the reference driving with 2 s of history where there is any."""
    trace = pd.read_csv(REFERENCE, usecols=list(INPUTS))
    history = min(10, first)
    part = trace.iloc[first - history : first + rows]
    columns = [part[name].to_numpy() for name in INPUTS]
    return Inputs(columns[0] + shift_s, *columns[1:], n_history=history).clipped(we2011.PARAMETERS)


def idle(rows: int = 151, u_egr_pct: float = 0.0) -> Inputs:
    """Idle with some movement of the VGT and the EGR valve at a fixed position."""
    time = 0.2 * np.arange(rows)
    return Inputs(
        time,
        610.0 + 5.0 * np.sin(0.3 * time),
        np.full(rows, 9.0),
        np.full(rows, u_egr_pct),
        45.0 + 10.0 * np.sin(0.5 * time),
    )


@pytest.fixture(scope="session")
def problem() -> SegmentProblem:
    """Thirty seconds of driving with field parameters and noise."""
    return make_problem(driving(300, 151), we2011.FIELD)


@pytest.fixture(scope="session")
def idle_problem() -> SegmentProblem:
    """Idle with the EGR valve shut."""
    return make_problem(idle(), we2011.FIELD)


@pytest.fixture(scope="session")
def simulated() -> Callable[..., SegmentProblem]:
    """The function `make_problem`."""
    return make_problem


@pytest.fixture(scope="session")
def drive() -> Callable[..., Inputs]:
    """The function `driving`."""
    return driving
