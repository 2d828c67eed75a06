"""The core runs where no extra is installed, and says in one line what is missing where it can't."""

from __future__ import annotations

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
    points = made_points(count=60, noise=0.005)
    pd.DataFrame({name: points[name] for name in POINT_COLUMNS}).to_csv(made / "points.csv", index=False)
    return made


@pytest.fixture(scope="module")
def command(folder: Path, project_root: Path) -> Command:
    """Run `dieseltwin` without the extras: exit code, what it said, the packages that it imported."""
    (folder / "hook").mkdir()
    (folder / "hook" / "sitecustomize.py").write_text(HOOK, encoding="utf-8")
    paths = os.pathsep.join([str(folder / "hook"), str(project_root)])

    def run(*arguments: str, script: str | None = None) -> tuple[int, str, set[str]]:
        what = ["-m", "dieseltwin", *arguments] if script is None else ["-c", script]
        done = subprocess.run(
            [sys.executable, *what], cwd=folder, capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": paths, "IMPORTED": str(folder / "imported")},
        )  # fmt: skip
        imported = (folder / "imported").read_text(encoding="utf-8").split()
        return done.returncode, done.stdout + done.stderr, {name.partition(".")[0] for name in imported}

    return run


def test_every_module_of_the_core_can_be_imported(command: Command) -> None:
    """Recordings in, verdicts and pages out; the rooms of networks, surrogates and few-shot learning are extras."""
    code, said, imported = command(script=IMPORT_ALL)
    assert code == 0 and not imported & set(ABSENT), said


def test_simulate(command: Command, folder: Path) -> None:
    code, said, _ = command("simulate", "short.csv", "--out", "simulated.csv")
    assert code == 0 and len(pd.read_csv(folder / "simulated.csv")) == 151, said


def test_identify(command: Command, folder: Path) -> None:
    options = ("short.csv", "--out", "identified", "--segment", "30", "--runs", "2")
    code, said, _ = command("identify", *options)
    assert code == 0 and "classical, 2 runs, 1 segments" in said, said
    assert (folder / "identified" / "figures").is_dir()


# One start of the calibration, as its own tests have more; one process, as every other command here has its own.
POINTS = """
import sys
from dieseltwin.calibration import calibrate
from dieseltwin.cli.app import main

calibrate.STARTS = 0
codes = [
    main(["calibrate", "points.csv", "--out", "engine.yaml"]),
    main(["discover", "points.csv", "--engine", "engine.yaml", "--out", "found"]),
    main(["imply", "points.csv", "--engine", "found/repaired.yaml", "--out", "implied.csv"]),
]
sys.exit(any(codes))
"""


def test_calibrate_discover_and_imply(command: Command, folder: Path) -> None:
    code, said, _ = command(script=POINTS)
    assert code == 0 and len(pd.read_csv(folder / "implied.csv")) == 60, said


# One process for all that is refused.
NEEDS_TORCH = """
import sys
from dieseltwin.cli.app import main

asked = (("--method", "few-shot-newton"), ("--method", "multi-stage"), ("--maps", "improved", "--models", "models"))
print(*(main(["identify", "short.csv", "--out", "refused", "--segment", "30", *options]) for options in asked))
"""


def test_what_needs_torch_names_the_extra(command: Command, folder: Path) -> None:
    (folder / "models").mkdir(exist_ok=True)
    (folder / "models" / "maps_improved.pt").touch()
    _, said, _ = command(script=NEEDS_TORCH)
    codes, *lines = said.splitlines()
    assert codes == "2 2 2" and len(lines) == 3, said
    assert all("pip install 'dieseltwin[networks]'" in line for line in lines), said
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
