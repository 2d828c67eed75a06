"""The whole chain in the profile ``tiny``: end to end, again, after a kill; DVC's stages name what they rest on."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest
import tiny_settings
import yaml
from tiny_settings import new_context

from dieseltwin import engine
from tasks import discover, identify, pretrain, prove, report, simulate
from tasks.progress import Display
from tasks.run_context import RunContext, Step
from tasks.store import content_hash
from tasks.workspace import PROJECT, Workspace, quiet_settings

# A busy machine: what is tested is what comes out, not when.
pytestmark = pytest.mark.timeout(900)


def steps_of_stages() -> dict[str, tuple[Step, ...]]:
    """What the stages run; Prefect is imported here, not by every process that collects tests."""
    from flows.identify import COMPARED

    return {
        "simulate": (simulate.driving_sets, simulate.case_recordings),
        "pretrain": (pretrain.eta_tm_labels, pretrain.maps, pretrain.operators, pretrain.bodies),
        "identify": (*(identify.STEPS[method] for method in COMPARED), report.comparison),
        "discover": (prove.benchmark, discover.discover),
        "prove": (prove.benchmark, prove.case, prove.opened, prove.bands, prove.baseline, prove.score),
    }


@pytest.mark.flow
def test_the_chain_ends_with_results_report_and_records(chain: tuple[Path, set[str]]) -> None:
    root, ran = chain
    assert {"driving-sets", "recordings", "maps-improved", "operators", "bodies-paper", "identify-few-shot-adam"} <= ran
    metrics = json.loads((root / "results" / "metrics.json").read_text())
    assert set(metrics) == {"classical", "few-shot-newton", "few-shot-adam"}
    # The classical estimator is the same in every profile: a minute of driving gives the areas to a few per cent.
    assert abs(metrics["classical"]["A_vgtmax_error_pct"]) < 5.0
    page = (root / "reports" / "index.html").read_text()
    assert "few-shot-newton" in page or "Few-shot" in page
    assert list((root / "reports" / "figures").glob("*.svg"))
    assert not list((root / "results").rglob("runtime.json"))

    from tasks.tracking import Tracker

    client = Tracker(Workspace(root)).client
    identify = client.get_experiment_by_name("identify")
    runs = client.search_runs([identify.experiment_id])
    names = {run.info.run_name for run in runs}
    assert {"classical", "few-shot-newton", "few-shot-adam", "comparison", "few-shot-adam member 01"} <= names
    classical = next(run for run in runs if run.info.run_name == "classical")
    assert classical.data.metrics["A_egrmax"] == metrics["classical"]["A_egrmax"]
    assert classical.data.metrics["seconds_per_run"] > 0.0
    assert {item.dataset.name for item in classical.inputs.dataset_inputs} == {"field recordings", "models"}
    trained = client.search_runs([client.get_experiment_by_name("pretrain").experiment_id])
    whole = next(run for run in trained if run.info.run_name == "models")
    trained.remove(whole)
    for made in (classical, *trained):
        assert list((root / ".cache").glob(f"*/{made.data.tags['key']}")) and len(made.data.tags["code_digest"]) == 12
        assert len(made.data.tags["mlflow.source.git.commit"]) == 40
    assert {"seed", "noise.label_rel", "engine.step_s"} <= trained[0].data.params.keys()

    # What a run rests on leads to the runs that made it, under the same name.
    data = client.search_runs([client.get_experiment_by_name("simulate").experiment_id])[0]
    for used, makers in ((classical, {"models": whole, "field recordings": data}),
                         (whole, {"laboratory recordings": data})):  # fmt: skip
        shown = {item.dataset.name: item.dataset.digest for item in used.inputs.dataset_inputs}
        assert shown == {name: maker.data.tags[name] for name, maker in makers.items()}
    assert {f"run.{run.info.run_name}": run.info.run_id for run in trained}.items() <= whole.data.tags.items()
    comparison = next(run for run in runs if run.info.run_name == "comparison")
    assert comparison.data.params["params_sha256"] == classical.data.params["params_sha256"]
    assert whole.data.params["params_sha256"] != classical.data.params["params_sha256"]


@pytest.mark.flow
def test_a_second_run_computes_nothing_and_changes_nothing(chain: tuple[Path, set[str]]) -> None:
    from flows.run import run
    from tasks.tracking import Tracker

    root, _ = chain
    client = Tracker(Workspace(root)).client
    experiments = [experiment.experiment_id for experiment in client.search_experiments()]
    before = {name: content_hash(root / name) for name in ("data", "models", "results", "reports")}
    records = len(client.search_runs(experiments))
    context = new_context(root)
    run("tiny")
    assert not context.timings
    assert {name: content_hash(root / name) for name in before} == before
    assert len(client.search_runs(experiments)) == records


@pytest.mark.thorough
@pytest.mark.flow
def test_trained_networks_become_a_version_and_stay_in_use_against_worse_ones(
    chain: tuple[Path, set[str]], tmp_path: Path
) -> None:
    from dieseltwin.surrogates.empirical import EmpiricalMaps
    from flows.promote import promote
    from tasks.registry import CHALLENGER, CHAMPION, NAME, Registry
    from tasks.tracking import Tracker

    for name in ("data", "models", ".cache"):
        shutil.copytree(chain[0] / name, tmp_path / name)
    tiny_settings.write_params(tmp_path)
    registry = Registry(Tracker(Workspace(tmp_path)))
    new_context(tmp_path)
    assert promote("tiny")
    first = registry.version(CHAMPION)
    assert first is not None and first.sha256 == content_hash(tmp_path / "models")
    tests = json.loads((first.folder / "acceptance.json").read_text())
    kinds, asked = ("improved", "paper"), ("balances", "rest", "ranges", "monotony")
    assert [test["name"] for test in tests] == [f"{name}/{kind}" for kind in kinds for name in asked]
    assert all(test["passed"] for test in tests) and all(test["figure"] >= 0.0 for test in tests)
    the_champion_answers(first.folder)
    again = new_context(tmp_path)
    assert promote("tiny") and not again.timings and registry.version(CHAMPION) == first

    from dieseltwin.surrogates.bodies import Bodies

    path = tmp_path / "models" / "bodies_conditioned.pt"
    worse = Bodies.load(path)
    for body in worse.values():
        for weights in body.network.parameters():
            weights.data.mul_(0.1)  # a nearly constant basis
    worse.save(path)
    new_context(tmp_path)
    assert not promote("tiny")
    refused = registry.version(CHALLENGER)
    assert registry.version(CHAMPION) == first and refused is not None and refused.number == 2
    # What today's code can't read doesn't stay in use for ever; the refused ones do better then.
    (first.path / "operators.pt").unlink()
    new_context(tmp_path)
    assert promote("tiny") and registry.version(CHAMPION) == refused

    # A map whose turbine shuts when its vanes open is registered and never promoted.
    path = tmp_path / "models" / "maps_improved.pt"
    maps = EmpiricalMaps.load(path)
    turbine = maps.maps["F_vgt_Pi_t"]
    sign = np.array([-1.0, 1.0])  # of the position, about 55 %
    turned = replace(turbine, centre=[110.0, 0.0] + sign * turbine.centre, scale=sign * turbine.scale)
    replace(maps, maps={**maps.maps, "F_vgt_Pi_t": turned}).save(path)
    new_context(tmp_path)
    assert not promote("tiny")
    broken = registry.version(CHALLENGER)
    assert registry.version(CHAMPION) == refused and broken is not None and broken.number == 3
    tags = registry.client.get_model_version(NAME, "3").tags
    assert tags["acceptance"] == "failed" and "F_vgt,Pi_t over the VGT's position goes the wrong way" in tags["reason"]


def the_champion_answers(folder: Path) -> None:
    """MLflow loads it by its own means, and it simulates what the networks' engine does."""
    import mlflow

    example = json.loads((folder / "serving_input_example.json").read_text())
    model = mlflow.pyfunc.load_model(str(folder), model_config={"compiled": False})
    rows = pd.DataFrame(example["dataframe_split"]["data"], columns=example["dataframe_split"]["columns"]).head(6)
    answer = model.predict(rows)
    assert list(answer) == model.metadata.get_output_schema().input_names()
    laboratory = engine.we2011.PARAMETERS
    exact = engine.simulate(engine.Inputs(*(rows[name].to_numpy() for name in rows)), laboratory, oxygen=False)
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s"):
        assert answer[name].to_numpy() == pytest.approx(exact[name].to_numpy(), rel=0.1)
    narrower = model.predict(rows, params={"A_vgtmax": 0.8 * laboratory.A_vgtmax})
    assert (narrower["p_em_pa"] > answer["p_em_pa"]).all()
    with pytest.raises(mlflow.MlflowException, match=r"time_s.*allowed: strictly increasing"):
        model.predict(rows.iloc[::-1])


