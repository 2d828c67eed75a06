"""The compiled loop against the eager program, and what happens where nothing can be compiled."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from segments import PAPER
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from dieseltwin.engine import actuate, we2011
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.networks import MLP
from dieseltwin.paper.loops import c_library, compiled_loss, point_loops
from dieseltwin.paper.loops import few_shot_adam as fewshot_adam
from dieseltwin.paper.loops.compiled_loss import CompiledLoss, EagerLoss, Place, gradient_function
from dieseltwin.paper.loops.few_shot_program import METHOD, Lane, Program, draw_lane, make_program, start_values
from dieseltwin.paper.loops.losses import TERMS
from dieseltwin.surrogates.empirical import EmpiricalMaps, MapNetwork

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
CONFIG = PAPER.changed(METHOD, epochs=20, weights_until_epoch=10)
SETTINGS = CONFIG.of(METHOD)


@pytest.fixture(scope="module")
def lanes(simulated: Callable[..., SegmentProblem], drive: Callable[..., Any]) -> list[Lane]:
    problem = simulated(drive(300, 151), we2011.FIELD, noise_seed=1)
    return [draw_lane(problem, 0, run, 3, CONFIG.start, 0.1) for run in range(3)]


CENTRES = {
    "eta_vol": ((2e5, 1300.0), 0.9), "f_egr": ((30.0,), -1.0), "F_vgt_Pi_t": ((60.0, 0.7), 0.5),
    "eta_tm": ((5e3, 700.0, 0.7), 0.7), "eta_c": ((0.2, 1.8), 0.7), "Phi_c": ((290.0, 1.8, 5e3), -2.0),
}  # fmt: skip
"""Inputs about which an untrained map is centred, and its output there."""


@pytest.fixture(scope="module")
def maps() -> EmpiricalMaps:
    """Untrained maps with dropout near where trained ones are; one of the improved kind's form."""
    generator = torch.Generator().manual_seed(2)
    made = {}
    for name, (centre, output) in CENTRES.items():
        hidden, activation = ((9,), "algebraic") if name == "eta_vol" else ((7, 7), "tanh")
        network = MLP((len(centre), *hidden, 1), activation, 0.01, members=1, last_gain=0.1, generator=generator,
                      dtype=torch.float64)  # fmt: skip
        with torch.no_grad():
            network.biases[-1].fill_(output)
        free, at = np.full(len(centre), np.inf), np.array(centre)
        made[name] = MapNetwork(network, -free, free, at, 0.5 * at)
    return EmpiricalMaps("paper", made)


def _program(lanes: list[Lane], maps: EmpiricalMaps | None = None, dtype: torch.dtype = torch.float32) -> Program:
    actuations = {0: actuate(lanes[0].problem.inputs, lanes[0].problem.parameters)}
    return make_program(lanes, actuations, None, None, maps, SETTINGS, dtype)


def _case(
    lanes: list[Lane], maps: EmpiricalMaps | None = None, dtype: torch.dtype = torch.float32
) -> tuple[Program, Place]:
    program = _program(lanes, maps, dtype)
    values, _ = start_values(lanes, program, SETTINGS)
    heads = torch.split(values, [*program.widths(), values.shape[1] - sum(program.widths())], 1)
    place = Place.within(values, torch.zeros_like(values), sum(program.widths()), program)
    for target, h, columns in zip(place.z, heads, program.columns, strict=False):
        target.copy_(h @ columns)
    program.renew()
    return program, place


def _gradients(program: Program, place: Place, compiled: bool) -> list[Tensor]:
    total = gradient_function(program, place, 1, compiled)(True)
    return [v.clone() for v in (total, place.by_masked, *place.by_z, *place.by_weights, *place.terms.unbind(1))]


@needs_compiler
@pytest.mark.parametrize("learned", [False, True])
def test_compiled_equals_eager_and_32_bits_are_safe(lanes: list[Lane], maps: EmpiricalMaps, learned: bool) -> None:
    """To rounding; torch's softplus is the identity above 20, where e**-20 = 2e-9 is left out."""
    single, double, eager = (
        _gradients(*_case(lanes, maps if learned else None, dtype), compiled)
        for dtype, compiled in ((torch.float32, True), (torch.float64, True), (torch.float64, False))
    )
    gradients = len(eager) - len(TERMS)
    for number, (short, long, expected) in enumerate(zip(single, double, eager, strict=True)):
        assert float((long - expected).abs().max() / expected.abs().max()) < 1e-9
        rounding = 5e-6 if number < gradients else 5e-5  # a mean square of small differences of large readings
        assert float((short.double() - expected).norm() / expected.norm()) < rounding


@pytest.mark.thorough
@needs_compiler
def test_compiled_runs_are_the_eager_ones_and_repeat(lanes: list[Lane], caplog: pytest.LogCaptureFixture) -> None:
    runs = [
        fewshot_adam.train(lanes, _program(lanes), SETTINGS, compiled=compiled).health
        for compiled in (True, True, False)
    ]
    assert not caplog.records
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_allclose(runs[0], runs[2], rtol=1e-4)


@needs_compiler
def test_a_loaded_loop_leaves_subnormal_numbers_alone(lanes: list[Lane]) -> None:
    """Fast mathematics in the linker would flush them to zero in the whole process."""
    fewshot_adam.train(lanes, _program(lanes), SETTINGS, compiled=True)
    assert (np.array([1e-310]) * 0.5)[0] > 0.0


def test_without_a_compiler_it_stays_eager_and_says_so_once(
    lanes: list[Lane], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(c_library.shutil, "which", lambda _: None)
    monkeypatch.setattr(compiled_loss, "_TOLD", set())
    program, place = _case(lanes)
    with caplog.at_level(logging.WARNING):
        found = [_gradients(program, place, compiled) for compiled in (True, True, False)]
    assert [record.message for record in caplog.records] == ["the loop runs uncompiled: no C compiler found"]
    for told, plain in zip(found[0], found[2], strict=True):
        assert torch.equal(told, plain)


@needs_compiler
def test_small_jobs_are_not_compiled(lanes: list[Lane]) -> None:
    program, place = _case(lanes)
    assert isinstance(gradient_function(program, place, compiled_loss.WORTHWHILE - 1), EagerLoss)
    assert isinstance(gradient_function(program, place, compiled_loss.WORTHWHILE), CompiledLoss)


@pytest.mark.parametrize("mixed", [lambda v: v - v.sum(-1, keepdim=True), lambda v: v @ v.T, lambda v: v.cumsum(-1)])
def test_points_that_mix_are_refused(mixed: Callable[[Tensor], Tensor]) -> None:
    x = torch.ones(3, 7)
    recorded: Any = make_fx(lambda v: (mixed(v),))(x)
    with pytest.raises(c_library.NotCompiledError):
        point_loops.PointLoops(recorded.graph, (x,), 7)
