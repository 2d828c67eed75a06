"""params.yaml: strict, profiled, hashed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from dieseltwin.errors import InputError
from dieseltwin.sensors import relative_noise
from dieseltwin.settings.evaluation import EvaluationConfig
from dieseltwin.settings.params import Params, default_params_path, load_params, params_sha256
from dieseltwin.settings.strict import did_you_mean, read_mapping


@pytest.fixture
def text(project_root: Path) -> str:
    return (project_root / "params.yaml").read_text(encoding="utf-8")


def changed(folder: Path, text: str, old: str, new: str) -> Path:
    assert text.count(old) >= 1, f"params.yaml no longer holds {old!r}"
    path = folder / "params.yaml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def refusal(path: Path, profile: str = "quick") -> str:
    with pytest.raises(InputError) as error:
        load_params(path, profile)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("profile", ["quick", "paper"])
def test_both_profiles_are_valid(project_root: Path, profile: str) -> None:
    params = load_params(project_root / "params.yaml", profile)
    assert params.profile == profile


def test_the_paper_profile_holds_what_the_paper_prints(project_root: Path) -> None:
    params = load_params(project_root / "params.yaml", "paper")
    assert params.identify.of("few-shot-adam").epochs == 30_000
    assert params.identify.of("few-shot-adam").weights_until_epoch == 20_000
    assert params.identify.runs == 30
    assert params.pretrain.bodies.heads == 240
    assert relative_noise(params.noise) == (0.03, 0.03, 0.01, 0.05, 0.03, 0.03)
    assert params.driving.cases["case_v"].parameters == "field"
    assert params.engine.field_ratios == {"A_egrmax": 1.333, "A_vgtmax": 1.1663, "eta_sc": 0.9179, "h_tot": 1.0}


def test_a_shorter_training_keeps_its_proportions(project_root: Path) -> None:
    paper = load_params(project_root / "params.yaml", "paper").identify
    few_shot = paper.changed("few-shot-adam", **paper.of("few-shot-adam").schedule_of(3000)).of("few-shot-adam")
    assert (few_shot.epochs, few_shot.weights_until_epoch, few_shot.late_from_epoch) == (3000, 2000, 2500)
    stages = paper.changed("multi-stage", **paper.of("multi-stage").schedule_of(3500)).of("multi-stage").stages
    assert [stage.until_epoch for stage in stages] == [1000, 2000, 3000, 3500]


def test_the_quick_profile_is_a_smaller_paper_profile(project_root: Path) -> None:
    quick, paper = (load_params(project_root / "params.yaml", name) for name in ("quick", "paper"))
    assert quick.identify.of("few-shot-adam").epochs < paper.identify.of("few-shot-adam").epochs
    assert quick.driving == paper.driving  # the same data, or the two could not be compared
    assert quick.noise == paper.noise
    assert quick.sha256 != paper.sha256


def test_unknown_key_says_what_was_meant(tmp_path: Path, text: str) -> None:
    message = refusal(changed(tmp_path, text, "segment_s: 60.0", "segmnet_s: 60.0"))
    assert "segmnet_s" in message and "did you mean segment_s?" in message and "identify" in message


def test_unknown_key_at_the_top_level(tmp_path: Path, text: str) -> None:
    assert "did you mean identify?" in refusal(changed(tmp_path, text, "\nidentify:", "\nidentfy:"))


def test_unknown_key_inside_a_named_case(tmp_path: Path, text: str) -> None:
    message = refusal(changed(tmp_path, text, "case_v: {set:", "case_v: {sett:"))
    assert "driving.cases.case_v" in message and "did you mean set?" in message


def test_unknown_key_in_a_profile_names_the_profile(tmp_path: Path, text: str) -> None:
    message = refusal(changed(tmp_path, text, "    {engine: {},", "    {seeed: 3, engine: {},"), "paper")
    assert "profiles.paper" in message and "did you mean seed?" in message


def test_profiles_that_are_no_mapping(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("profiles: 1.0\n", encoding="utf-8")
    assert "got a float; allowed: a mapping" in refusal(path)


def test_missing_key(tmp_path: Path, text: str) -> None:
    assert "identify.segment_s" in refusal(changed(tmp_path, text, "  segment_s: 60.0", "  # segment_s: 60.0"))


@pytest.mark.parametrize("value", ["-1.0", "0.0", "fast", "true", ".nan", ".inf", "[1, 2]"])
def test_value_out_of_range(tmp_path: Path, text: str, value: str) -> None:
    message = refusal(changed(tmp_path, text, "segment_s: 60.0", f"segment_s: {value}"))
    assert "identify.segment_s" in message


def test_a_step_of_the_simulator_beyond_its_stability_is_refused(tmp_path: Path, text: str) -> None:
    message = refusal(changed(tmp_path, text, "step_s: 0.0125", "step_s: 0.3"))
    assert "engine.step_s" in message and "less than or equal to 0.03" in message


def test_key_given_twice_is_refused(tmp_path: Path, text: str) -> None:
    message = refusal(changed(tmp_path, text, "\nseed: ", "\nseed: 1\nseed: "))
    assert "twice" in message and "line" in message


@pytest.mark.parametrize("broken", ["a: [1", "- 1\n- 2", "just words", "\t: x"])
def test_not_a_mapping(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(broken, encoding="utf-8")
    assert str(path) in refusal(path)


def test_no_such_file_and_binary_file(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in refusal(tmp_path / "binary.yaml")


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "params.yaml")
    with pytest.raises(InputError):
        load_params(tmp_path / "params.yaml")


def test_unknown_profile(project_root: Path) -> None:
    assert "did you mean quick?" in refusal(project_root / "params.yaml", "quik")


def test_settings_are_frozen(project_root: Path) -> None:
    params = load_params(project_root / "params.yaml")
    with pytest.raises(ValidationError):
        params.identify.segment_s = 1.0  # type: ignore[misc]


def test_hash_is_of_the_numbers_not_of_the_text(tmp_path: Path, project_root: Path, text: str) -> None:
    same = yaml.safe_load(text)
    reordered = tmp_path / "reordered.yaml"
    reordered.write_text(yaml.safe_dump(same, sort_keys=True), encoding="utf-8")
    original = load_params(project_root / "params.yaml")
    assert load_params(reordered).sha256 == original.sha256 == params_sha256(original)
    other = changed(tmp_path, text, "segment_s: 60.0", "segment_s: 60.5")
    assert load_params(other).sha256 != original.sha256


def test_a_profile_replaces_single_values_only(tmp_path: Path, text: str) -> None:
    path = changed(tmp_path, text, "driving: {}, noise: {},", "driving: {}, noise: {p_im_rel: 0.07},")
    noise = load_params(path, "paper").noise
    assert noise.p_im_rel == 0.07 and noise.p_em_rel == 0.03


FEW = "{name: few, members: 4, "


@pytest.mark.parametrize(
    ("variant", "words"),
    [
        (FEW + "method: multi-stage, scale_x_r: 1.0}", ["scale_x_r", "got 1.0", "few-shot-adam or baseline"]),
        (FEW + "method: multi-stage, held_out_share: 0.1}", ["held_out_share", "multi-stage ignores it"]),
        (FEW + "method: multi-stage, start: truth}", ["start", "multi-stage ignores it"]),
        (FEW + "method: baseline, weight_share: 0.1}", ["weight_share", "with few-shot-adam"]),
        (FEW + "method: baseline, held_out_share: 0.1}", ["held_out_share", "with few-shot-adam"]),
        (FEW + "method: few-shot-newton, scale_x_r: 1.0}", ["scale_x_r", "few-shot-newton ignores it"]),
        (FEW + "method: classical, weight_share: 2.0}", ["weight_share", "classical ignores it"]),
        ("{name: few, method: classical}", ["members", "add this key"]),
        ("{name: few, method: classical, last_epoch: true}", ["last_epoch", "few-shot-adam, multi-stage, baseline"]),
        (FEW + "method: baseline, last_epoch: true}", ["members", "beside last_epoch", "leave it out"]),
        (
            "{name: few, method: few-shot-adam, last_epoch: true, start: lab, scale_x_r: 0.1}",
            ["scale_x_r, start", "beside last_epoch"],
        ),
        ("{name: few, method: multi-stage, members: 31}", ["31 members", "at most the 30 of baseline"]),
        ("{name: '', method: classical, members: 4}", ["name", "at least 1 character"]),
    ],
)
def test_a_variant_with_settings_that_its_method_ignores_is_refused(
    tmp_path: Path, text: str, variant: str, words: list[str]
) -> None:
    wanted = "    - {name: early stopping, method: few-shot-adam, held_out_share: 0.1, members: 30}"
    message = refusal(changed(tmp_path, text, wanted, f"    - {variant}"), "paper")
    assert "evaluation.variants" in message and all(word in message for word in words), message


def evaluation_refusal(project_root: Path, **changes: object) -> str:
    settings = load_params(project_root / "params.yaml", "paper").evaluation.model_dump()
    with pytest.raises(InputError) as error:
        EvaluationConfig.model_validate({**settings, **changes})
    return str(error.value)


def test_equal_names_of_variants_are_refused(project_root: Path) -> None:
    one = {"name": "three sensors", "method": "classical", "members": 3}
    again = {**one, "name": "three_sensors"}  # the same folder
    assert "twice for noisy-301" in evaluation_refusal(project_root, variants=[one, again])
    assert "evaluation.cases" in evaluation_refusal(project_root, cases=["noisy-301", "noisy-301"])
    other = [one, {**one, "method": "few-shot-newton"}, {**one, "cases": ["clean-301"]}]
    settings = load_params(project_root / "params.yaml", "paper").evaluation.model_dump()
    assert len(EvaluationConfig.model_validate({**settings, "variants": other}).variants) == 3


def test_multi_stage_needs_a_source_model_for_each_member(project_root: Path) -> None:
    message = evaluation_refusal(project_root, members={"multi-stage": 4, "classical": 3}, variants=[])
    assert "evaluation.members: multi-stage" in message and "add evaluation.members: baseline" in message
    message = evaluation_refusal(project_root, members={"multi-stage": 4, "baseline": 3}, variants=[])
    assert "got 4 members" in message and "at most the 3 of baseline" in message
    read = {"name": "last epoch", "method": "few-shot-adam", "last_epoch": True}
    message = evaluation_refusal(project_root, members={"classical": 3}, variants=[read])
    assert "last_epoch" in message and "add the method to evaluation.members" in message


def test_the_protocols_rule_for_identifiable_stands_in_the_settings_too(project_root: Path) -> None:
    from dieseltwin.identification.bound import IDENTIFIABLE_BELOW

    for profile in ("quick", "paper", "tiny"):
        settings = load_params(project_root / "params.yaml", profile)
        assert settings.identify.identifiable_bound_rel == IDENTIFIABLE_BELOW


def test_params_of_the_working_folder_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, project_root: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert default_params_path().resolve() == project_root / "params.yaml"
    (tmp_path / "params.yaml").write_text("discover: {}\n", encoding="utf-8")
    assert default_params_path().resolve() == tmp_path / "params.yaml"
    with pytest.raises(InputError, match=r"profiles: got none; allowed: profiles, quick among them.*--params"):
        load_params()
    (tmp_path / "params.yaml").write_text("train: {lr: 0.1}\nseed: 3\n", encoding="utf-8")  # another program's
    assert default_params_path().resolve() == project_root / "params.yaml"


def test_every_number_of_the_file_reaches_the_model(project_root: Path) -> None:
    common = read_mapping(project_root / "params.yaml")
    common.pop("profiles")
    dumped = load_params(project_root / "params.yaml", "paper").model_dump(mode="json")
    assert set(common) | {"profile"} == set(dumped) == set(Params.model_fields)


@pytest.mark.parametrize(
    ("typed", "meant"), [("rnus", "runs"), ("SEED", "seed"), ("noize", "noise"), ("eta_cs", "eta_sc")]
)
def test_did_you_mean(typed: str, meant: str) -> None:
    assert did_you_mean(typed, ["runs", "seed", "noise", "eta_sc", "h_tot"]).startswith(f"did you mean {meant}")


def test_did_you_mean_stays_silent_when_nothing_is_close() -> None:
    assert "did you mean" not in did_you_mean("zzzz", ["runs", "seed"])