@pytest.mark.flow
def test_published_folders_are_made_again_from_the_cache(chain: tuple[Path, set[str]]) -> None:
    """DVC deletes a stage's outs before it runs the stage; and somebody may spoil a file."""
    from flows.simulate import simulate as simulate_flow

    root, _ = chain
    before = content_hash(root / "data")
    shutil.rmtree(root / "data" / "lab")
    (root / "data" / "sets" / "set_i.parquet").write_bytes(b"spoilt")
    context = new_context(root)
    simulate_flow("tiny")
    assert not context.timings
    assert content_hash(root / "data") == before


@pytest.mark.flow
def test_kill_9_in_a_flow_and_again_gives_the_same_hashes(chain: tuple[Path, set[str]], tmp_path: Path) -> None:
    """Killed while two bodies are trained, with its own server; what is whole is kept, the rest is made again."""
    from flows.pretrain import pretrain as pretrain_flow

    root = chain[0]
    undisturbed = content_hash(root / "models")
    for name in ("data", ".cache"):
        shutil.copytree(root / name, tmp_path / name)
    shutil.rmtree(tmp_path / ".cache" / "bodies")
    tiny_settings.write_params(tmp_path)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "MLFLOW_"))}
    environment |= {**quiet_settings(Workspace(tmp_path)), "DIESELTWIN_WORKSPACE": str(tmp_path)}
    command = [sys.executable, "-m", "flows.pretrain", "--profile", "tiny"]
    process = subprocess.Popen(command, cwd=PROJECT, env=environment, stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 180.0
    below: list[psutil.Process] = []
    while len(below) < 2 or not list(tmp_path.glob(".cache/bodies/.partial-*")):  # a folder is there before its worker
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
        below = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "models").exists()
    assert not [path for path in (tmp_path / ".cache" / "bodies").iterdir() if path.name[0] != "."]
    # Workers and server end with their parent.
    _, alive = psutil.wait_procs(below, timeout=30.0)
    assert not [left for left in alive if left.status() != psutil.STATUS_ZOMBIE]
    context = new_context(tmp_path)
    pretrain_flow("tiny")
    assert set(context.timings) == {"bodies-paper", "bodies-conditioned"}
    assert content_hash(tmp_path / "models") == undisturbed


