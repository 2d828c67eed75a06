"""`dieseltwin learn` from the command line: what it refuses at once, and a learned engine in the other commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.api.watch import _known_sha256
from dieseltwin.challenge.map_errors import MapErrors
from dieseltwin.challenge.plant import run_plant
from dieseltwin.challenge.plant_effects import Fault
from dieseltwin.challenge.routes import draw_driving
from dieseltwin.challenge.sensors import SensorSet, read
from dieseltwin.cli.app import main
from dieseltwin.engine import we2011
from dieseltwin.engine.terms import Term
from dieseltwin.learning.files import load_learned, save_learned

pytestmark = pytest.mark.usefixtures("no_pictures")
LABORATORY = we2011.PARAMETERS.model_dump()


def _recorded(seed: int, faults: tuple[Fault, ...] = (), duration_s: float = 120.0, **worn: float) -> pd.DataFrame:
    maps, sensors = MapErrors.draw(0.02, np.random.default_rng(5)), SensorSet.perfect()
    driving = draw_driving("random", duration_s, LABORATORY, np.random.default_rng(seed))
    engine = LABORATORY | {name: LABORATORY[name] * share for name, share in worn.items()}
    rng = np.random.default_rng([seed, 1])
    return read(run_plant(driving, engine, faults, maps), driving, faults, sensors, 6, rng)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A learned engine, its reference, and a later recording with a large leak and a worn turbine."""
    folder = tmp_path_factory.mktemp("learned")
    _recorded(1).to_csv(folder / "healthy.csv", index=False)
    _recorded(2, (Fault("boost_leak", 8e-5),), A_vgtmax=0.9).to_csv(folder / "new.csv", index=False)
    assert main(["learn", str(folder / "healthy.csv"), "--out", str(folder / "mine.yaml")]) == 0
    return folder


def test_a_leak_is_found_beside_learned_maps(folder: Path):
    out = folder / "found"
    assert main(["discover", str(folder / "new.csv"), "--engine", str(folder / "mine.yaml"), "--out", str(out)]) == 0
    document = json.loads((out / "discrepancy.json").read_text())
    assert "boost_leak" in [document["effects"][0]["name"], *document["effects"][0]["equivalent_names"]]
    assert document["reference"]["recordings"] == 1 and document["reference"]["minutes"] == pytest.approx(2.0, abs=0.1)
    since = document["health"]["A_vgtmax"]["since_reference"]
    assert abs(since["value"] - 0.9) < 4.0 * since["std"] < 0.1
    repaired, mine = load_learned(out / "engine.yaml"), load_learned(folder / "mine.yaml")
    assert repaired is not None and mine is not None and repaired.found and not mine.found
    assert repaired.engine.A_vgtmax == document["health"]["A_vgtmax"]["value"]
    assert (out / "engine.learned.parquet").read_bytes() == (folder / "mine.learned.parquet").read_bytes()


def test_an_engine_with_a_fault_is_no_reference(folder: Path, capsys: pytest.CaptureFixture[str]):
    known = load_learned(folder / "mine.yaml")
    assert known is not None
    leaking = known.engine.replace(terms=(*known.engine.terms, Term(effect="boost_leak", magnitude=3e-5)))
    save_learned(replace(known, repaired=leaking), folder / "leaking.yaml")
    new, leaking_file = str(folder / "new.csv"), str(folder / "leaking.yaml")
    for command in (["learn", new, "--engine", leaking_file, "--out", str(folder / "more.yaml")],
                    ["discover", new, "--engine", leaking_file, "--reference", str(folder / "healthy.csv"), "--out",
                     str(folder / "no")]):  # fmt: skip
        assert main(command) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "leaking.yaml, repaired by boost_leak" in said
    assert _known_sha256(replace(known, repaired=leaking)) != _known_sha256(known)  # a history of its own


