"""Ensembles: cases, batches that equal the whole, what is kept of every member, early stopping, the unit of x_r."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from segments import PAPER

from dieseltwin.engine import HEALTH, Inputs, we2011
from dieseltwin.errors import InputError
from dieseltwin.identification.bound import IDENTIFIABLE_BELOW, nominal_bound
from dieseltwin.identification.problem import SegmentProblem
from dieseltwin.identification.result import SegmentEstimate
from dieseltwin.paper.evaluation.ensembles import (
    CASES,
    case_problems,
    diverged,
    load_estimates,
    member_table,
    merged,
    save_estimates,
    without_diverged,
)
from dieseltwin.paper.loops.few_shot_adam import estimate
from dieseltwin.settings.methods import names

Make = Callable[..., SegmentProblem]
Drive = Callable[..., Inputs]
SHORT = PAPER.changed("few-shot-adam", epochs=30, weights_until_epoch=20)


@pytest.fixture(scope="module")
def clean(simulated: Make, drive: Drive) -> list[SegmentProblem]:
    """Two segments of twenty seconds, clean."""
    return [simulated(drive(first, 101), we2011.FIELD, noise_seed=None) for first in (300, 600)]


def test_cases_are_the_papers(clean: list[SegmentProblem]) -> None:
    half, whole, noisy = (case_problems(clean, case, 3, 7) for case in CASES)
    assert half[0].observed[:, :5].sum() == 5 * 51 and half[0].observed[1].sum() == 0
    np.testing.assert_array_equal(whole[0].measured, clean[0].measured)
    assert whole[0].noise_draws is None and noisy[0].noise_draws is not None
    assert noisy[0].noise_draws.shape == (3, 101, 6)
    # a member's draw doesn't depend on how many there are
    np.testing.assert_array_equal(case_problems(clean, "noisy-301", 5, 7)[1].noise_draws[:3], noisy[1].noise_draws)
    few = case_problems(clean, "noisy-301", 2, 7, ["p_im_pa", "p_em_pa", "omega_t_rad_s"])[0]
    assert np.isnan(few.measured[:, 3:]).all() and np.isfinite(few.measured[:, :3]).all()
    with pytest.raises(InputError, match="case"):
        case_problems(clean, "clean-77", 1, 0)
    with pytest.raises(InputError, match="channels"):
        case_problems(clean, "clean-301", 1, 0, ["p_imm"])


def test_batches_give_what_the_whole_gives(clean: list[SegmentProblem], tmp_path: Path) -> None:
    noisy = case_problems(clean, "noisy-301", 3, 7)
    whole = estimate(noisy, 3, 11, config=SHORT)
    parts = []
    for first, runs in ((0, 2), (2, 1)):
        made = estimate(noisy, runs, 11, config=SHORT, first_run=first)
        save_estimates(tmp_path / f"{first}.npz", made)
        parts.append(load_estimates(tmp_path / f"{first}.npz", [e.seconds_per_run for e in made]))
    together = [
        merged(of_segment, problem) for of_segment, problem in zip(zip(*parts, strict=True), noisy, strict=True)
    ]
    for ours, one in zip(together, whole, strict=True):
        np.testing.assert_allclose(ours.parameters, one.parameters, rtol=1e-4)
        assert ours.curves["loss"].shape == one.curves["loss"].shape
        assert ours.method == one.method and ours.t0_s == one.t0_s
        np.testing.assert_allclose(ours.bound, one.bound, rtol=1e-4)
        np.testing.assert_array_equal(ours.identifiable, one.identifiable)
    again = tmp_path / "again.npz"
    save_estimates(again, [replace(e, seconds_per_run=99.0) for e in parts[0]])
    assert again.read_bytes() == (tmp_path / "0.npz").read_bytes()  # run times are no part of a result


def members_of(problem: SegmentProblem, initial: NDArray[np.float64], converged: NDArray[np.bool_]) -> SegmentEstimate:
    """What a method of the paper's kind says of R runs whose states begin at `initial` (R, 5)."""
    nothing = np.full((len(initial), 4), np.nan)
    finite = np.isfinite(initial).all(axis=1)
    used = converged if converged.any() else (finite if finite.any() else ~finite)
    states = np.tile(initial[:, None], (1, len(problem.time_s), 1))
    bound = nominal_bound(problem, states[used].mean(axis=0))
    values = np.where(finite[:, None], we2011.FIELD.health(), np.nan)
    return SegmentEstimate(
        problem.t0_s, problem.t1_s, problem.time_s, values, nothing, np.stack([nothing, nothing], -1),
        states[used].mean(axis=0), bound.absolute, bound.identifiable(IDENTIFIABLE_BELOW), converged, 0.1,
        "few-shot-adam",
        state_samples=states[used], parameter_samples=values[used],
    )  # fmt: skip


