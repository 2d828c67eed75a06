"""`dieseltwin discover`: files, lines, explanations; a clear refusal, never a name, where an input can't carry one."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from dieseltwin.cli.app import main
from dieseltwin.discovery import discover as core
from dieseltwin.discovery.verdict import checks
from dieseltwin.discovery.verdict.curves import Discovery
from dieseltwin.discovery.verdict.document import Discrepancy, load_discrepancy
from dieseltwin.engine import Inputs, load_engine, simulate, we2011
from dieseltwin.engine.effects import EFFECTS, SITES
from dieseltwin.engine.map_corrections import basis
from dieseltwin.engine.terms import Term, with_corrections
from dieseltwin.recordings.reader import Recording, recording
from dieseltwin.report import discovery_page

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "report"))
import synthetic_discovery as synthetic

from tests.api.simulated import NOISE, drive

SENSORS = list(NOISE)
Run = Callable[..., tuple[int, list[str], str]]


@dataclass
class FakeCore:
    """Stands where discovery stands: hands out a made-up result, and counts how often it is asked."""

    document: dict[str, Any]
    smallest: dict[str, float]
    asked: int = 0
    options: Any = None

    def prepare(self, source: Recording, engine: Any, options: Any, known: Any = None) -> Any:
        self.options = options
        return SimpleNamespace(minimum_detectable=self.smallest, health_bias={"boost_leak": {"h_tot": 0.011}})

    def discover(self, source: Recording, engine: Any, options: Any, known: Any = None, prepared: Any = None,
                 time_s: float | None = None, shown: Any = None) -> Discovery:  # fmt: skip
        self.asked += 1
        about = {"path": str(source.path), "sha256": source.sha256, "duration_s": source.duration_s,
                 "channels": list(options.sensors)}  # fmt: skip
        found = synthetic.discovery(Discrepancy.model_validate({**self.document, "recording": about}), n=450)
        terms = tuple(
            Term(effect=e.name, magnitude=e.magnitude, std=e.std)
            for e in found.document.effects
            if e.named and e.magnitude is not None
        )
        return replace(found, engine=found.engine.replace(terms=terms))


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeCore:
    stand_in = FakeCore(synthetic.content(), synthetic.MINIMUM)
    monkeypatch.setattr(core, "prepare", stand_in.prepare)
    monkeypatch.setattr(core, "discover", stand_in.discover)
    return stand_in


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes five seconds and has tests of its own."""
    monkeypatch.setattr(discovery_page, "build_discovery_report", lambda *_, **__: None)


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    def runner(*arguments: str | Path) -> tuple[int, list[str], str]:
        capfd.readouterr()
        code = main(["discover", *(str(a) for a in arguments)])
        said = capfd.readouterr()
        return code, said.out.splitlines(), said.err

    return runner


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return drive(90.0)


