"""Few-shot Newton: assembled derivatives, defects, planted parameters, batches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, actuate, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import cramer_rao
from dieseltwin.identification.few_shot.collocation import Collocation, Data
from dieseltwin.identification.few_shot.defects import defects, windows_for
from dieseltwin.identification.few_shot.heads import heads_for, inverse_transform
from dieseltwin.identification.few_shot.newton import prepare
from dieseltwin.identification.few_shot.process_noise import calibrate, laboratory_states
from dieseltwin.identification.few_shot.residuals import PointModel
from dieseltwin.identification.identify import identify_segments
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.settings.params import StartConfig

Make = Callable[..., SegmentProblem]
Drive = Callable[..., Inputs]
QUICK = PAPER.model_copy(update={"start": StartConfig(at="lab", sd_masked=0.1)})


@pytest.fixture(scope="module")
def planted(simulated: Make, drive: Drive) -> SegmentProblem:
    """Thirty seconds of driving, clean, with health values of its own."""
    values = we2011.PARAMETERS.health() * np.array([0.8, 1.15, 0.96, 1.2])
    truth = we2011.PARAMETERS.replace(**dict(zip(HEALTH, values.tolist(), strict=True)))
    return simulated(drive(900, 151), truth, noise_seed=None)


def _truth(problem: SegmentProblem) -> np.ndarray:
    assert problem.truth is not None
    return np.array([problem.truth[name] for name in HEALTH])


def test_heads_are_orthonormal_and_invert_the_output_transform() -> None:
    time = np.linspace(0.0, 30.0, 151)
    heads = heads_for(time)
    for q in heads.columns:
        torch.testing.assert_close(q.T @ q, torch.eye(q.shape[1], dtype=torch.float64), atol=1e-10, rtol=0.0)
    # A smooth trajectory is inside the span: states and rates come back.
    t = torch.tensor(time)
    states = torch.stack([1.5e5 + 1e4 * torch.sin(0.3 * t), 1.7e5 + 2e3 * t, 5000.0 + 0.0 * t], -1)[None]
    path = heads.trajectory(heads.project(states))
    torch.testing.assert_close(path.states, states, rtol=1e-4, atol=0.0)
    expected = torch.stack([3e3 * torch.cos(0.3 * t), 2e3 + 0.0 * t, 0.0 * t], -1)[None]
    assert ((path.rates - expected)[:, 5:-5].abs().amax((0, 1)) < torch.tensor([60.0, 60.0, 1.0])).all()
    z = inverse_transform(states)
    torch.testing.assert_close(1e5 * torch.nn.functional.softplus(z[..., 0]), states[..., 0])


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(InputError, match="samples"):
        heads_for(np.linspace(0.0, 60.0, 61))


@pytest.mark.parametrize("dof", [4.0, float("inf")])
def test_gradient_and_hessian_against_autograd(planted: SegmentProblem, dof: float) -> None:
    setting = prepare(planted)
    collocation = Collocation(setting.heads, setting.inputs, setting.exact)
    states = laboratory_states(setting.actuation, we2011.PARAMETERS)
    generator = torch.Generator().manual_seed(3)
    begin = torch.log(torch.tensor(we2011.PARAMETERS.health()))[None]
    unknowns = torch.cat([setting.heads.project(states), begin], -1)
    unknowns = unknowns + 1e-3 * torch.randn(unknowns.shape, generator=generator, dtype=torch.float64)
    n = len(planted.time_s)
    readings = torch.tensor(planted.measured)[None]
    weights = torch.where(torch.isnan(readings[0]), 0.0, 1.0) / torch.tensor(planted.sigma)
    data = Data(
        torch.nan_to_num(readings), weights, torch.tensor([3e3, 6e3, 40.0], dtype=torch.float64),
        torch.zeros(1, n, 3, dtype=torch.float64), torch.zeros(1, n, 6, dtype=torch.float64),
    )  # fmt: skip
    found = collocation(unknowns, data, dof)
    upper = np.zeros((collocation.size, collocation.size))
    collocation.hessian(found.curvature, 0, upper)
    hessian = torch.from_numpy(np.triu(upper) + np.triu(upper, 1).T)
    for seed in range(3):
        direction = torch.randn(unknowns.shape, generator=generator.manual_seed(seed), dtype=torch.float64)
        direction = direction / direction.norm()
        step = 1e-6
        up = collocation(unknowns + step * direction, data, dof)
        down = collocation(unknowns - step * direction, data, dof)
        slope = (up.cost - down.cost) / (2.0 * step)
        torch.testing.assert_close(slope, (found.gradient * direction).sum(-1), rtol=1e-4, atol=1e-3)
        if dof == float("inf"):
            residual_up, residual_down = (torch.cat([q.physics, q.data], 1) for q in (up, down))
            moved = (residual_up - residual_down) / (2.0 * step)
            # Gauss-Newton: d' H d is the squared change of the residuals.
            curvature = (direction @ hessian @ direction.T).squeeze()
            torch.testing.assert_close(moved.square().sum(), curvature, rtol=1e-4, atol=0.0)


def test_defects_carry_the_heads_to_the_exact_solution(planted: SegmentProblem) -> None:
    """At the true states and parameters, corrected residuals and readings are far smaller than plain ones."""
    setting = prepare(planted)
    truth = we2011.PARAMETERS.replace(**dict(zip(HEALTH, _truth(planted).tolist(), strict=True)))
    exact = torch.tensor(planted.measured[:, :3])[None]
    unknowns = torch.cat([setting.heads.project(exact), torch.log(torch.tensor(_truth(planted)))[None]], -1)
    found = defects(setting.heads, setting.inputs, setting.exact, setting.windows, truth, unknowns)
    path = setting.heads.trajectory(unknowns[:, :-4])
    point = setting.exact(path.states, unknowns[:, -4:], setting.inputs, derivatives=False)
    plain = path.rates - point.rates
    assert ((plain - found.rate).abs().median(1).values < 0.05 * plain.abs().median(1).values).all()
    predicted = torch.cat([path.states, point.readings], -1)
    readings = torch.tensor(np.nan_to_num(planted.measured))[None]
    for channel in (0, 1, 3, 4):
        before = (predicted - readings)[..., channel].square().mean().sqrt()
        after = (predicted + found.reading - readings)[..., channel].square().mean().sqrt()
        assert after < 0.1 * before, channel


def test_windows_cover_every_sample_once(drive: Drive) -> None:
    windows = windows_for(actuate(drive(0, 301), we2011.PARAMETERS, 0.02))
    assert len(windows.starts) > 3
    torch.testing.assert_close(windows.share.sum(0), torch.ones(301, dtype=torch.float64))
    torch.testing.assert_close(windows.share_rate.sum(0), torch.zeros(301, dtype=torch.float64), atol=1e-12, rtol=0.0)


def test_process_noise_knows_bad_maps(planted: SegmentProblem) -> None:
    setting = prepare(planted)
    formula = setting.exact.model.eta_vol
    bad = PointModel(planted.parameters, {"eta_vol": lambda p_im, n_e, c: 1.05 * formula(p_im, n_e, c)})
    settings = QUICK.of("few-shot-newton")
    levels = [calibrate(setting, model, settings).floor for model in (setting.exact, bad)]
    assert levels[1][0] > 3.0 * levels[0][0]  # the flow into the cylinders leaves the intake manifold
    assert levels[1][2] < 2.0 * levels[0][2]  # the shaft only hears of it through T_em


def test_planted_parameters_are_recovered_from_clean_readings(planted: SegmentProblem) -> None:
    found = identify_segments([planted], "few-shot-newton", 2, 0, config=QUICK).segments[0]
    relative = cramer_rao([planted], _truth(planted), planted.true_initial[:3])[0].relative
    assert found.converged.all()
    assert (np.abs(found.parameters / _truth(planted) - 1.0) < 0.3 * relative).all()
    # States include what the basis misses.
    error = np.abs(found.states[5:, :3] / planted.measured[5:, :3] - 1.0)
    assert (np.sqrt((error**2).mean(axis=0)) < 2e-3).all()


def test_noisy_estimates_scatter_as_their_own_standard_deviation(planted: SegmentProblem) -> None:
    noisy = planted.with_noise_draws(24, np.random.default_rng(8))
    found = identify_segments([noisy], "few-shot-newton", 24, 1, config=QUICK).segments[0]
    relative = cramer_rao([planted], _truth(planted), planted.true_initial[:3])[0].relative
    ratio = np.sqrt(np.mean(np.log(found.parameters / _truth(planted)) ** 2, axis=0)) / relative
    # 24 draws know a standard deviation to 15 %; three of those on 1.1.
    assert (ratio < 1.6).all(), ratio
    covered = (found.interval_90[..., 0] < _truth(planted)) & (_truth(planted) < found.interval_90[..., 1])
    assert covered.mean() > 0.75
    assert np.median(found.chi2_per_sample) == pytest.approx(1.0, abs=0.1)


def test_a_batch_equals_its_runs_alone_and_seeds_repeat(planted: SegmentProblem) -> None:
    noisy = planted.with_noise_draws(3, np.random.default_rng(2))
    together = identify_segments([noisy], "few-shot-newton", 3, 5, config=QUICK).segments[0]
    again = identify_segments([noisy], "few-shot-newton", 3, 5, config=QUICK).segments[0]
    np.testing.assert_array_equal(together.parameters, again.parameters)
    # The first run's draws don't depend on the number of runs; alone it is the same to the iteration's tolerance.
    alone = identify_segments([noisy], "few-shot-newton", 1, 5, config=QUICK).segments[0]
    np.testing.assert_allclose(alone.parameters[0], together.parameters[0], rtol=1e-4)


def test_masked_readings_are_bridged_and_missing_channels_refused(planted: SegmentProblem) -> None:
    measured = planted.measured + np.random.default_rng(1).standard_normal(planted.measured.shape) * planted.sigma
    measured[40:60, 0] = np.nan
    measured[:, 3] = np.nan
    gappy = type(planted)(
        planted.t0_s, planted.t1_s, planted.inputs, measured, planted.sigma, planted.parameters, truth=planted.truth
    )
    found = identify_segments([gappy], "few-shot-newton", 1, 0, config=QUICK).segments[0]
    assert np.isfinite(found.parameters).all() and found.converged.all()
    measured = measured.copy()
    measured[:, 2] = np.nan
    blind = type(planted)(planted.t0_s, planted.t1_s, planted.inputs, measured, planted.sigma, planted.parameters)
    with pytest.raises(InputError, match="omega_t"):
        identify_segments([blind], "few-shot-newton", 1, 0, config=QUICK)


def test_idle_with_a_shut_valve_is_flagged(idle_problem: SegmentProblem) -> None:
    found = identify_segments([idle_problem], "few-shot-newton", 2, 0, config=QUICK).segments[0]
    assert np.isfinite(found.parameters).all()
    assert not found.identifiable[HEALTH.index("A_egrmax")]
    assert found.identifiable[HEALTH.index("A_vgtmax")]
    assert (found.std[:, 0] / found.parameters[:, 0] > 0.25).all()  # its own interval says so too


def test_no_run_is_surer_than_the_bound(idle_problem: SegmentProblem, planted: SegmentProblem) -> None:
    """At idle h_tot can run off to where eta_sc looks certain: its deviation must stay that of the driving."""
    for problem in (idle_problem, planted.with_noise_draws(1, np.random.default_rng(3))):
        found = identify_segments([problem], "few-shot-newton", 2, 0, config=QUICK).segments[0]
        nominal = cramer_rao([problem], problem.parameters.health(), found.states[0, :3])[0].relative
        assert (found.std / found.parameters >= np.minimum(nominal, 1e3) * (1.0 - 1e-9)).all()


@pytest.mark.thorough
def test_idle_runs_leave_their_start(drive: Drive, simulated: Make) -> None:
    """Behind a shut valve A_egrmax has no curvature, and the basis misses nothing: neither may stop the others."""
    time = 0.2 * np.arange(301)
    inputs = Inputs(
        time, 612.0 + 6.0 * np.sin(0.35 * time), 10.0 + 0.3 * np.sin(0.2 * time), np.zeros(301),
        45.0 + 10.0 * np.sin(0.4 * time),
    )  # fmt: skip
    clean = simulated(inputs, we2011.FIELD, noise_seed=None)
    noisy = clean.with_noise_draws(6, np.random.default_rng(4))
    found = identify_segments([noisy], "few-shot-newton", 6, 2, config=PAPER).segments[0]
    relative = cramer_rao([clean], _truth(clean), clean.true_initial[:3])[0].relative
    error = found.parameters / _truth(clean) - 1.0
    vgt = HEALTH.index("A_vgtmax")
    assert (np.abs(error[:, vgt]) < 4.0 * relative[vgt]).all()  # it used to stay at the start, 16 % off, and converge
    assert np.median(found.chi2_per_sample) == pytest.approx(1.0, abs=0.1)
    assert found.converged.mean() >= 0.5
    assert np.isfinite(found.std[:, vgt]).all()