@pytest.mark.parametrize("converged", [[True, True, True], [True, False, False], [False, False, False]])
def test_bound_and_states_dont_depend_on_the_batches(clean: list[SegmentProblem], converged: list[bool]) -> None:
    problem = clean[0]
    assert problem.true_initial is not None
    initial = np.asarray(problem.true_initial) * np.array([[1.0], [1.1], [1.3]])
    initial[2] = initial[2] if converged[2] else np.nan
    still = np.array(converged)
    whole = members_of(problem, initial, still)
    first = members_of(problem, initial[:2], still[:2])
    if still.all():  # each batch has a bound of its own
        assert np.abs(first.bound / whole.bound - 1.0).max() > 1e-3
    rest = [members_of(problem, initial[i : i + 1], still[i : i + 1]) for i in (1, 2)]
    alone = members_of(problem, initial[:1], still[:1])
    for parts in ([first, rest[1]], [alone, *rest]):
        ours = merged(parts, problem)
        np.testing.assert_allclose(ours.states, whole.states, rtol=1e-12)
        np.testing.assert_allclose(ours.bound, whole.bound, rtol=1e-9)
        np.testing.assert_array_equal(ours.state_samples, whole.state_samples)
        np.testing.assert_array_equal(ours.converged, still)


@pytest.mark.filterwarnings("error")
def test_one_diverged_member_leaves_an_ensemble_that_can_be_written(
    clean: list[SegmentProblem], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tasks import ensembles, evaluate

    made = [members_of(p, np.tile(p.true_initial, (3, 1)), np.ones(3, dtype=bool)) for p in clean]
    values = made[1].parameters.copy()
    values[1] = np.nan
    values[2, 0] *= 100.0
    curve = np.tile(np.log(2.0 + np.arange(4.0))[:, None], (1, 3))
    made[1] = replace(
        made[1], parameters=values, parameter_samples=values, curves={"epoch": np.arange(4.0), "loss": curve}
    )
    batch = tmp_path / "batch"
    batch.mkdir()
    ensembles._write(batch, made, 1.0)
    monkeypatch.setattr(ensembles, "problems_for", lambda *_: clean)
    what = {"case": "clean-301", "members": 3, "seed": 5, "noise_seed": 6, "channels": None}
    evaluate.ensemble.function(
        tmp_path, None, field=tmp_path, settings={}, what=what, method="few-shot-adam", variant="", epochs=3,
        last_epoch=False, kind="", run_times=[], part_0000=batch,
    )  # fmt: skip
    document = json.loads((tmp_path / "identification.json").read_text(encoding="utf-8"))
    assert [run["segments"][1]["parameters"]["eta_sc"]["value"] is None for run in document["runs"]] == [
        False,
        True,
        True,
    ]
    assert [run["converged"] for run in document["runs"]] == [True, False, False]
    # the first segment still says something of every member
    assert all(run["parameters"]["A_vgtmax"] is not None for run in document["runs"])
    table = pd.read_parquet(tmp_path / "members.parquet")
    assert table.groupby("segment")["member"].nunique().tolist() == [3, 3] and table["diverged"].sum() == 8
    assert pd.read_parquet(tmp_path / "curves.parquet")["run"].unique().tolist() == [0]


def test_diverged_members_are_kept_in_the_table_and_left_out_of_the_bands(clean: list[SegmentProblem]) -> None:
    made = estimate(case_problems(clean[:1], "clean-301", 3, 7), 3, 1, config=SHORT)[0]
    truth = we2011.FIELD.health()
    values = made.parameters.copy()
    values[1] = np.nan
    values[2, 0] *= 100.0
    broken = replace(made, parameters=values)
    bound = np.full(4, 0.01)
    assert diverged(values, truth, bound).tolist() == [False, True, True]
    hidden = np.array([np.inf, 0.01, 0.01, 0.01])  # nobody can know A_egrmax there
    assert diverged(values, truth, hidden).tolist() == [False, True, False]
    names = dict(zip(HEALTH, truth.tolist(), strict=True))
    table = member_table([broken], names, [bound], 5)
    assert len(table) == 3 * 4 and table["diverged"].sum() == 8 and (table["seed"] == 5).all()
    kept = without_diverged(broken, truth, bound)
    assert kept is not None and kept.runs == 3 and not kept.converged[1:].any()
    assert np.isnan(kept.parameters[1:]).all() and np.isnan(kept.curves["loss"][:, 1:]).all()
    np.testing.assert_array_equal(kept.parameters[0], made.parameters[0])
    np.testing.assert_array_equal(kept.curves["loss"][:, 0], made.curves["loss"][:, 0])
    assert without_diverged(replace(made, parameters=np.full_like(values, np.nan)), truth, bound) is None


def test_early_stopping_takes_the_epoch_that_predicts_unseen_readings_best(clean: list[SegmentProblem]) -> None:
    noisy = case_problems(clean[:1], "noisy-301", 2, 7)
    made = estimate(noisy, 2, 3, config=SHORT.changed("few-shot-adam", held_out_share=0.2))[0]
    misfit = made.curves["held_out_misfit"]
    assert misfit.shape == made.curves["loss"].shape and (misfit > 0.0).all()
    for run, best in enumerate(np.argmin(misfit, axis=0)):
        for i, name in enumerate(HEALTH):
            assert made.parameters[run, i] == made.curves[name][best, run]


def test_the_unit_of_x_r_changes_only_its_own_term(clean: list[SegmentProblem]) -> None:
    problems = case_problems(clean[:1], "clean-301", 1, 7)
    printed = estimate(problems, 1, 3, config=SHORT)[0]
    held = estimate(problems, 1, 3, config=SHORT.changed("few-shot-adam", scale_x_r=0.03))[0]
    assert held.curves["loss"][0] > printed.curves["loss"][0]  # the same start, a dearer residual
    np.testing.assert_array_equal(held.curves["A_egrmax"][0], printed.curves["A_egrmax"][0])


def test_the_benchmark_gives_the_learned_parts_to_every_method_that_uses_them(
    clean: list[SegmentProblem], project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    spec = importlib.util.spec_from_file_location("benchmark", project_root / "benchmarks" / "evaluation.py")
    assert spec is not None and spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    given = {}

    def fake(problems: list[SegmentProblem], method: str, *_: object, config: object, **learned: object) -> object:
        given[method] = learned
        bodies = [members_of(p, np.tile(p.true_initial, (2, 1)), np.ones(2, dtype=bool)) for p in problems]
        return SimpleNamespace(segments=bodies)

    monkeypatch.setattr(benchmark, "clean_problems", lambda *_: clean)
    monkeypatch.setattr(benchmark, "networks_for", lambda *_: {"maps": "learned"})
    monkeypatch.setattr(benchmark, "identify_segments", fake)
    command = ["evaluation.py", "--members", "2", "--cases", "noisy-301", "--models", "models", "--methods"]
    monkeypatch.setattr("sys.argv", [*command, *names()])
    benchmark.main()
    assert {method for method, learned in given.items() if learned} == {"few-shot-adam", "baseline", "multi-stage"}
    one_stream = ["few-shot-adam", "--seed", "5", "--noise-seed", "5"]  # starts would be made of the noise's numbers
    for wrong in (["multi_stage"], ["classical"], one_stream):
        monkeypatch.setattr("sys.argv", [*command, *wrong])
        with pytest.raises(SystemExit):
            benchmark.main()
    said = capsys.readouterr().err
    assert "multi-stage" in said and "--noise-seed" in said
