"""The evaluation in a tiny profile: plan, ensembles, tables, page, a second run that computes nothing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tiny_settings
import yaml
from tiny_settings import new_context

from tasks import run_context
from tasks.workspace import PROJECT, Workspace

pytestmark = pytest.mark.timeout(900)

STAGES = [
    {"until_epoch": 6, "layers": "all", "rate_networks": 1e-3, "rate_unknowns": 1e-3, "rate_weights": 1e-2},
    {"until_epoch": 10, "layers": "last", "rate_networks": 1e-3, "rate_unknowns": 1e-3, "rate_weights": 0.0},
]
EVALUATION = {
    "cases": ["noisy-301"],
    "members": {"baseline": 3, "multi-stage": 3, "few-shot-adam": 2, "few-shot-newton": 2, "classical": 3},
    "members_per_batch": 2,
    "trainings": 1,
    "bootstrap": 50,
    "variants": [
        {"name": "early stopping", "method": "few-shot-adam", "held_out_share": 0.1, "members": 2},
        {"name": "last epoch", "method": "multi-stage", "last_epoch": True},
        {"name": "three sensors", "method": "classical", "members": 2,
         "channels": ["p_im_pa", "p_em_pa", "omega_t_rad_s"]},
    ],
}  # fmt: skip


def write_tiny(root: Path) -> None:
    path = tiny_settings.write_params(root)
    settings = yaml.safe_load(path.read_text(encoding="utf-8"))
    tiny = settings["profiles"]["tiny"]
    tiny["evaluation"] = EVALUATION
    tiny["identify"] = {
        **tiny["identify"],
        "minutes": 2.0,
        "methods": {
            **tiny["identify"]["methods"],
            "baseline": {"stages": STAGES},
            "multi-stage": {"stages": STAGES, "average_share": 0.5},
        },
    }
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")


def test_the_plan_gives_every_method_the_same_noise_and_variants_the_seed_of_their_method() -> None:
    from dieseltwin.settings.params import load_params
    from tasks.evaluation_plan import ensembles_of

    settings = load_params(PROJECT / "params.yaml", "paper").model_dump(mode="json")
    plans = ensembles_of(settings)
    own = [plan for plan in plans if not plan.variant]
    assert len(own) == 15
    assert {plan.what["members"] for plan in own} == {30}
    assert len({plan.what["noise_seed"] for plan in own if plan.case == "noisy-301"}) == 1
    adam = {plan.variant: plan for plan in plans if plan.method == "few-shot-adam" and plan.case == "noisy-301"}
    assert adam["early stopping"].what["seed"] == adam[""].what["seed"]
    assert adam[""].epochs == 30000
    assert len({plan.slug for plan in plans}) == len(plans)
    last = [plan for plan in plans if plan.last_epoch]
    assert len(last) == 9 and {plan.trained_as for plan in last} <= {plan.slug for plan in own}
    of = {plan.slug: plan.what for plan in own}
    assert all(plan.what == of[plan.trained_as] for plan in last)
    only = [plan.slug for plan in ensembles_of(settings, ["clean-301-multi-stage-last_epoch"])]
    assert only == ["clean-301-baseline", "clean-301-multi-stage", "clean-301-multi-stage-last_epoch"]
    for plan in plans:
        assert sum(runs for _, runs in plan.batches) == plan.what["members"]


def test_one_ensemble_can_be_run_alone_and_multi_stage_brings_what_it_starts_from() -> None:
    from dieseltwin.errors import InputError
    from dieseltwin.settings.params import load_params
    from tasks.evaluation_plan import ensembles_of

    settings = load_params(PROJECT / "params.yaml", "paper").model_dump(mode="json")
    named = ["noisy-301-few-shot-adam", "clean-151-multi-stage"]
    assert {plan.slug for plan in ensembles_of(settings, named)} == {*named, "clean-151-baseline"}
    with pytest.raises(InputError, match="noisy-301-classical"):
        ensembles_of(settings, ["classical"])


def test_the_figures_show_readings_that_a_member_saw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dieseltwin.paper.evaluation import page as evaluation_page
    from dieseltwin.settings.params import load_params
    from tasks import ensembles, evaluate, identify
    from tasks.evaluation_plan import ensembles_of

    settings = load_params(PROJECT / "params.yaml", "paper").model_dump(mode="json")
    plans = [plan for plan in ensembles_of(settings) if plan.method == "classical" and not plan.variant]
    parts = {}
    for plan in plans:
        folder = tmp_path / plan.slug
        folder.mkdir()
        note = {"method": plan.method, "variant": "", **plan.what}
        (folder / "ensemble.json").write_text(json.dumps({k: v for k, v in note.items() if v is not None}))
        (folder / "identification.json").write_text("{}")
        parts[plan.slug] = folder
    (tmp_path / "runtime.json").write_text('{"run_times": []}')
    seen = {}

    def fake_problems(field: Path, settings: dict, what: dict, members: int) -> list:
        seen[what["case"]] = (what["noise_seed"], what.get("channels"))
        return []

    monkeypatch.setattr(identify, "problems_of", lambda *_: ([], None))
    monkeypatch.setattr(ensembles, "problems_for", fake_problems)
    monkeypatch.setattr("dieseltwin.report.inputs.write_report_inputs", lambda folder, *_, **__: folder.mkdir())
    monkeypatch.setattr("dieseltwin.report.results.load_results", lambda folder: None)
    monkeypatch.setattr(evaluation_page, "build_page", lambda *_, **__: None)
    evaluate.page.function(
        tmp_path, None, field=tmp_path, common=tmp_path, settings={}, about={}, run_times=[], **parts
    )  # fmt: skip
    assert seen == {plan.case: (plan.what["noise_seed"], None) for plan in plans}
    assert len({seed for seed, _ in seen.values()}) == 3


def test_the_noise_of_every_case_is_that_of_the_whole_recording(tmp_path: Path) -> None:
    """Readings and bounds of the first minutes had the noise of their own means, up to 15 % less."""
    from dieseltwin.engine import HEALTH, we2011
    from dieseltwin.paper.datasets import add_noise, noise_sigma, simulated
    from dieseltwin.settings.params import load_params
    from tasks.ensembles import problems_for

    params = load_params(PROJECT / "params.yaml", "paper")
    time_s = np.arange(0.0, 181.0)
    inputs = pd.DataFrame({"time_s": time_s, "n_e_rpm": 900.0 + 5.0 * time_s, "u_delta_mg": 60.0 + 0.5 * time_s,
                           "u_egr_pct": 30.0, "u_vgt_pct": 60.0})  # fmt: skip
    clean = simulated(inputs, we2011.PARAMETERS, 0.2, 0.025)
    clean = clean.assign(**{name: getattr(we2011.PARAMETERS, name) for name in HEALTH})
    clean.to_parquet(tmp_path / "case_v_clean.parquet")
    add_noise(clean, params.noise).to_parquet(tmp_path / "case_v_noisy.parquet")
    settings = params.model_dump(mode="json")
    settings["identify"]["minutes"] = 1.0
    (problem,) = problems_for(tmp_path, settings, {"case": "noisy-301", "noise_seed": 1}, 2)
    assert problem.sigma == pytest.approx(noise_sigma(clean, params.noise), nan_ok=True)
    assert not np.allclose(problem.sigma, noise_sigma(clean[:301], params.noise), rtol=0.05)


def test_what_is_already_computed_is_said_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from types import SimpleNamespace

    from tasks.ensembles import STEPS
    from tasks.store import Artifact

    context = new_context(tmp_path)
    said: list[str] = []
    monkeypatch.setattr(context.display, "cached", said.append)
    monkeypatch.setattr(Artifact, "from_dict", lambda *_: "artifact")
    future = SimpleNamespace(result=dict)
    pending = run_context.Pending(STEPS["classical"], {"kind": "x"}, future, context, cached=True)
    assert [pending.result(), pending.result()] == ["artifact", "artifact"]
    assert len(said) == 1
    run_context.use(None)


@pytest.mark.parametrize("unit", [None, 0.5])
def test_the_unit_of_x_r_is_changed_where_an_ensemble_names_one(unit: float | None) -> None:
    from dieseltwin.settings.params import load_params
    from tasks.ensembles import _config
    from tasks.settings import own_settings

    settings = load_params(PROJECT / "params.yaml", "paper").model_dump(mode="json")
    what = {"start": "truth", "scale_x_r": unit, "held_out_share": 0.0, "weight_share": 1.0}
    for method in ("few-shot-adam", "baseline"):
        config = _config(own_settings(settings, method), method, what)
        assert config.of(method).scales.x_r == (unit or 0.1)
        assert config.start.at == "truth"


def test_a_variant_starts_where_its_method_starts() -> None:
    from dieseltwin.settings.params import load_params
    from tasks.evaluation_plan import ensembles_of

    settings = load_params(PROJECT / "params.yaml", "paper").model_dump(mode="json")
    settings["identify"]["start"]["at"] = "truth"
    assert {plan.what["start"] for plan in ensembles_of(settings)} == {"truth"}


@pytest.mark.thorough
@pytest.mark.flow
def test_tables_page_and_records_come_out_and_a_second_run_computes_nothing(
    tmp_path: Path, chain: tuple[Path, set[str]]
) -> None:
    from flows.evaluate import evaluate
    from flows.pretrain import pretrain
    from flows.simulate import simulate
    from tasks.tracking import Tracker

    shutil.copytree(chain[0] / ".cache", tmp_path / ".cache")
    write_tiny(tmp_path)
    trained = new_context(tmp_path)
    simulate("tiny")
    pretrain("tiny")
    assert not trained.timings  # what this profile changes is none of theirs
    first = evaluate("tiny")
    results = tmp_path / "evaluation"
    beside = pd.read_csv(results / "beside_paper.csv")
    assert set(beside["method"]) == {"multi-stage", "few-shot-adam", "few-shot-newton", "classical"}
    assert {"0-1", "1-2"} == set(beside["minute"])
    members = pd.read_parquet(results / "ensembles" / "noisy-301-multi-stage" / "members.parquet")
    assert len(members) == 1 * 3 * 4  # the first minute is the baseline's
    assert sorted(members["member"].unique()) == [0, 1, 2]
    three = json.loads(
        (results / "ensembles" / "noisy-301-classical-three_sensors" / "ensemble.json").read_text(encoding="utf-8")
    )
    assert three["channels"] == ["p_im_pa", "p_em_pa", "omega_t_rad_s"]
    page = (tmp_path / "reports" / "evaluation" / "evaluation.html").read_text(encoding="utf-8")
    assert "0.9699 ± 0.0653" in page  # the paper's first noisy few-shot cell
    assert "<img" in page and "Traceback" not in page
    operators = pd.read_csv(results / "operators.csv")
    assert (operators["trainings"] == 1).all() and operators["mean"].notna().all()
    client = Tracker(Workspace(tmp_path)).client
    runs = client.search_runs([client.get_experiment_by_name("evaluate").experiment_id])
    names = {run.info.run_name for run in runs}
    last = pd.read_parquet(results / "ensembles" / "noisy-301-multi-stage-last_epoch" / "members.parquet")
    assert (last["member"] == members["member"]).all()
    assert ((last["ratio"] / members["ratio"] - 1.0).abs() > 1e-5).any()
    assert {"last epoch", "early stopping"} <= set(pd.read_csv(results / "variants.csv")["variant"].dropna())
    assert {"tables", "classical noisy-301", "few-shot-adam noisy-301 early stopping"} <= names

    context = new_context(tmp_path)
    assert evaluate("tiny") == first
    assert not context.timings

    evaluate("tiny", ["noisy-301-classical"])
    assert pd.read_csv(tmp_path / "evaluation-part" / "cells.csv")["method"].unique().tolist() == ["classical"]
    assert {path.name for path in (results / "ensembles").iterdir()} > {"noisy-301-classical"}
    run_context.use(None)
