"""The compiled loop against the eager program, and what happens where nothing can be compiled."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import make_fx

from dieseltwin.engine import actuate, we2011
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.paper.loops import compiled_loss, point_loops
from dieseltwin.paper.loops import few_shot_adam as fewshot_adam
from dieseltwin.paper.loops.few_shot_program import AdamSettings, Lane, draw_lane, make_program, start_values
from dieseltwin.paper.loops.losses import Weights

needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
SETTINGS = AdamSettings(epochs=20, weights_until_epoch=10, held_out_share=0.1)


@pytest.fixture(scope="module")
def lanes(simulated: Callable[..., SegmentProblem], drive: Callable[..., Any]) -> list[Lane]:
    problem = simulated(drive(300, 151), we2011.FIELD, noise_seed=1)
    return [draw_lane(problem, 0, run, 3, SETTINGS) for run in range(3)]


def _case(lanes: list[Lane], settings: AdamSettings) -> tuple[Any, list[Tensor], Tensor, Weights]:
    problem = lanes[0].problem
    program = make_program(lanes, {0: actuate(problem.inputs, problem.parameters)}, None, None, None, settings)
    values, _ = start_values(lanes, program, settings)
    widths, n = program.widths(), program.n
    *heads, masked, pointwise, single = torch.split(values, [*widths, 4, 4 * n, 2], 1)
    z = [h @ columns for h, columns in zip(heads, program.columns, strict=True)]
    return program, z, masked, Weights(pointwise.view(len(lanes), 4, n), single)


@needs_compiler
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 5e-6), (torch.float64, 1e-9)])
def test_compiled_equals_eager(lanes: list[Lane], dtype: torch.dtype, tolerance: float) -> None:
    """To rounding; torch's softplus is the identity above 20, where e**-20 = 2e-9 is left out."""
    program, z, masked, weights = _case(lanes, replace(SETTINGS, dtype=dtype))
    told = compiled_loss.gradient_function(program, 1, True)(z, masked, weights, True)
    plain = compiled_loss.gradient_function(program, 1, False)(z, masked, weights, True)
    assert told.weights is not None and plain.weights is not None
    pairs = zip(
        (told.total, told.masked, *told.outputs, *told.weights),
        (plain.total, plain.masked, *plain.outputs, *plain.weights),
        strict=True,
    )
    for found, expected in pairs:
        assert float((found - expected).abs().max() / expected.abs().max()) < tolerance


@needs_compiler
def test_compiled_runs_are_the_eager_ones_and_repeat(lanes: list[Lane], caplog: pytest.LogCaptureFixture) -> None:
    actuations = {0: actuate(lanes[0].problem.inputs, lanes[0].problem.parameters)}
    runs = [
        fewshot_adam.train(lanes, actuations, None, None, None, replace(SETTINGS, compiled=compiled)).health
        for compiled in (True, True, False)
    ]
    assert not caplog.records
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_allclose(runs[0], runs[2], rtol=1e-4)


@needs_compiler
def test_a_loaded_loop_leaves_subnormal_numbers_alone(lanes: list[Lane]) -> None:
    """Fast mathematics in the linker would flush them to zero in the whole process."""
    fewshot_adam.train(lanes, {0: actuate(lanes[0].problem.inputs, lanes[0].problem.parameters)}, None, None, None,
                       replace(SETTINGS, compiled=True))  # fmt: skip
    assert (np.array([1e-310]) * 0.5)[0] > 0.0


def test_without_a_compiler_it_stays_eager_and_says_so_once(
    lanes: list[Lane], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(point_loops.shutil, "which", lambda _: None)
    monkeypatch.setattr(compiled_loss, "_TOLD", set())
    program, z, masked, weights = _case(lanes, SETTINGS)
    with caplog.at_level(logging.WARNING):
        found = [compiled_loss.gradient_function(program, 1, c)(z, masked, weights, False) for c in (True, True, False)]
    assert [record.message for record in caplog.records] == ["the few-shot loop runs uncompiled: no C compiler found"]
    torch.testing.assert_close(found[0].masked, found[2].masked, rtol=0.0, atol=0.0)


def test_small_jobs_are_not_compiled(lanes: list[Lane], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> Any:
        raise AssertionError("compiled")

    monkeypatch.setattr(compiled_loss, "_compiled", refuse)
    program, z, masked, weights = _case(lanes, SETTINGS)
    compiled_loss.gradient_function(program, compiled_loss.WORTHWHILE - 1)(z, masked, weights, False)
    with pytest.raises(AssertionError):
        compiled_loss.gradient_function(program, compiled_loss.WORTHWHILE)(z, masked, weights, False)


@pytest.mark.parametrize("mixed", [lambda v: v - v.sum(-1, keepdim=True), lambda v: v @ v.T, lambda v: v.cumsum(-1)])
def test_points_that_mix_are_refused(mixed: Callable[[Tensor], Tensor]) -> None:
    x = torch.ones(3, 7)
    recorded: Any = make_fx(lambda v: (mixed(v),))(x)
    with pytest.raises(point_loops.NotPointwiseError):
        point_loops.PointLoops(recorded.graph, (x,), 7)
