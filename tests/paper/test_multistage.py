"""Baseline and multi-stage transfer learning: stages, starts, source models, lanes; a tiny clean problem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
import torch
from segments import PAPER, REFERENCE
from segments import make_problem as problem_of
from torch import Tensor

from dieseltwin.engine import HEALTH, Inputs, actuate, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.unknowns import to_masked, to_physical
from dieseltwin.paper.loop_settings import PinnConfig, Stage
from dieseltwin.paper.loops import baseline
from dieseltwin.paper.loops import multi_stage as multistage
from dieseltwin.paper.loops import pinn_training as pinn
from dieseltwin.paper.loops.few_shot_program import make_program
from dieseltwin.paper.loops.pinn_networks import StateNetworks
from dieseltwin.settings.params import IdentifyConfig, StartConfig

RATES = (1e-2, 1e-2, 1e-2)


def make_problem(first: int, rows: int = 61) -> SegmentProblem:
    """A clean piece of the reference driving with field parameters; the start is at the laboratory values."""
    trace = pd.read_csv(REFERENCE).iloc[first : first + rows]
    columns = [trace[name].to_numpy() for name in ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")]
    inputs = Inputs(*columns).clipped(we2011.PARAMETERS)
    return problem_of(inputs, we2011.FIELD, noise_seed=None)


@pytest.fixture(scope="module")
def problems() -> list[SegmentProblem]:
    return [make_problem(300), make_problem(360)]


def stage(until_epoch: int, layers: str, networks: float, unknowns: float, weights: float) -> Stage:
    rates = {"rate_networks": networks, "rate_unknowns": unknowns, "rate_weights": weights}
    return Stage.model_validate({"until_epoch": until_epoch, "layers": layers, **rates})


def config_of(*of_first: Stage, later: Sequence[Stage] = (), **other: object) -> IdentifyConfig:
    """The paper's settings with other stages, those of the first segment for all where no others are given."""
    config = PAPER.changed("baseline", stages=of_first, **other)
    return config.changed("multi-stage", stages=later or of_first, **other)


def settings_of(*stages: Stage, **other: object) -> PinnConfig:
    return pinn.settings_of(config_of(*stages, **other), "baseline")


def values_after(problem: SegmentProblem, *stages: Stage) -> tuple[StateNetworks, Tensor]:
    """All columns of one lane after some stages."""
    settings = settings_of(*stages)
    lanes = pinn.make_lanes([problem], [0], 1, 5, PAPER.start)
    program = make_program(lanes, {0: actuate(problem.inputs, problem.parameters)}, None, None, None, settings)
    networks = StateNetworks(problem.time_s)
    values = pinn.start_values(lanes, program, networks, settings)
    pinn.train(program, networks, values, stages, problem.sigma[None, :5])
    return networks, values[0]


def test_stages_freeze_what_they_should(problems: list[SegmentProblem]) -> None:
    stages = (
        stage(4, "all", *RATES), stage(8, "last", *RATES), stage(12, "last", 1e-2, 1e-2, 0.0)
    )  # fmt: skip
    networks, one = values_after(problems[0], *stages[:1])
    _, two = values_after(problems[0], *stages[:2])
    _, three = values_after(problems[0], *stages)
    h, last, unknowns = networks.hidden_size, networks.size, networks.size + len(HEALTH)
    assert torch.equal(one[:h], two[:h]) and torch.equal(two[:h], three[:h])
    for before, after in ((one, two), (two, three)):
        assert (before[h:last] != after[h:last]).all() and (before[last:unknowns] != after[last:unknowns]).all()
    # the pointwise weights of a clean sample that is met exactly would not move; all these do
    assert (one[unknowns:] < two[unknowns:]).all()
    assert torch.equal(two[unknowns:], three[unknowns:])


def test_frozen_hidden_layers_give_the_loss_of_fresh_ones(problems: list[SegmentProblem]) -> None:
    once = (stage(3, "all", *RATES), stage(9, "last", *RATES))
    pieces = (once[0], *(stage(e, "last", *RATES) for e in range(4, 10)))
    _, a = values_after(problems[0], *once)
    _, b = values_after(problems[0], *pieces)
    assert torch.equal(a, b)


