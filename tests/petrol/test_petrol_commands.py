"""Recordings and engine files that can't be used are one clear line; the commands write a document that can be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from dieseltwin.cli.app import main
from dieseltwin.discovery.verdict.document import load_discrepancy
from dieseltwin.errors import InputError
from dieseltwin.petrol.calibrate import calibrate
from dieseltwin.petrol.parameters import PetrolParameters, load_petrol, save_petrol
from dieseltwin.petrol.recording import PetrolRecording, read_petrol
from tests.petrol.plant import drive

Recorder = Callable[..., PetrolRecording]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return drive(90.0, 8)


def _written(frame: pd.DataFrame, tmp_path: Path) -> Path:
    path = tmp_path / "drive.csv"
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="p_ic_Pa"), "no p_ic_pa"),
        (lambda t: t.assign(p_im_Pa=t.p_im_Pa / 1e3), "p_im_pa.*convert to Pa"),
        (lambda t: t.assign(T_ic_K=t.T_ic_K - 273.15), "t_ic_k.*convert to K"),
        (lambda t: t.assign(W_af_kg_s=t.W_af_kg_s * 3600), "w_af_kg_s"),
        (lambda t: t.iloc[::-1], "no rise at data row 2"),
        (lambda t: t.iloc[:300], "at least 60 s"),
    ],
)
def test_unfit_recordings(table: pd.DataFrame, tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=words):
        read_petrol(_written(change(table.copy()), tmp_path))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_petrol(tmp_path / "no.csv")


def test_holes_are_bridged(table: pd.DataFrame, tmp_path: Path) -> None:
    holed = table.copy()
    holed.loc[200:230, "p_im_Pa"] = float("nan")
    assert len(read_petrol(_written(holed, tmp_path)).signals.time_s) == len(table) - 31


def test_too_short_to_calibrate(record: Recorder) -> None:
    with pytest.raises(InputError, match="at least 600 s"):
        calibrate(record(9, 120.0).signals, PetrolParameters(), "")


def test_engine_without_maps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="dieseltwin calibrate"):
        load_petrol(save_petrol(PetrolParameters(), tmp_path / "empty.yaml"))


def test_discover_command(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    recording = record(10, 400.0, W_af_kg_s=0.12)
    out = tmp_path / "out"
    assert main(["discover", recording.path, "--engine", str(file), "--out", str(out)]) == 0
    assert "w_af_gain" in capsys.readouterr().out
    assert load_discrepancy(out).effects[0].name == "w_af_gain"
    assert {p.name for p in (out / "figures").iterdir()} == {
        "residuals_over_time.png", "over_pressure.png", "candidates.svg"
    }  # fmt: skip
    assert "data:image/png;base64" in (out / "report.html").read_text(encoding="utf-8")


def test_options_of_the_diesel_engine_are_refused(
    engine: PetrolParameters, record: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = save_petrol(engine, tmp_path / "engine.yaml")
    recording = str(record(10, 400.0).path)
    commands = [
        ["discover", recording, "--engine", str(file), "--sensors", "p_im_pa", "--out", str(tmp_path / "out")],
        ["calibrate", recording, "--base", "liu_petrol", "--noise", "1", "--out", str(tmp_path / "new.yaml")],
    ]
    for command in commands:
        assert main(command) == 2
        assert "petrol" in capsys.readouterr().err
    assert not (tmp_path / "out").exists() and not (tmp_path / "new.yaml").exists()