@pytest.mark.flow
@pytest.mark.parametrize("name", ["run", "retrain"])
def test_settings_are_read_once_a_run(
    prefect: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """An edit in the middle of the chain is for the next run."""
    module, chain_module = importlib.import_module(f"flows.{name}"), importlib.import_module("flows.run")
    path = tiny_settings.write_params(tmp_path)
    new_context(tmp_path)
    seen: list[Any] = []

    def flow(profile: str, settings: dict[str, Any]) -> None:
        seen.append(settings)
        path.write_text(path.read_text(encoding="utf-8").replace("seed: 20250", "seed: 1"), encoding="utf-8")

    for part in ("simulate", "pretrain", "identify"):
        monkeypatch.setattr(chain_module, part, flow)
    if name == "retrain":
        monkeypatch.setattr(module, "promote", flow)
    getattr(module, name)("tiny")
    assert len(seen) == (3 if name == "run" else 4)
    assert {settings["seed"] for settings in seen} == {20250}
    assert "seed: 20250" not in path.read_text(encoding="utf-8")


def dvc_stages() -> dict[str, dict[str, Any]]:
    stages: dict[str, dict[str, Any]] = yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    return stages


def file_of(module: str) -> str:
    path = module.replace(".", "/")
    return f"{path}.py" if (PROJECT / f"{path}.py").exists() else f"{path}/__init__.py"


def test_a_stage_depends_on_every_module_and_file_that_its_steps_rest_on() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    for stage, steps in steps_of_stages().items():
        deps = dvc_stages()[stage]["deps"]
        folders = tuple(f"{dep}/" for dep in deps if not dep.endswith(".py"))
        rests_on = {f"tasks/{stage}.py", f"flows/{stage}.py"}
        for step in steps:
            code = step.code(context)
            rests_on |= {file_of(module) for module in code.modules if module.startswith("dieseltwin")}
            files = (path for folder in code.data for path in (PROJECT / folder).iterdir())
            rests_on |= {path.relative_to(PROJECT).as_posix() for path in files}
            rests_on.add(file_of(step.function.__module__))
        missing = sorted(file for file in rests_on if file not in deps and not file.startswith(folders))
        assert not missing, f"{stage}: not among the deps: {missing}"
        assert not any((PROJECT / dep / "params.yaml").exists() for dep in deps), stage
        made = {out for other in dvc_stages().values() for out in other["outs"]}
        assert all((PROJECT / dep).exists() for dep in deps if dep not in made)


def test_stages_find_the_environment_of_the_checkout_or_the_active_one(tmp_path: Path) -> None:
    """`dvc exp run --temp` runs them in a copy without `.venv`, DVC_ROOT names the checkout."""
    variables = yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["vars"]
    said = next(one["python"] for one in variables if "python" in one)
    copy = tmp_path / "checkout" / ".dvc" / "tmp"
    for name, folder in (("own", tmp_path / "checkout" / ".venv" / "bin"), ("active", tmp_path / "bin")):
        folder.mkdir(parents=True)
        (folder / "python").write_text(f"#!/bin/sh\necho {name} $1\n")
        (folder / "python").chmod(0o755)
    copy.mkdir(parents=True)
    for root, name in ((tmp_path / "checkout", "own"), (tmp_path / "elsewhere", "active")):
        environment = {"PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.defpath}", "DVC_ROOT": str(root)}
        command = ("sh", "-c", f"{said} -m")
        ended = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=True)
        assert ended.stdout == f"{name} -m\n"


