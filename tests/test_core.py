"""The core runs where no extra is installed, and says in one line what is missing where it can't."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from segments import REFERENCE

from dieseltwin.recordings.steady_points import STATES
from tests.calibration.simulated import made_points

ABSENT = ("torch", "prefect", "mlflow", "dvc")
SLOW = (*ABSENT, "numba", "pandas", "scipy", "matplotlib")
POINTS = 60
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

CORE = (
    "cli", "report", "discovery", "calibration", "petrol", "rigs", "recordings", "duty_cycles", "engine", "settings",
)  # fmt: skip
IMPORT_ALL = f"""
import importlib, pkgutil
for room in {CORE!r}:
    package = importlib.import_module("dieseltwin." + room)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
from dieseltwin.identification import identify, maximum_likelihood
from dieseltwin.settings.methods import in_order
in_order()
"""

Command = Callable[..., tuple[int, str, set[str]]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a minute of driving, and settled points."""
    made = tmp_path_factory.mktemp("core")
    trace = pd.read_csv(REFERENCE).assign(t_amb_k=298.15, p_amb_pa=101325.0)
    trace.iloc[:151].to_csv(made / "short.csv", index=False)
    points = made_points(count=POINTS, noise=0.005)
    pd.DataFrame({name: points[name] for name in POINT_COLUMNS}).to_csv(made / "points.csv", index=False)
    return made


@pytest.fixture(scope="module")
def command(folder: Path, project_root: Path) -> Command:
    """Run `dieseltwin` without the extras: exit code, what it said, the packages that it imported."""
    (folder / "hook").mkdir()
    (folder / "hook" / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
    paths = os.pathsep.join([str(folder / "hook"), str(project_root)])

    def run(*arguments: str, script: str | None = None) -> tuple[int, str, set[str]]:
        what = ["-m", "dieseltwin"] if script is None else ["-c", script]
        done = subprocess.run(
            [sys.executable, *what, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            cwd=folder, env={**os.environ, "PYTHONPATH": paths, "IMPORTED": str(folder / "imported")},
        )  # fmt: skip
        imported = (folder / "imported").read_text(encoding="utf-8").split()
        return done.returncode, done.stdout, {name.partition(".")[0] for name in imported}

    return run


def test_every_module_of_the_core_can_be_imported(command: Command) -> None:
    """Recordings in, verdicts and pages out; the rooms of networks, surrogates and few-shot learning are extras."""
    code, said, imported = command(script=IMPORT_ALL)
    assert code == 0 and not imported & set(ABSENT), said


# One process for all of them, as libraries load once; every command has one of its own further down. One start of the
# calibration, as its own tests have more.
ASK = """
import json, sys
from dieseltwin.calibration import calibrate
from dieseltwin.cli.app import main

calibrate.STARTS = 0
for arguments in json.loads(sys.argv[1]):
    print("\\f", main(arguments), flush=True)
"""
HALF_A_MINUTE = ["identify", "short.csv", "--segment", "30", "--out"]
ASKED = {
    "simulate": ["simulate", "short.csv", "--out", "simulated.csv"],
    "identify": [*HALF_A_MINUTE, "identified", "--runs", "1"],
    "calibrate": ["calibrate", "points.csv", "--out", "engine.yaml"],
    "discover": ["discover", "points.csv", "--engine", "engine.yaml", "--out", "found"],
    "imply": ["imply", "points.csv", "--engine", "found/repaired.yaml", "--out", "implied.csv"],
    "newton": [*HALF_A_MINUTE, "refused", "--method", "few-shot-newton"],
    "multi-stage": [*HALF_A_MINUTE, "refused", "--method", "multi-stage"],
    "maps": [*HALF_A_MINUTE, "refused", "--maps", "improved", "--models", "models"],
}


@pytest.fixture(scope="module")
def answers(command: Command, folder: Path) -> dict[str, tuple[int, str]]:
    """Exit code of what was asked, and what was said."""
    (folder / "models").mkdir()
    (folder / "models" / "maps_improved.pt").touch()
    code, said, imported = command(json.dumps(list(ASKED.values())), script=ASK)
    assert code == 0 and not imported & set(ABSENT), said
    before, *parts = said.split("\f")
    words = [before, *(part.partition("\n")[2] for part in parts)]
    return {name: (int(part.split()[0]), words[k]) for k, (name, part) in enumerate(zip(ASKED, parts, strict=True))}


def test_simulate(answers: dict[str, tuple[int, str]], folder: Path) -> None:
    code, said = answers["simulate"]
    assert code == 0 and len(pd.read_csv(folder / "simulated.csv")) == 151, said


def test_identify(answers: dict[str, tuple[int, str]], folder: Path) -> None:
    code, said = answers["identify"]
    assert code == 0 and "classical, 1 run, 1 segment" in said, said
    assert (folder / "identified" / "figures").is_dir()


def test_calibrate_discover_and_imply(answers: dict[str, tuple[int, str]], folder: Path) -> None:
    assert [answers[name][0] for name in ("calibrate", "discover", "imply")] == [0, 0, 0], answers
    assert len(pd.read_csv(folder / "implied.csv")) == POINTS


@pytest.mark.parametrize("asked", ["newton", "multi-stage", "maps"])
def test_what_needs_torch_names_the_extra(answers: dict[str, tuple[int, str]], folder: Path, asked: str) -> None:
    code, said = answers[asked]
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
