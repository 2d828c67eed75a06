"""`dieseltwin effects` and `dieseltwin simulate --effect`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from dieseltwin.cli.app import main
from dieseltwin.engine import load_engine
from dieseltwin.engine.effects import EFFECTS

COLUMNS = ["time_s", "n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "p_im_pa", "p_em_pa", "omega_t_rad_s"]


@pytest.fixture
def inputs(trace: pd.DataFrame, tmp_path: Path) -> Path:
    trace[COLUMNS].iloc[:200].to_csv(tmp_path / "inputs.csv", index=False)
    return tmp_path / "inputs.csv"


def test_table_and_json(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["effects"]) == 0
    lines = capfd.readouterr().out.splitlines()
    assert len(lines) == len(EFFECTS) + 1
    assert all(name in line for name, line in zip(EFFECTS, lines[1:], strict=True))
    assert main(["effects", "--json"]) == 0
    listed = json.loads(capfd.readouterr().out)
    assert [e["name"] for e in listed] == list(EFFECTS)
    assert next(e for e in listed if e["name"] == "boost_leak")["limits"] == [0.0, 2e-4]


def test_the_documentation_s_table_is_that_of_the_objects(
    project_root: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """`dieseltwin effects --markdown` writes it."""
    assert main(["effects", "--markdown"]) == 0
    assert capfd.readouterr().out in (project_root / "docs" / "effects.md").read_text(encoding="utf-8")


def test_simulate_with_effects_of_command_line_and_file(inputs: Path, tmp_path: Path) -> None:
    def table(name: str, *more: str) -> pd.DataFrame:
        out = tmp_path / f"{name}.csv"
        assert main(["simulate", str(inputs), "--out", str(out), *more]) == 0
        return pd.read_csv(out)

    plain = table("plain")
    leaky = table("leaky", "--effect", "boost_leak=3e-5", "--effect", "w_egr_gain=0.05")
    assert leaky["p_im_pa"].iloc[50:].mean() < plain["p_im_pa"].iloc[50:].mean()
    assert (leaky["w_leak_im_kg_s"] >= 0).all() and leaky["w_leak_im_kg_s"].max() > 1e-3
    engine = tmp_path / "engine.yaml"
    terms = [{"effect": "boost_leak", "magnitude": 3e-5}, {"effect": "w_egr_gain", "magnitude": 0.05}]
    engine.write_text(yaml.safe_dump({"terms": terms}))
    np.testing.assert_allclose(table("file", "--engine", str(engine)).to_numpy(), leaky.to_numpy(), rtol=1e-12)
    again = table("replaced", "--engine", str(engine), "--effect", "boost_leak=0")
    assert again["w_leak_im_kg_s"].max() == 0.0


@pytest.mark.parametrize(
    ("value", "words"),
    [("boost_leek=1e-5", "boost_leak"), ("boost_leak", "NAME=VALUE"), ("boost_leak=much", "a number"),
     ("boost_leak=7", "0.0002 m2"), ("boost_leak=nan", "a number")],
)  # fmt: skip
def test_wrong_effects_are_one_line(
    inputs: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], value: str, words: str
) -> None:
    out = tmp_path / "out.csv"
    assert main(["simulate", str(inputs), "--out", str(out), "--effect", value]) == 2
    said = capfd.readouterr().err
    assert words in said and said.count("\n") == 1 and not out.exists()


def test_an_effect_given_twice_is_refused(inputs: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["--effect", "boost_leak=1e-5", "--effect", "boost_leak=2e-5"]
    assert main(["simulate", str(inputs), "--out", str(tmp_path / "out.csv"), *arguments]) == 2
    assert "one" in capfd.readouterr().err


def test_engine_show_prints_terms_that_a_file_takes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    law = {"point": "W_t", "coefficient": 0.02, "unit": "-", "factors": [["p_em", 2e5, 1.0]], "text": "a: b, # [c]"}
    terms = [{"effect": "boost_leak", "magnitude": 3e-5, "region": {"n_e_rpm": [900.0, 1500.0]}}, law]
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(yaml.safe_dump({"terms": terms}))
    assert main(["engine", "show", "--engine", str(first)]) == 0
    second.write_text(capfd.readouterr().out)
    assert load_engine(second) == load_engine(first)
    assert len(load_engine(second).terms) == 2
