"""The core runs where no extra is installed, and says in one line what is missing where it can't."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from segments import REFERENCE

from dieseltwin.recordings.steady_points import STATES
from tests.calibration.simulated import made_points

ABSENT = ("torch", "prefect", "mlflow", "dvc")
SLOW = (*ABSENT, "numba", "pandas", "scipy", "matplotlib")
POINT_COLUMNS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", *STATES)

# Python imports it by itself at its start: the packages are absent, and what was imported is told at the end.
HOOK = f"""
import atexit, os, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
atexit.register(lambda: open(os.environ["IMPORTED"], "w").write(" ".join(sys.modules)))
"""

Command = Callable[..., tuple[int, str, set[str]]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute of driving, ten minutes of it repeated, and settled points."""
    made = tmp_path_factory.mktemp("core")
    trace = pd.read_csv(REFERENCE).assign(t_amb_k=298.15, p_amb_pa=101325.0)
    trace.iloc[:151].to_csv(made / "short.csv", index=False)
    there_and_back = pd.concat([trace, trace.iloc[-2:0:-1], trace.iloc[:3]], ignore_index=True)
    inputs = ["n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct", "t_amb_k", "p_amb_pa"]
    long = there_and_back[inputs].assign(time_s=0.2 * np.arange(len(there_and_back)))
    long.to_csv(made / "long.csv", index=False)
    points = made_points(count=60, noise=0.005)
    pd.DataFrame({name: points[name] for name in POINT_COLUMNS}).to_csv(made / "points.csv", index=False)
    return made


@pytest.fixture(scope="module")
def command(folder: Path, project_root: Path) -> Command:
    """Run `dieseltwin` without the extras: exit code, what it said, the packages that it imported."""
    (folder / "hook").mkdir()
    (folder / "hook" / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
    paths = os.pathsep.join([str(folder / "hook"), str(project_root)])

    def run(*arguments: str) -> tuple[int, str, set[str]]:
        done = subprocess.run(
            [sys.executable, "-m", "dieseltwin", *arguments], cwd=folder, capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": paths, "IMPORTED": str(folder / "imported")},
        )  # fmt: skip
        imported = (folder / "imported").read_text(encoding="utf-8").split()
        return done.returncode, done.stdout + done.stderr, {name.partition(".")[0] for name in imported}

    return run


def test_simulate_and_discover(command: Command, folder: Path) -> None:
    code, said, _ = command("simulate", "long.csv", "--out", "recording.csv")
    assert code == 0, said
    generator = np.random.default_rng(3)
    recording = pd.read_csv(folder / "recording.csv")
    for name in ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_egr_kg_s", "t_em_k", "w_c_kg_s"):
        recording[name] += 0.02 * recording[name].mean() * generator.standard_normal(len(recording))
    recording.to_csv(folder / "recording.csv", index=False)
    code, said, _ = command("discover", "recording.csv", "--out", "discovered")
    assert code == 0 and (folder / "discovered" / "discrepancy.json").is_file(), said


def test_identify(command: Command, folder: Path) -> None:
    options = ("short.csv", "--out", "identified", "--segment", "30", "--runs", "2")
    code, said, _ = command("identify", *options)
    assert code == 0 and "classical, 2 runs, 1 segments" in said, said
    assert (folder / "identified" / "figures").is_dir()


def test_calibrate_and_imply(command: Command, folder: Path) -> None:
    code, said, _ = command("calibrate", "points.csv", "--out", "engine.yaml")
    assert code == 0, said
    code, said, _ = command("imply", "points.csv", "--engine", "engine.yaml", "--out", "implied.csv")
    assert code == 0 and len(pd.read_csv(folder / "implied.csv")) == 60, said


@pytest.mark.parametrize(
    "asked",
    [("--method", "few-shot-newton"), ("--method", "multi-stage"), ("--maps", "improved", "--models", "models")],
)
def test_what_needs_torch_names_the_extra(command: Command, folder: Path, asked: tuple[str, ...]) -> None:
    (folder / "models").mkdir(exist_ok=True)
    (folder / "models" / "maps_improved.pt").touch()
    code, said, _ = command("identify", "short.csv", "--out", "refused", "--segment", "30", *asked)
    assert code == 2 and said.count("\n") == 1 and "pip install 'dieseltwin[networks]'" in said, said
    assert not (folder / "refused").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--help"], 0, "identify"),
        (["identify", "--help"], 0, "few-shot-newton"),
        (["identify", "missing.csv", "--out", "x"], 2, "no such file"),
        (["identify", "short.csv", "--out", "x", "--method", "clasical"], 2, "did you mean classical?"),
        (["discover", "missing.csv", "--out", "x"], 2, "no such file"),
        (["simulate", "missing.csv", "--out", "x.csv"], 2, "no such file"),
        (["calibrate", "missing.csv", "--out", "x.yaml"], 2, "no such file"),
        (["data", "list", "--help"], 0, "Usage"),
    ],
)
def test_help_and_mistakes_import_nothing_slow(
    command: Command, arguments: list[str], code: int, words: str
) -> None:
    found, said, imported = command(*arguments)
    assert found == code and words in said, said
    assert not imported & set(SLOW)