def test_the_reference_itself_is_not_judged(folder: Path, capsys: pytest.CaptureFixture[str]):
    code = main(["discover", str(folder / "healthy.csv"), "--engine", str(folder / "mine.yaml"), "--out",
                 str(folder / "same")])  # fmt: skip
    assert code == 2 and "in the reference" in capsys.readouterr().err
    assert not (folder / "same").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "mine.txt"], ".yaml"),
        (["--out", "mine.yaml", "--map-error", "0.5"], "0.001 to 0.1"),
    ],
)
def test_wrong_options_are_refused(
    folder: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(folder)
    assert main(["learn", "healthy.csv", *arguments]) == 2
    assert said in capsys.readouterr().err


def test_idling_alone_teaches_nothing(tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]):
    frame = pd.read_csv(folder / "healthy.csv").iloc[:351]  # 70 s: long enough for a reference
    frame["n_e_rpm"], frame["u_delta_mg"] = 600.0, 15.0
    frame.to_csv(tmp_path / "idle.csv", index=False)
    assert main(["learn", str(tmp_path / "idle.csv"), "--out", str(tmp_path / "mine.yaml")]) == 2
    assert not (tmp_path / "mine.yaml").exists()
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.thorough
def test_a_fault_in_the_reference_is_said(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    _recorded(3, (Fault("boost_leak", 1e-4),), 80.0).to_csv(tmp_path / "faulty.csv", index=False)
    assert main(["learn", str(tmp_path / "faulty.csv"), "--out", str(tmp_path / "mine.yaml")]) == 0
    said = capsys.readouterr().out
    assert "the reference itself looks like" in said and "boost_leak" in said
    known = load_learned(tmp_path / "mine.yaml")
    assert known is not None and any("the reference itself looks like" in text for text in known.doubts)


@pytest.mark.thorough
def test_a_reference_of_a_larger_engine_is_told_by_its_charge(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    driving = draw_driving("random", 100.0, LABORATORY, np.random.default_rng(4))
    larger = run_plant(driving, LABORATORY | {"V_d": 1.3 * LABORATORY["V_d"]})
    frame = read(larger, driving, (), SensorSet.perfect(), 6, np.random.default_rng(5))
    frame.loc[frame["time_s"].between(40.0, 75.0), "p_em_pa"] = 1.5e5  # a stuck sensor is said here, too
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert main(["learn", str(tmp_path / "a.csv"), "--out", str(tmp_path / "mine.yaml")]) == 0
    said = capsys.readouterr().out
    assert "note: t_im_k of the reference would be 2" in said and "another displacement" in said
    assert f"note: {tmp_path / 'a.csv'}: the engine breathes" in said
    assert f"note: {tmp_path / 'a.csv'}: p_em_pa stands still from 40 to 75 s" in said


def test_another_engine_is_no_reference(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    driving = draw_driving("random", 120.0, LABORATORY, np.random.default_rng(4))
    other = LABORATORY | {"V_d": 0.6 * LABORATORY["V_d"], "J_t": 3.0 * LABORATORY["J_t"]}
    frame = read(run_plant(driving, other), driving, (), SensorSet.perfect(), 6, np.random.default_rng(5))
    frame.to_csv(tmp_path / "other.csv", index=False)
    assert main(["learn", str(tmp_path / "other.csv"), "--out", str(tmp_path / "mine.yaml")]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "this engine" in message
    assert not (tmp_path / "mine.yaml").exists()


def test_too_short_a_reference_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pd.read_csv(folder / "healthy.csv").iloc[:150].to_csv(tmp_path / "short.csv", index=False)
    assert main(["learn", str(tmp_path / "short.csv"), "--out", str(tmp_path / "mine.yaml")]) == 2
    assert "s" in capsys.readouterr().err and not (tmp_path / "mine.yaml").exists()


def test_driving_that_two_recordings_share_is_no_reference(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Its rows would count twice; so they would in several recordings that are judged together."""
    whole, part = str(folder / "healthy.csv"), str(tmp_path / "part.csv")
    pd.read_csv(whole).iloc[200:].to_csv(part, index=False)
    assert main(["learn", whole, part, "--out", str(tmp_path / "mine.yaml")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "of its rows in another of the recordings" in said
    assert main(["learn", part, "--engine", str(folder / "mine.yaml"), "--out", str(tmp_path / "mine.yaml")]) == 2
    assert f"{part}: got 100 % of its rows in another of the recordings" in capsys.readouterr().err
    assert main(["discover", whole, part, "--out", str(tmp_path / "found")]) == 2
    assert "recordings that share no driving" in capsys.readouterr().err


@pytest.mark.thorough
def test_siblings_are_learned_engines(folder: Path, capsys: pytest.CaptureFixture[str]):
    plain = folder / "plain.yaml"
    plain.write_text("eta_sc: 1.1\n")
    _recorded(6, duration_s=80.0, A_egrmax=0.95).to_csv(folder / "next.csv", index=False)
    arguments = ["learn", str(folder / "next.csv"), "--out", str(folder / "next.yaml"), "--siblings"]
    assert main([*arguments, str(plain)]) == 2
    assert "no learned engine" in capsys.readouterr().err
    itself = ["learn", str(folder / "healthy.csv"), "--out", str(folder / "next.yaml"), "--siblings"]
    assert main([*itself, str(folder / "mine.yaml")]) == 2
    assert "of the new engine itself" in capsys.readouterr().err
    known, doubted = load_learned(folder / "mine.yaml"), folder / "doubted.yaml"
    assert known is not None
    save_learned(replace(known, suspected=("the reference itself looks like a leak",)), doubted)
    assert main([*arguments, str(doubted)]) == 0
    said = capsys.readouterr()
    assert f"--siblings {doubted}: the reference itself looks like a leak" in said.out + said.err
    assert main(["learn", str(folder / "next.csv"), "--engine", str(folder / "next.yaml"),
                 "--out", str(folder / "again.yaml")]) == 0  # fmt: skip
    assert (folder / "again.learned.parquet").read_bytes() == (folder / "next.learned.parquet").read_bytes()