# What only the pictures in reports/ read, which are no outs of the stage.
ONLY_SHOWN = {"simulate": {"report"}, "identify": {"driving", "report"}}


def sections_read(flow: str) -> set[tuple[str, ...]]:
    """Paths in the settings that the text of a flow reads: ``settings["a"]["b"]`` is (a, b), and names in a loop."""
    calls = {"about": ("seed", "profile"), "own_settings": ("identify", "engine", "noise")}
    found: set[tuple[str, ...]] = set()

    def visit(node: ast.AST, behind: tuple[str, ...] = ()) -> None:
        if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
            visit(node.value, (str(node.slice.value), *behind))
            return
        if isinstance(node, ast.DictComp | ast.GeneratorExp) and "settings[name]" in ast.unparse(node):
            found.update((str(name),) for name in ast.literal_eval(node.generators[0].iter))
        if isinstance(node, ast.Name) and node.id == "settings" and behind:
            found.add(behind)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in calls:
            found.update((section,) for section in calls[node.func.id])
            if node.func.id == "about":
                found.update((section,) for section in ast.literal_eval(node.args[2]))
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse((PROJECT / "flows" / f"{flow}.py").read_text(encoding="utf-8")))
    return found - {("profile",)}


# Values of params.yaml that are no section: no profile replaces them, as DVC wants what a stage names to be there.
COMMON = {"seed"}


def settings_read(stage: str) -> set[tuple[str, ...]]:
    """Paths in the settings that a stage's results rest on: what its flow reads, what its steps look up themselves."""
    read = {path for path in sections_read(stage) if path[0] not in ONLY_SHOWN.get(stage, ())}
    return read | {(name,) for step in steps_of_stages()[stage] for name in step.sections}


def test_a_stage_declares_every_setting_that_its_flow_reads_in_common_and_in_its_profile() -> None:
    for stage in steps_of_stages():
        declared = {str(name) for name in dvc_stages()[stage]["params"]}
        profile = re.search(r"--profile (\S+)", dvc_stages()[stage]["cmd"])
        assert profile is not None
        read = settings_read(stage)
        assert read, stage
        for path in read:
            parents = {".".join(path[:depth]) for depth in range(1, len(path) + 1)}
            assert parents & declared, f"{stage}: {'.'.join(path)} isn't among the params"
            replaced = {f"profiles.{profile.group(1)}.{name}" for name in parents}
            assert path[0] in COMMON or replaced & declared, f"{stage}: {'.'.join(path)} of the profile isn't"
        sections = {path[0] for path in read}
        for name in declared:
            section = name.removeprefix(f"profiles.{profile.group(1)}.").partition(".")[0]
            assert section in sections, f"{stage}: reads nothing of {name}, which runs it again"


def test_every_profile_has_the_sections_that_stages_name() -> None:
    """A parameter that isn't there is an error of DVC's; an empty section changes nothing."""
    profiles = yaml.safe_load((PROJECT / "params.yaml").read_text(encoding="utf-8"))["profiles"]
    named = {path[0] for stage in steps_of_stages() for path in settings_read(stage)} - COMMON
    for name, profile in profiles.items():
        assert named <= set(profile), f"{name}: lacks {sorted(named - set(profile))}"
        assert not COMMON & set(profile), f"{name}: replaces what DVC doesn't compare"


def test_flows_hold_order_only() -> None:
    """No arithmetic, no library, no files: a flow names steps."""
    for path in (PROJECT / "flows").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"^\s*(import|from) (dieseltwin|numpy|pandas|torch)\b", text, flags=re.MULTILINE), path
