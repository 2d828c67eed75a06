"""An epoch of the hybrid PINN in C against the eager one: gradients of all columns, frozen layers, whole trainings."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from segments import PAPER
from torch import Tensor

from dieseltwin.engine import actuate, we2011
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.paper.loop_settings import Stage
from dieseltwin.paper.loops import pinn_training as pinn
from dieseltwin.paper.loops.c_library import BLOCK
from dieseltwin.paper.loops.compiled_loss import Place
from dieseltwin.paper.loops.few_shot_program import make_program
from dieseltwin.paper.loops.network_loops import epoch_function
from dieseltwin.paper.loops.pinn_networks import StateNetworks

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
STAGES = (
    Stage(until_epoch=6, layers="all", rate_networks=1e-2, rate_unknowns=1e-2, rate_weights=1e-2),
    Stage(until_epoch=12, layers="last", rate_networks=1e-2, rate_unknowns=1e-2, rate_weights=0.0),
)


@pytest.fixture(scope="module", params=[31, 151], ids=["less than a block", "two blocks that overlap"])
def problem(request: pytest.FixtureRequest, simulated: Callable[..., SegmentProblem], drive: Callable[..., Any]) -> Any:
    return simulated(drive(300, request.param), we2011.FIELD, noise_seed=1)


def made(problem: SegmentProblem, dtype: torch.dtype) -> tuple[Any, StateNetworks, Tensor]:
    settings = pinn.settings_of(PAPER, "baseline")
    lanes = pinn.make_lanes([problem], [0], 3, 5, PAPER.start)
    actuations = {0: actuate(problem.inputs, problem.parameters)}
    program = make_program(lanes, actuations, None, None, None, settings, dtype)
    networks = StateNetworks(problem.time_s, dtype=dtype)
    return program, networks, pinn.start_values(lanes, program, networks, settings)


def gradients(problem: SegmentProblem, dtype: torch.dtype, compiled: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Losses, gradients of all columns, and the terms of the losses."""
    program, networks, values = made(problem, dtype)
    gradient = torch.zeros_like(values)
    place = Place.within(values, gradient, networks.size, program)
    total = epoch_function(program, networks, (values, gradient), place, 1, compiled)(False, True)
    return total, gradient, place.terms


def test_compiled_equals_eager_and_32_bits_are_safe(problem: SegmentProblem) -> None:
    double, eager = (gradients(problem, torch.float64, compiled) for compiled in (True, False))
    torch.testing.assert_close(double[0], eager[0], rtol=1e-11, atol=0.0)
    torch.testing.assert_close(double[2], eager[2], rtol=1e-9, atol=0.0)
    size = StateNetworks(problem.time_s).size
    single = gradients(problem, torch.float32, True) if len(problem.time_s) > BLOCK else None  # a program each
    for columns in (slice(0, size), slice(size, size + 4), slice(size + 4, None)):
        expected = eager[1][:, columns]
        assert float((double[1][:, columns] - expected).norm() / expected.norm()) < 1e-11
        assert single is None or float((single[1][:, columns].double() - expected).norm() / expected.norm()) < 5e-6


@pytest.mark.thorough
def test_training_repeats_and_equals_the_eager_one(problem: SegmentProblem) -> None:
    ends = []
    for compiled in (True, True, False):
        program, networks, values = made(problem, torch.float64)
        pinn.train(program, networks, values, STAGES, np.stack([problem.sigma[:5]] * 3), compiled=compiled)
        ends.append(values)
    assert torch.equal(ends[0], ends[1])
    torch.testing.assert_close(ends[0], ends[2], rtol=1e-6, atol=1e-8)