def test_weights_start_as_printed(problems: list[SegmentProblem]) -> None:
    settings = settings_of(stage(1, "all", *RATES))
    lanes = pinn.make_lanes(problems, [0], 1, 5, PAPER.start)
    program = make_program(lanes, {0: actuate(problems[0].inputs, problems[0].parameters)}, None, None, None, settings)
    networks = StateNetworks(problems[0].time_s)
    values = pinn.start_values(lanes, program, networks, settings)[0]
    at, n = networks.size + len(HEALTH), len(problems[0].time_s)
    pointwise = values[at : at + 4 * n].view(4, n)
    expected = np.array([1e3, 1e3, 1e3, 2e3]) * (problems[0].measured[:, :4] / problems[0].measured[:, :4].max(0))
    np.testing.assert_allclose(pointwise.T, expected, atol=0.6)
    np.testing.assert_allclose(values[-2:], 1500.0, atol=0.6)


def test_unknowns_move_towards_the_truth(problems: list[SegmentProblem]) -> None:
    config = config_of(stage(150, "all", 2e-2, 2e-2, 1e-2), stage(220, "all", 4e-3, 4e-3, 0.0))
    config = config.model_copy(update={"start": StartConfig(at="lab", sd_masked=0.0)})
    (found,) = baseline.estimate(problems[:1], 1, 2, config=config)
    truth, start = we2011.FIELD.health(), we2011.PARAMETERS.health()
    off = np.abs(found.parameters[0] / truth - 1.0)
    before = np.abs(start / truth - 1.0)
    assert (off[:3] < 0.5 * before[:3]).all()
    assert off[1] < 0.03
    error = np.abs(found.states[:, :3] / problems[0].measured[:, :3] - 1.0)
    assert error.mean() < 0.05
    assert found.curves["loss"][-1, 0] < 0.02 * found.curves["loss"][0, 0]