@pytest.fixture(scope="module")
def csv(table: pd.DataFrame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    table.to_csv(path, index=False)
    return path


def test_files_and_lines(run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    out = tmp_path / "found"
    code, lines, error = run(csv, "--out", out, "--withhold", "blow_by,vgt_offset", "--seed", "3")
    assert code == 0 and error == ""
    assert {p.name for p in out.iterdir()} == {
        "discrepancy.json", "details.json", "report.html", "figures", "implied.parquet", "engine.yaml", "runtime.json",
    }  # fmt: skip
    # what could be seen comes first, then the sentence
    first = next(i for i, line in enumerate(lines) if line.startswith("this recording could show"))
    told = next(i for i, line in enumerate(lines) if line.startswith("The twin leaves out"))
    assert first < told and any("boost_leak" in line and "2.6 mm²" in line and "4.0 mm²" in line for line in lines)
    assert any("vgt_dead_time" in line and "8 x tolerance" in line for line in lines)
    assert fake.options.withhold == ("blow_by", "vgt_offset") and fake.options.seed == 3
    assert fake.options.map_tolerance == 0.003 and fake.options.sensors == tuple(SENSORS)
    document = load_discrepancy(out)
    assert document.effects[0].name == "boost_leak"
    repaired = load_engine(out / "engine.yaml")
    assert repaired.terms[0].effect == "boost_leak" and repaired.eta_sc == document.health["eta_sc"].value
    implied = pd.read_parquet(out / "implied.parquet")
    assert {"p_es_pa", "p_bc_pa", "t_im_k", "w_leak_im_kg_s", "w_leak_im_kg_s_std", "p_friction_w"} <= set(implied)
    assert len(implied) == 451 and implied["w_leak_im_kg_s"].median() > 0.005
    relative = (implied["w_leak_im_kg_s_std"] / implied["w_leak_im_kg_s"]).median()
    assert relative == pytest.approx(2e-6 / 4.1e-5, rel=0.01)  # the leak is proportional to its area
    runtime = json.loads((out / "runtime.json").read_text())
    assert runtime["seconds"] > 0 and runtime["name_s"] == 7.5
    assert len(list((out / "figures").glob("*.svg"))) == 10


@pytest.mark.usefixtures("no_page")
def test_explain_from_the_run_and_from_the_folder(run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    out = tmp_path / "found"
    code, lines, _ = run(csv, "--out", out, "--explain", "boost_leak", "--withhold", "blow_by")
    assert code == 0 and fake.asked == 1 and "why: chosen: largest gain" in lines
    code, lines, _ = run("--out", out, "--explain", "exhaust_leak")
    text = "\n".join(lines)
    assert code == 0 and fake.asked == 1 and "why: gains 211 less than boost_leak" in text
    assert "211.0 behind the best (boost_leak)" in text and "not chosen" in text
    for name, says in (
        ("compressor_efficiency_loss", "not told apart from boost_leak"),
        ("p_im_offset", "too small for a refit"),
        ("egr_heating", "not weighed"),
        ("blow_by", "--withhold"),
        ("none_of_these", "an effect of the catalogue fits"),
    ):
        assert says in "\n".join(run("--out", out, "--explain", name)[1])
    # the same question isn't computed again, another one is
    assert run(csv, "--out", out, "--explain", "boost_leak", "--withhold", "blow_by")[0] == 0 and fake.asked == 1
    assert run(csv, "--out", out, "--explain", "boost_leak", "--seed", "1")[0] == 0 and fake.asked == 2


@pytest.mark.usefixtures("no_page")
def test_what_decides_comes_from_the_settings(
    run: Run, fake: FakeCore, csv: Path, tmp_path: Path, project_root: Path
) -> None:
    """Another threshold is another question: what was answered with the old one is no answer to it."""
    text = (project_root / "params.yaml").read_text(encoding="utf-8")
    for old, new in (("alarm_gain: 18.0", "alarm_gain: 40.0"), ("map_tolerance: 0.003", "map_tolerance: 0.01")):
        text = text.replace(old, new, 1)
    params = tmp_path / "other.yaml"
    params.write_text(text, encoding="utf-8")
    asked = (csv, "--out", tmp_path / "found", "--explain", "boost_leak")
    assert run(*asked)[0] == 0 and fake.asked == 1
    assert fake.options.settings().alarm_gain == 18.0
    assert run(*asked, "--params", params)[0] == 0 and fake.asked == 2
    assert fake.options.settings().alarm_gain == 40.0 and fake.options.map_tolerance == 0.01
    assert run(*asked, "--params", params)[0] == 0 and fake.asked == 2


@pytest.mark.usefixtures("no_page")
def test_healthy_and_five_sensors(run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    fake.document = synthetic.healthy_content()
    code, lines, _ = run(csv, "--out", tmp_path / "o", "--sensors", ",".join(SENSORS[:5]))
    assert code == 0 and any(line.startswith("Nothing is missing that this recording could show") for line in lines)
    assert fake.options.sensors == tuple(SENSORS[:5])
    document = load_discrepancy(tmp_path / "o")
    assert document.effects == () and document.location is None
    lines = run("--out", tmp_path / "o", "--explain", "boost_leak")[1]
    assert any("no mismatch beyond noise" in line for line in lines)
    lines = run("--out", tmp_path / "o", "--explain", "w_c_gain")[1]
    assert any("sensor w_c_kg_s was not used" in line for line in lines)


@pytest.mark.usefixtures("no_page")
def test_the_real_thing_on_a_leak(run: Run, tmp_path: Path) -> None:
    """One run of the real core: a large leak in an exact engine is named, sized and repaired."""
    leaking = we2011.PARAMETERS.replace(terms=(Term(effect="boost_leak", magnitude=6e-5),))
    drive(150.0, engine=leaking).to_csv(tmp_path / "drive.csv", index=False)
    out = tmp_path / "found"
    code, lines, error = run(tmp_path / "drive.csv", "--out", out)
    assert code == 0 and error == ""
    document = load_discrepancy(out)
    assert document.mismatch and document.location is not None and document.location.site in SITES
    assert "boost_leak" in document.effects[0].names
    repaired = load_engine(out / "engine.yaml")
    assert repaired.terms[0].effect == document.effects[0].name
    if document.effects[0].name == "boost_leak":
        assert repaired.terms[0].magnitude == pytest.approx(6e-5, rel=0.2)
    assert any("boost leak" in line for line in lines)
    assert len(pd.read_parquet(out / "implied.parquet")) == 751


REFUSED: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "20 s": (lambda t: t[t.time_s <= 20.0], "20 s of running engine; allowed: 60 s or more"),
    "missing sensor": (lambda t: t.drop(columns="t_em_k"), "column t_em_k: got none"),
    "constant sensor": (lambda t: t.assign(p_em_pa=2.1e5), "column p_em_pa: got constant (210000 in every row)"),
    "status word": (lambda t: t.assign(w_egr_kg_s=np.where(t.time_s % 2 < 1, 0.0, 0.1)), "only 2 different readings"),
    "silent sensor": (lambda t: t.assign(t_em_k=t.t_em_k.where(t.time_s < 20)), "a reading in 22 % of the rows"),
    "no excitation": (lambda t: drive(90.0, still=True), "not enough excitation"),
    "one input": (lambda t: t.assign(n_e_rpm=1300.0, u_egr_pct=20.0, u_vgt_pct=50.0), "not enough excitation"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_bad_recordings_are_one_line_and_no_name(
    kind: str, run: Run, fake: FakeCore, table: pd.DataFrame, tmp_path: Path
) -> None:
    change, says = REFUSED[kind]
    path, out = tmp_path / "bad.csv", tmp_path / "found"
    change(table).to_csv(path, index=False)
    code, lines, error = run(path, "--out", out)
    assert code == 2 and lines == [] and says in error
    assert error.count("\n") == 1 and "Traceback" not in error and "allowed:" in error
    assert not out.exists() and fake.asked == 0


@pytest.mark.parametrize(("displacement", "columns"), [(0.0064, 6), (0.0064, 5), (0.021, 6)])
def test_engine_file_of_another_engine(
    displacement: float, columns: int, run: Run, fake: FakeCore, csv: Path, tmp_path: Path
) -> None:
    engine = tmp_path / "engine.yaml"
    engine.write_text(yaml.safe_dump({"V_d": displacement}))
    table = pd.read_csv(csv)
    path = tmp_path / "drive.csv"
    table.drop(columns=SENSORS[columns:]).to_csv(path, index=False)
    code, lines, error = run(path, "--out", tmp_path / "o", "--engine", engine)
    assert code == 2 and lines == [] and fake.asked == 0 and not (tmp_path / "o").exists()
    assert f"V_d {1e3 * displacement:.4g} l" in error and "breathes" in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--sensors", "p_im_pa,p_em"], "unknown name 'p_em'"),
        (["--sensors", "p_im_pa,p_em_pa"], "3 or more"),
        (["--sensors", ","], "no name"),
        (["--withhold", "boost_lek"], "did you mean boost_leak"),
        (["--map-tolerance", "0.5"], "0 to 0.05"),
        (["--map-tolerance", "nan"], "0 to 0.05"),
        (["--seed", "-1"], "0 or more"),
        (["--time", "0"], "a positive number of seconds"),
        (["--explain", "boost_lek"], "did you mean boost_leak"),
        (["--engine", "nowhere.yaml"], "no such file"),
    ],
)
def test_bad_options(arguments: list[str], says: str, run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    code, lines, error = run(csv, "--out", tmp_path / "o", *arguments)
    assert code == 2 and lines == [] and says in error and error.count("\n") == 1
    assert fake.asked == 0 and not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    "option", [("--map-tolerance", "0.01"), ("--explain", "blow_by")],
)
def test_options_without_effect_on_settled_points_are_refused(
    option: tuple[str, str], run: Run, fake: FakeCore, csv: Path, tmp_path: Path
) -> None:
    points = tmp_path / "points.csv"
    pd.read_csv(csv).drop(columns="time_s").to_csv(points, index=False)
    code, _, error = run(points, "--out", tmp_path / "o", *option)
    assert code == 2 and option[0] in error and "settled points" in error
    assert not (tmp_path / "o").exists()


def test_a_negative_seed_is_refused_for_settled_points(run: Run, csv: Path, tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    pd.read_csv(csv).drop(columns="time_s").to_csv(points, index=False)
    code, _, error = run(points, "--out", tmp_path / "o", "--seed", "-1")
    assert code == 2 and "--seed: got -1; allowed: 0 or more" in error


def test_no_recording_and_nothing_to_explain(run: Run, fake: FakeCore, tmp_path: Path) -> None:
    code, _, error = run("--out", tmp_path / "o")
    assert code == 2 and "name the recording" in error
    code, _, error = run("--out", tmp_path / "o", "--explain", "boost_leak")
    assert code == 2 and "no such file" in error
    (tmp_path / "details.json").write_text("{}")
    code, _, error = run("--out", tmp_path, "--explain", "boost_leak")
    assert code == 2 and "other content" in error


def test_a_verdict_that_is_no_fit_is_not_given(run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    fit = {**synthetic.content()["fit"], "chi2_per_sample_after": 64.0}
    fake.document = synthetic.content(fit=fit)
    code, lines, error = run(csv, "--out", tmp_path / "o")
    assert code == 2 and "8 times the noise after every repair" in error and not (tmp_path / "o").exists()
    assert not any("leaves out" in line for line in lines)
    health = {**synthetic.content()["health"], "eta_sc": {"value": 2.6, "std": 0.01, "before": 2.6}}
    fake.document = synthetic.content(health=health)
    assert "eta_sc at 2.4 times the file's value" in run(csv, "--out", tmp_path / "o")[2]


def test_a_recording_that_could_show_nothing(run: Run, fake: FakeCore, csv: Path, tmp_path: Path) -> None:
    fake.smallest = {name: 2.0 * max(map(abs, effect.limits)) for name, effect in EFFECTS.items()}
    code, _, error = run(csv, "--out", tmp_path / "o")
    assert code == 2 and "no effect that could be seen" in error and fake.asked == 0


def test_notes_on_what_is_doubtful(table: pd.DataFrame) -> None:
    stuck = table.assign(p_im_pa=table.p_im_pa.where((table.time_s < 20) | (table.time_s > 60), 1.5e5))
    read = recording(stuck)
    assert any("p_im_pa stands still from 20 to 60 s" in note for note in read.notes)
    used, notes = checks.check_recording(read, we2011.PARAMETERS)
    assert used == tuple(SENSORS)
    assert any("most limits would be lower" in note for note in notes)
    wrong = we2011.PARAMETERS.replace(V_d=1.2 * we2011.PARAMETERS.V_d)
    notes = checks.check_recording(recording(table), wrong)[1]
    assert any("the engine breathes 8" in note for note in notes)
    # of a learned engine, whose reference breathed so as well
    learned = wrong.replace(terms=with_corrections((), np.zeros(len(basis().names))))
    assert not any("breathes" in note for note in checks.check_recording(recording(table), learned)[1])


@pytest.mark.parametrize("columns", [6, 5])
def test_air_balance_finds_the_displacement_and_forgives_a_leak(columns: int, table: pd.DataFrame) -> None:
    source = recording(table.drop(columns=SENSORS[columns:]))
    for factor in (0.7, 1.0, 1.5):
        engine = we2011.PARAMETERS.replace(V_d=we2011.PARAMETERS.V_d / factor)
        assert checks.air_balance(source, engine) == pytest.approx(factor, rel=0.05)
    leaking = we2011.PARAMETERS.replace(terms=(Term(effect="boost_leak", magnitude=1e-4),))
    inputs = Inputs(*(table[c].to_numpy() for c in ("time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")))
    leak = recording(simulate(inputs, leaking, oxygen=False)[["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct",
                                                             "u_vgt_pct", *SENSORS[:columns]]])  # fmt: skip
    checks.check_engine(leak, we2011.PARAMETERS)
    assert checks.air_balance(recording(table.drop(columns=["w_egr_kg_s", *SENSORS[columns:]]), sensors=()),
                              we2011.PARAMETERS) is None  # fmt: skip
