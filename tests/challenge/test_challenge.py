"""Make, run, seal and score with a tool that only pretends: what is counted, and that nothing is peeked at."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dieseltwin.challenge import metrics, records
from dieseltwin.challenge.cases import HEALTH_SPREAD, make_plans
from dieseltwin.challenge.make import make_challenge
from dieseltwin.challenge.metrics import Share
from dieseltwin.challenge.plant_effects import FAMILIES
from dieseltwin.challenge.records import CaseRow, SaidEffect, Scoring, TrueEffect, case_row, oracle_row
from dieseltwin.challenge.run import RESULTS, read_manifest, run_challenge
from dieseltwin.challenge.score import score_challenge, verified_answers, write_score
from dieseltwin.challenge.seal import SEALED
from dieseltwin.challenge.table import lines
from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.curves import Curves, Discovery
from dieseltwin.discovery.verdict.document import Discrepancy
from dieseltwin.engine import HEALTH, EngineParameters, we2011
from dieseltwin.engine.engine_files import load_engine
from dieseltwin.errors import InputError
from dieseltwin.recordings.reader import Recording

LABORATORY = {name: float(getattr(we2011.PARAMETERS, name)) for name in HEALTH}


def pretended(recording: Recording, engine: EngineParameters, **options: Any) -> Discovery:
    """Says boost_leak of every recording with a mean boost above 1.35 bar, and nothing of others."""
    alarm = bool(recording.columns["p_im_pa"].mean() > 1.35e5)
    effect = {"name": "boost_leak", "probability": 0.9, "equivalent_names": ["compressor_flow_loss"], "law": "A",
              "magnitude": 2e-5, "std": 1e-6, "unit": "m2", "valid_for": None, "split_by": None}  # fmt: skip
    document = Discrepancy.model_validate({
        "schema": 1,
        "recording": {"path": "r.csv", "sha256": recording.sha256, "duration_s": recording.duration_s,
                      "channels": ["p_im_pa"]},
        "mismatch": alarm, "p_value": 1e-6 if alarm else 0.4,
        "location": {"site": "intake_mass_balance", "probability": 0.9, "alternatives": [], "regions": [],
                     "onset_s": None} if alarm else None,
        "effects": [effect] if alarm else [],
        "health": {name: {"value": LABORATORY[name] * 1.01, "std": None, "before": LABORATORY[name] * 1.1}
                   for name in HEALTH},
        "fit": {"held_out_nll_before": None, "held_out_nll_after": None, "chi2_per_sample_before": None,
                "chi2_per_sample_after": None, "rmse_before": {}, "rmse_after": {}},
        "minimum_detectable": {},
        "provenance": {"code_version": "0", "params_sha256": "0" * 64},
    })  # fmt: skip
    n = recording.time_s.size
    curves = Curves(recording.time_s, ("p_im_pa",), *(np.zeros((n, 1)) for _ in range(3)), np.ones(1),
                    (np.zeros(1), np.zeros(1)), {}, np.zeros(n))  # fmt: skip
    return Discovery(document, engine.replace(eta_sc=1.05), engine, curves)


def failing(recording: Recording, engine: EngineParameters, **options: Any) -> Discovery:
    raise RuntimeError("no convergence")


CHEAP = Scoring(
    held_out_nll=lambda engine, recording: 2.0, fit_oracle=lambda recording, engine, terms: engine,
    separability=lambda recording, engine, term: {}, law_error=lambda result, clean, fault, health: None,
    error_of=lambda terms, clean, fault, health: 0.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("challenge") / "made"
    make_challenge(out, 4, 3, duration_s=60.0)
    return out


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Iterator[Path]:
    shutil.copytree(made, tmp_path / "challenge")
    yield tmp_path / "challenge"


def test_the_mix_is_the_designs() -> None:
    plans = make_plans(200, 1)
    counts = {kind: sum(plan.kind == kind for plan in plans) for kind in ("healthy", "withheld", "two", "partial")}
    assert counts == {"healthy": 50, "withheld": 30, "two": 30, "partial": 30}
    assert any(plan.route == "unstable" for plan in plans if plan.kind == "healthy")
    for plan in plans:
        known = [e for e in plan.effects if FAMILIES[e].catalogued]
        assert plan.withhold and (bool(set(known) & set(plan.withhold)) == (plan.kind == "withheld" and bool(known)))
    assert all(plan.kind == "healthy" for plan in make_plans(20, 1, healthy_only=True))
    assert not any("w_c_gain" in (*p.effects, *p.withhold) for p in make_plans(300, 2, sensors=5))


def test_open_part_tells_nothing(made: Path) -> None:
    manifest = read_manifest(made)
    text = json.dumps(manifest)
    assert "seed_sha256" in manifest and '"seed"' not in text and "kind" not in text and "magnitude" not in text
    cases = {entry["case"] for entry in manifest["cases"]}
    assert {path.name for path in made.iterdir()} == {"manifest.json", "sealed", *cases}
    for entry in manifest["cases"]:
        assert [path.name for path in (made / entry["case"]).iterdir()] == ["recording.csv"]


def test_health_lies_within_its_spread(made: Path) -> None:
    for answers in verified_answers(made, read_manifest(made)):
        for name, spread in HEALTH_SPREAD.items():
            assert abs(answers["health"][name] / LABORATORY[name] - 1.0) <= spread


def test_same_seed_same_recordings(made: Path, tmp_path: Path) -> None:
    again = make_challenge(tmp_path / "again", 4, 3, duration_s=60.0)
    first = read_manifest(made)
    for a, b in zip(first["cases"], again["cases"], strict=True):
        assert a["recording_sha256"] == b["recording_sha256"] and a["withhold"] == b["withhold"]
        assert a["answers_salted_sha256"] != b["answers_salted_sha256"]  # another salt
        answers = [(folder / SEALED / f"{a['case']}.json").read_text() for folder in (made, tmp_path / "again")]
        assert answers[0] == answers[1]
    other = make_challenge(tmp_path / "other", 1, 4, duration_s=60.0)
    assert other["cases"][0]["recording_sha256"] != first["cases"][0]["recording_sha256"]
    with pytest.raises(InputError, match="benchmark already"):
        make_challenge(tmp_path / "again", 4, 3)


def test_tampering_is_seen(folder: Path) -> None:
    manifest = read_manifest(folder)
    verified_answers(folder, manifest)
    for name in (f"{SEALED}/case_0001.json", "case_0002/recording.csv", f"{SEALED}/case_0003_held_out.csv"):
        path = folder / name
        kept = path.read_bytes()
        path.write_bytes(kept.replace(b"0", b"1", 1))
        with pytest.raises(InputError):
            verified_answers(folder, manifest)
        path.write_bytes(kept)
    (folder / SEALED / "salt.hex").write_text("00" * 32)
    with pytest.raises(InputError):
        verified_answers(folder, manifest)


def test_signals_and_seed_are_checked_as_well(folder: Path) -> None:
    manifest = read_manifest(folder)
    with pytest.raises(InputError, match="another seed"):
        verified_answers(folder, manifest | {"seed_sha256": "0" * 64})
    with (folder / SEALED / "case_0001_held_out_clean.parquet").open("ab") as file:
        file.write(b"0")
    with pytest.raises(InputError, match="clean"):
        verified_answers(folder, manifest)
    old = [{key: value for key, value in entry.items() if "clean" not in key} for entry in manifest["cases"]]
    assert len(verified_answers(folder, manifest | {"cases": old})) == 4  # made before these were published


def test_a_changed_reference_is_neither_run_nor_scored(tmp_path: Path) -> None:
    out = tmp_path / "own"
    make_challenge(out, 1, 3, duration_s=60.0, tier="own-engine", reference_min=1.0)
    verified_answers(out, read_manifest(out))
    with (out / "case_0001" / "reference_1.csv").open("a") as file:
        file.write("\n")
    with pytest.raises(InputError, match="reference_1"):
        run_challenge(out, discover=pretended)
    with pytest.raises(InputError, match="reference_1"):
        verified_answers(out, read_manifest(out))


def test_run_goes_on_and_never_opens_the_seal(folder: Path) -> None:
    hidden = folder.with_name("hidden")
    (folder / SEALED).rename(hidden)
    assert run_challenge(folder, limit=1, discover=pretended) == {"done": 1, "failed": 0, "kept": 0, "left": 3}
    kept = (folder / RESULTS / "case_0001" / "discrepancy.json").stat().st_mtime_ns
    assert run_challenge(folder, only=["case_0002"], discover=failing)["failed"] == 1
    assert run_challenge(folder, discover=pretended) == {"done": 3, "failed": 0, "kept": 1, "left": 0}
    assert (folder / RESULTS / "case_0001" / "discrepancy.json").stat().st_mtime_ns == kept
    assert not (folder / RESULTS / "case_0002" / "failed.json").exists()
    runtime = json.loads((folder / RESULTS / "case_0004" / "runtime.json").read_text())
    assert runtime["seconds"] > 0 and runtime["peak_rss_mib"] > 10
    assert load_engine(folder / RESULTS / "case_0004" / "engine.yaml").eta_sc == 1.05
    hidden.rename(folder / SEALED)
    score = score_challenge(folder, scoring=CHEAP)
    assert len(score.rows) == 4 and not score.baselines


def test_a_changed_recording_is_not_run(folder: Path) -> None:
    with (folder / "case_0001" / "recording.csv").open("a") as file:
        file.write("\n")
    with pytest.raises(InputError, match="another content"):
        run_challenge(folder, only=["case_0001"], discover=pretended)


def test_a_case_that_fails_is_a_failure(folder: Path) -> None:
    run_challenge(folder, discover=failing)
    score = score_challenge(folder, scoring=CHEAP)
    assert all("no convergence" in str(row.problem) for row in score.rows)
    out = write_score(score, folder, figures=False)
    assert "no result" in (out / "failures.csv").read_text()


def test_score_uses_the_librarys_functions_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_challenge(folder, discover=pretended)
    calls = []

    def nll(engine: EngineParameters, recording: Recording) -> float:
        calls.append(engine)
        return 2.0 if engine.eta_sc == 1.05 else 5.0

    scoring = replace(CHEAP, held_out_nll=nll)
    answers = verified_answers(folder, read_manifest(folder))
    row = case_row(folder, answers[0], scoring)
    count = len(calls)
    assert (row.nll_before, row.nll_after) == (5.0, 2.0) and count >= 2
    assert case_row(folder, answers[0], scoring) == row and len(calls) == count
    before = folder / RESULTS / answers[0]["case"] / "engine_before.yaml"
    before.write_bytes((before.parent / "engine.yaml").read_bytes())
    assert case_row(folder, answers[0], scoring).nll_before == 2.0
    count = len(calls)
    monkeypatch.setattr(records, "code_sha256", lambda *parts: "another scorer")
    case_row(folder, answers[0], scoring)
    assert len(calls) > count


def test_score_files(folder: Path) -> None:
    run_challenge(folder, discover=pretended)
    out = write_score(score_challenge(folder, scoring=CHEAP), folder)
    document = json.loads((out / "score.json").read_text())
    assert [line["key"] for line in document["lines"]][:3] == ["false_alarms", "detection", "site"]
    said = (out / "score.md").read_text()
    assert "| false alarms, healthy |" in said
    assert "beforehand: seed, answers, recordings, second recordings, their clean signals." in said


# hand-made rows with known figures


def true(name: str = "boost_leak", ratio: float = 5.0, nearest: tuple[str, float] | None = ("x", 20.0)) -> TrueEffect:
    family = FAMILIES[name]
    return TrueEffect(name, family.site, family.tolerance * ratio, ratio, family.catalogued, nearest)


def row(case: str, *effects: TrueEffect, kind: str = "single", **values: Any) -> CaseRow:
    health = dict.fromkeys(HEALTH, 1.0)
    defaults: dict[str, Any] = {
        "health_true": health, "health_before": dict.fromkeys(HEALTH, 1.2), "health_after": dict.fromkeys(HEALTH, 1.01),
        "site": effects[0].site if effects else None, "mismatch": bool(effects), "p_value": 0.5,
        "said": tuple(SaidEffect(e.name, (e.name,), e.magnitude * 1.05, e.magnitude * 0.05) for e in effects),
    }  # fmt: skip
    return CaseRow(case, kind, None, "random", effects, ("blow_by",), **(defaults | values))


NONE = SaidEffect("none_of_these", ("none_of_these",), None, None)


@pytest.fixture
def rows() -> list[CaseRow]:
    return [
        row("h1", kind="healthy"),
        row("h2", kind="healthy", mismatch=True, said=(SaidEffect("blow_by", ("blow_by",), 0.01, 0.001),)),
        row("a", true(), nll_before=3.0, nll_after=2.0, nll_oracle=1.9, samples=3000, seconds=10.0),
        row("b", true("bearing_friction"), site="turbine_power", said=(
            SaidEffect("exhaust_leak", ("exhaust_leak", "bearing_friction"), 1e-5, 1e-6),), seconds=30.0),
        row("small", true(ratio=1.5), mismatch=False, site=None, said=()),
        row("missed", true("blow_by", 3.5), mismatch=False, site=None, said=()),
        row("two", true("egr_heating", 4.0), true("w_egr_gain", 2.0), kind="two"),
        row("w1", true("egr_backlash"), kind="withheld", said=(NONE,), law_error=0.05),
        row("w2", true("boost_leak", nearest=("y", 3.0)), kind="withheld", said=(
            SaidEffect("compressor_flow_loss", ("compressor_flow_loss",), 0.02, 0.001),)),
        row("none", true("exhaust_leak"), said=(NONE,)),
    ]  # fmt: skip


def test_counts_of_the_table(rows: list[CaseRow]) -> None:
    assert metrics.false_alarms(rows) == Share(1, 2)
    assert metrics.detection(rows) == Share(6, 7)
    assert metrics.sites(rows) == Share(5, 7)
    assert metrics.names_in_set(rows) == Share(3, 5)  # a, b, two's first; not the missed one, not `none`
    assert metrics.mean_set_size(rows) == pytest.approx((1 + 2 + 1 + 1) / 4)
    assert metrics.top_names(rows) == Share(1, 4)  # a of a, b, missed, none
    assert metrics.top_names(rows, any_size=True) == Share(1, 5)
    assert metrics.withheld_none(rows) == Share(1, 2)
    assert metrics.withheld_none(rows, separable_only=True) == Share(1, 1)
    assert metrics.false_none(rows) == Share(1, 6)
    assert metrics.laws(rows) == Share(1, 1)
    assert metrics.oracle_laws(rows) == Share(0, 0)


def test_the_oracles_law_stands_beside_the_law(rows: list[CaseRow]) -> None:
    far = {"kind": "withheld", "said": (NONE,)}
    told = [
        *rows, row("w3", true("boost_leak"), law_error=0.26, oracle_law_error=0.11, **far),
        row("w4", true("boost_leak"), law_error=0.2, oracle_law_error=0.02, **far),
    ]  # fmt: skip
    assert metrics.laws(told) == Share(1, 3)
    assert metrics.oracle_laws(told) == Share(1, 2)
    assert metrics.laws_where_oracle(told) == Share(1, 2)
    line = next(one for one in lines(told) if one.key == "law")
    assert line.value.endswith("the oracle's law 1/2") and line.numbers["oracle_hits"] == 1
    details = [f["detail"] for f in metrics.failures(told) if f["failure"] == "no law within 10 %"]
    assert details == ["26 % off; the oracle 11 %", "20 % off; the oracle 2 %"]
    assert metrics.magnitude_errors(rows) == pytest.approx([0.05, 0.05])
    assert metrics.coverage(rows) == Share(2, 2)
    values, small = metrics.gains(rows)
    assert values == pytest.approx([1.0 / 1.1]) and small == 0
    bias = metrics.health_bias(rows)
    assert bias is not None and bias.before == pytest.approx(0.2) and bias.factor == pytest.approx(20.0)
    assert metrics.times(rows).tolist() == [10.0, 30.0]


def test_every_failure_is_listed_by_kind(rows: list[CaseRow]) -> None:
    found = [(f["case"], f["failure"]) for f in metrics.failures(rows)]
    assert set(found) == {
        ("h2", "false alarm"), ("b", "wrong site"), ("b", "separable, another name first"), ("missed", "missed"),
        ("w2", "withheld, named all the same"), ("none", "false none"), ("none", "name not in the set"),
        ("none", "separable, another name first"),
    }  # fmt: skip


def test_a_wrong_magnitude_is_a_failure() -> None:
    wrong = row("a", true(), said=(SaidEffect("boost_leak", ("boost_leak",), 4e-5, 1e-6),))
    assert [f["failure"] for f in metrics.failures([wrong])] == ["magnitude off by over 30 %"]
    assert metrics.coverage([wrong]) == Share(0, 1)


def test_no_result_counts_against_the_tool() -> None:
    nothing = row("a", true(), problem="crash", mismatch=False, site=None, said=(), health_after={})
    assert metrics.detection([nothing]) == Share(0, 1) and metrics.names_in_set([nothing]) == Share(0, 1)
    assert metrics.health_bias([nothing]) is None
    assert metrics.false_alarms([row("h", kind="healthy", problem="crash")]) == Share(1, 1)


def test_oracle_stands_beside(rows: list[CaseRow]) -> None:
    told = replace(rows[2], oracle_health=dict.fromkeys(HEALTH, 1.002), oracle_magnitudes={"boost_leak": 2.02e-5})
    answer = oracle_row(told)
    assert answer.nll_after == 1.9 and metrics.gains([answer])[0] == pytest.approx([1.0])
    assert metrics.magnitude_errors([answer]) == pytest.approx([0.01])


def test_exact_intervals() -> None:
    assert Share(0, 75).interval == pytest.approx((0.0, 0.0480), abs=1e-3)  # Clopper-Pearson tables
    assert Share(5, 10).interval == pytest.approx((0.187, 0.813), abs=1e-3)
    assert Share(0, 0).value is None and str(Share(0, 0)) == "no cases"


def test_cases_that_failed_are_no_success(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    counts = {"done": 3, "failed": 1, "kept": 0, "left": 0}
    monkeypatch.setattr("dieseltwin.challenge.run.run_challenge", lambda folder, **options: counts)
    assert main(["challenge", "run", str(tmp_path)]) == 1
    counts["failed"] = 0
    assert main(["challenge", "run", str(tmp_path)]) == 0


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "c"
    options = ["--duration", "60", "--sensors", "5", "--healthy-only", "--jobs", "1"]
    assert main(["challenge", "make", "--n", "1", "--seed", "5", "--out", str(out), *options]) == 0
    assert "w_c_kg_s" not in (out / "case_0001" / "recording.csv").read_text().splitlines()[0]
    assert main(["challenge", "make", "--n", "1", "--seed", "5", "--out", str(out)]) == 2
    assert main(["challenge", "make", "--n", "1", "--seed", "5", "--out", str(tmp_path / "d"), "--tier", "mian"]) == 2
    assert main(["challenge", "score", str(out)]) == 2
    assert main(["challenge", "run", str(tmp_path)]) == 2
    assert main(["challenge", "run", str(out), "--only", "case_9999"]) == 2
    assert "Traceback" not in capsys.readouterr().err
