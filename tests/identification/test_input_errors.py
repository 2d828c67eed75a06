"""Inputs between slow rows and a coarse ambient pressure count in the intervals, and fast rows leave nothing open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, we2011
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.input_errors import input_errors
from dieseltwin.identification.problem import SegmentProblem, problems_from_recording
from dieseltwin.identification.shooting import exact_engine
from dieseltwin.recordings.reader import recording

Make = Callable[..., SegmentProblem]
Drive = Callable[..., Inputs]


def slow(fast: SegmentProblem, every: int) -> SegmentProblem:
    """Every so manieth row of a segment, from its first one on."""
    rows = fast.inputs
    columns = {name: values[rows.n_history :: every] for name, values in rows.columns.items()}
    inputs = Inputs(rows.segment_time_s[::every], **columns)
    return replace(fast, inputs=inputs, measured=fast.measured[::every])


def test_fast_rows_leave_nothing_open_and_slow_ones_widen_the_intervals(simulated: Make, drive: Drive) -> None:
    fast = simulated(drive(300, 301), we2011.FIELD)
    about = np.log(np.concatenate([we2011.FIELD.health(), fast.true_initial[:3]]))
    assert input_errors(fast, exact_engine, about).shape == (0, 301, 6)
    second = slow(fast, 5)
    moved = input_errors(second, exact_engine, about)
    assert moved.shape == (4 * 2 * 60, 61, 6) and not moved[0, 0].any() and moved[0, 1:21].any()
    found = identify_segments([second], "classical", 1, 0, config=PAPER).segments[0]
    assert (found.std[0] > 1.1 * found.bound).all()
    assert (np.abs(found.parameters[0] - we2011.FIELD.health()) < 2.5 * found.std[0]).all()


@pytest.mark.parametrize(("recorded_pa", "std_pa"), [(101000.0, 1000.0 / 12**0.5), (99500.0, 500.0 / 12**0.5),
                                                     (101300.0, 0.0), (101111.34, 0.0)])  # fmt: skip
def test_steps_of_the_ambient_pressure_are_read_from_its_numbers(
    simulated: Make, drive: Drive, recorded_pa: float, std_pa: float
) -> None:
    fast = simulated(drive(300, 301), we2011.FIELD)
    names = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k")
    rows = slice(fast.inputs.n_history, None)
    frame = {"time_s": fast.time_s, **{name: values[rows] for name, values in fast.inputs.columns.items()},
             **dict(zip(names, fast.measured.T, strict=False)), "p_amb_pa": np.full(301, recorded_pa)}  # fmt: skip
    problems = problems_from_recording(recording(frame), we2011.PARAMETERS)
    assert problems[0].p_amb_std_pa == pytest.approx(std_pa)


def test_a_coarse_ambient_widens_the_pooled_interval_and_moves_nothing(simulated: Make, drive: Drive) -> None:
    exact = [simulated(drive(first, 151), we2011.FIELD, noise_seed=first) for first in (300, 600)]
    off = [replace(p, parameters=p.parameters.replace(p_amb=p.parameters.p_amb - 111.0)) for p in exact]
    before = identify_segments(off, "classical", 1, 0, config=PAPER)
    after = identify_segments([replace(p, p_amb_std_pa=144.0) for p in off], "classical", 1, 0, config=PAPER)
    right = identify_segments(exact, "classical", 1, 0, config=PAPER).pooled()
    for name in HEALTH:
        one, other = before.pooled()[name], after.pooled()[name]
        assert other.mean == pytest.approx(one.mean, rel=1e-9) and other.std >= one.std
        shared = np.sqrt(other.std**2 - one.std**2)  # two segments have it in common: it doesn't average out
        assert shared == pytest.approx(144.0 / 111.0 * abs(one.mean - right[name].mean), rel=0.25, abs=0.02 * one.std)