def test_runs_do_not_depend_on_their_batch(
    problems: list[SegmentProblem], monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = settings_of(stage(15, "all", *RATES), stage(25, "last", *RATES))

    def found(runs: int) -> np.ndarray:
        """(2, runs, 4) parameters of both segments."""
        lanes = pinn.make_lanes(problems, [0, 1], runs, 3, PAPER.start)
        trained = pinn.train_lanes(lanes, None, None, settings, dtype=torch.float64).trained
        return trained.final.reshape(2, runs, 4)

    whole, more = found(2), found(3)
    monkeypatch.setattr(pinn, "LANES", 1)
    np.testing.assert_allclose(whole, found(2), rtol=1e-7)
    np.testing.assert_allclose(more[:, :2], whole, rtol=1e-7)
    assert not np.allclose(whole[0, 0], whole[0, 1], rtol=1e-3)


def test_same_seed_same_result(problems: list[SegmentProblem]) -> None:
    config = config_of(stage(10, "all", *RATES), stage(15, "last", 1e-2, 1e-2, 0.0))
    first, second = (multistage.estimate(problems, 2, 9, config=config) for _ in range(2))
    other = multistage.estimate(problems, 2, 10, config=config)
    for a, b, c in zip(first, second, other, strict=True):
        assert np.array_equal(a.parameters, b.parameters) and np.array_equal(a.states, b.states)
        assert not np.array_equal(a.parameters, c.parameters)


def test_later_segments_start_from_the_source_models(problems: list[SegmentProblem]) -> None:
    config = config_of(stage(12, "all", *RATES), later=[stage(6, "all", *RATES)])
    found = multistage.estimate(problems, 2, 3, config=config)
    source = baseline.estimate(problems[:1], 2, 3, config=config)[0]
    assert np.array_equal(found[0].parameters, source.parameters)
    begin = np.stack([found[1].curves[name][0] for name in HEALTH], -1)
    np.testing.assert_allclose(begin, source.parameters, rtol=1e-6)
    assert (found[1].parameters != source.parameters).all()
    assert [f.method for f in found] == ["multi-stage"] * 2


def test_a_diverged_source_is_replaced_by_another(problems: list[SegmentProblem]) -> None:
    settings = settings_of(stage(2, "all", *RATES))
    lanes = pinn.make_lanes(problems, [0], 3, 1, PAPER.start)
    source = pinn.train_lanes(lanes, None, None, settings)
    source.weights[1, 4] = float("nan")
    weights, masked = multistage.source_models(source, 5)
    assert torch.isfinite(weights).all()
    assert torch.equal(weights[[0, 2, 3]], source.weights[[0, 2, 0]])
    np.testing.assert_allclose(to_physical(masked.double().numpy())[0], source.trained.health[0, -1], rtol=1e-5)


def test_a_diverged_run_is_reported_and_leaves_the_others_alone(problems: list[SegmentProblem]) -> None:
    settings = settings_of(stage(6, "all", *RATES))
    lanes = pinn.make_lanes(problems, [0], 2, 1, PAPER.start)
    source = pinn.train_lanes(lanes, None, None, settings)
    good = pinn.train_lanes(lanes, None, None, settings, (source.weights, source.masked))
    source.weights[0] = float("nan")
    found = pinn.train_lanes(lanes, None, None, settings, (source.weights, source.masked))
    np.testing.assert_allclose(found.trained.health[1], good.trained.health[1], rtol=1e-5)
    (estimate,) = pinn.estimates_of(problems[:1], found, 2, 0.0, "multi-stage", 0.1, IDENTIFIABLE_BELOW)
    assert estimate.runs == 2 and not estimate.converged[0]
    assert np.isfinite(estimate.states).all() and np.isfinite(estimate.bound).all()


@pytest.mark.parametrize("method", ["baseline", "multi-stage"])
def test_methods_stand_in_the_registry(problems: list[SegmentProblem], method: str) -> None:
    stages = PAPER.of("multi-stage").stages
    short = [stage.model_copy(update={"until_epoch": 3 * (k + 1)}) for k, stage in enumerate(stages)]
    found = identify_segments(problems, method, 2, 1, config=config_of(*short))
    assert found.method == method and [s.runs for s in found.segments] == [2, 2]
    assert found.to_json()["segments"][1]["t0_s"] == problems[1].t0_s
    curves = found.segments[1].curves
    assert curves["epoch"][-1] == 12 and curves["loss"].shape == (13, 2) and curves["loss_data_W_egr"].shape == (13,)


def test_the_estimate_is_the_mean_of_the_last_epochs(problems: list[SegmentProblem]) -> None:
    stages = (stage(10, "all", *RATES),)
    found = {}
    for share in (0.0, 0.4):
        settings = settings_of(*stages, average_share=share)
        lanes = pinn.make_lanes(problems, [0], 2, 1, PAPER.start)
        found[share] = pinn.train_lanes(lanes, None, None, settings).trained
    np.testing.assert_allclose(found[0.0].final, found[0.0].health[:, -1], rtol=1e-6)
    masked = to_masked(found[0.4].health[:, -4:]).mean(axis=1)  # every one of so few epochs is kept
    np.testing.assert_allclose(found[0.4].final, to_physical(masked), rtol=1e-6)
    np.testing.assert_array_equal(found[0.4].health, found[0.0].health)


def test_paper_profile_has_the_printed_epochs() -> None:
    stages = PAPER.of("multi-stage").stages
    assert PAPER.of("baseline").stages[-1].until_epoch == 80000
    assert max(s.until_epoch for s in stages if s.layers == "all") == 20000
    assert max(s.until_epoch for s in stages if s.rate_weights > 0.0) == 30000
    assert stages[-1].until_epoch == 35000


def test_stages_out_of_order_are_refused() -> None:
    with pytest.raises(InputError, match="rising"):
        settings_of(stage(5, "all", *RATES), stage(5, "all", *RATES))
    with pytest.raises(InputError, match="all first"):
        settings_of(stage(5, "last", *RATES), stage(6, "all", *RATES))
