"""The house itself: layout, lock, hygiene, directions; and that the checks notice what they are there for."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

TOP_LEVEL = (
    "pyproject.toml", "Makefile", "params.yaml", "dvc.yaml", "README.md", "CHANGELOG.md", "LICENSE", "CITATION.cff",
    "requirements.lock", ".ci/run", "flows", "tasks", "tests", "mlruns", "dieseltwin", "benchmarks",
)  # fmt: skip


@pytest.fixture(scope="module")
def hygiene(project_root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("hygiene", project_root / ".ci" / "hygiene.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def project(project_root: Path) -> dict:
    return tomllib.loads((project_root / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", TOP_LEVEL)
def test_layout(project_root: Path, name: str) -> None:
    assert (project_root / name).exists()


def test_ci_script_can_be_run(project_root: Path) -> None:
    script = project_root / ".ci" / "run"
    assert os.access(script, os.X_OK) and script.read_text().startswith("#!/usr/bin/env bash\n")
    subprocess.run(["bash", "-n", str(script)], check=True)


@pytest.mark.parametrize("target", ["run", "test", "check", "ui", "serve"])
def test_make_targets_set_up_the_environment_first(project_root: Path, target: str) -> None:
    rules = (project_root / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}: \$\(READY\)", rules, flags=re.MULTILINE)


def test_lock_is_plain(project_root: Path, hygiene: ModuleType) -> None:
    lines = (project_root / "requirements.lock").read_text(encoding="utf-8").splitlines()
    assert list(hygiene.lock_problems(lines)) == []
    assert "torch==2.13.0" in lines  # any other pin, local builds included, pulls gigabytes of CUDA or is not found


@pytest.mark.parametrize(
    "line",
    ["torch==2.13.0+cpu", "numpy>=2", "numpy @ file:///wheels/numpy.whl", "--index-url https://host/simple", "-e ."],
)
def test_unfit_lock_lines_are_noticed(hygiene: ModuleType, line: str) -> None:
    assert len(list(hygiene.lock_problems(["scipy==1.17.1", line]))) == 1


def test_a_package_locked_twice_is_noticed(hygiene: ModuleType) -> None:
    assert list(hygiene.lock_problems(["Jinja2==3.1.6", "jinja2==3.1.5"])) == ["requirements.lock: jinja2 twice"]


def test_everything_asked_for_is_locked(project_root: Path, project: dict) -> None:
    def plain(name: str) -> str:
        return re.sub(r"[-_.]+", "-", re.split(r"[<>=!\[; ]", name)[0]).lower()

    lines = (project_root / "requirements.lock").read_text(encoding="utf-8").splitlines()
    locked = {plain(line.split("==")[0]) for line in lines if "==" in line}
    optional = project["project"]["optional-dependencies"]
    wanted = [*project["project"]["dependencies"], *optional["networks"], *optional["pipeline"], *optional["dev"]]
    wanted += [*optional["export"], *optional["docs"], *optional["tables"]]
    wanted += project["build-system"]["requires"]
    assert {plain(name) for name in wanted} - {"dieseltwin"} <= locked  # an extra may ask for another one


def test_installed_versions_are_the_locked_ones(project_root: Path) -> None:
    from importlib.metadata import PackageNotFoundError, version

    lines = (project_root / "requirements.lock").read_text(encoding="utf-8").splitlines()
    other = {}
    for name, wanted in (line.split("==") for line in lines if "==" in line):
        try:
            found = version(name).split("+")[0]
        except PackageNotFoundError:
            found = "missing"
        if found != wanted:
            other[name] = found
    assert other == {}


def test_no_module_outgrows_and_no_machine_path_is_committed(hygiene: ModuleType) -> None:
    assert hygiene.problems() == []


def test_hygiene_works_without_git(tmp_path: Path, hygiene: ModuleType) -> None:
    for name in ("dieseltwin/a.py", "README.md", ".venv/lib/b.py", "data/c.parquet", "dieseltwin/__pycache__/a.pyc"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    found = [path.relative_to(tmp_path).as_posix() for path in hygiene.tracked_files(tmp_path)]
    assert found == ["README.md", "dieseltwin/a.py"]


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("x = '/" + "home/me/data.csv'\n", "path of one machine"),
        ("see file:///" + "opt/wheels\n", "path of one machine"),
        ("a\r\nb\n", "carriage returns"),
        ("<<<<<<" + "< HEAD\n", "conflict markers"),
        ("x = 1\n" * 400, "split modules"),
    ],
)
def test_hygiene_notices(tmp_path: Path, hygiene: ModuleType, content: str, word: str) -> None:
    path = tmp_path / "bad.py"
    path.write_bytes(content.encode())
    found = list(hygiene.file_problems(path, "dieseltwin/bad.py"))
    assert len(found) == 1 and word in found[0]


def test_hygiene_leaves_good_files_alone(tmp_path: Path, hygiene: ModuleType) -> None:
    path = tmp_path / "good.py"
    path.write_text("full = '/dev/full'\nlink = 'https://example.org/home/page'\n" * 10)
    assert list(hygiene.file_problems(path, "dieseltwin/good.py")) == []


def test_a_page_that_is_not_there_is_noticed(tmp_path: Path, hygiene: ModuleType) -> None:
    there, nowhere = "there" + ".md", "nowhere" + ".md"  # assembled, so that this file does not find itself
    (tmp_path / "a.py").write_text(f'"""See docs/{there} and {nowhere}."""\n')
    (tmp_path / there).write_text("a page\n")
    found = list(hygiene.missing_documents(tmp_path, ["a.py", there]))
    assert found == [f"a.py: refers to {nowhere}, which the repository doesn't hold"]


def test_a_forbidden_import_is_noticed(project_root: Path, project: dict, tmp_path: Path) -> None:
    """The contracts of pyproject.toml, run over a small house with a forbidden import in it."""
    (tmp_path / "pyproject.toml").write_bytes((project_root / "pyproject.toml").read_bytes())
    contracts = project["tool"]["importlinter"]["contracts"]
    layers = {contract.get("containers", [""])[0]: contract for contract in contracts if contract["type"] == "layers"}
    rooms = [room for layer in layers["dieseltwin"]["layers"] for room in layer.split(" | ")]
    discovery = [room for layer in layers["dieseltwin.discovery"]["layers"] for room in layer.split(" | ")]
    for package in ("dieseltwin", "dieseltwin/discovery", "flows", "tasks"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("")
    for module in (*rooms, *(f"discovery/{name}" for name in discovery)):
        (tmp_path / "dieseltwin" / f"{module}.py").write_text("")
    lint = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache", "--no-logo"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}

    def broken(module: str, text: str) -> str:
        path = tmp_path / module
        before = path.read_text() if path.exists() else None
        path.write_text(text)
        done = subprocess.run(lint, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        if before is None:
            path.unlink()
        else:
            path.write_text(before)
        return done.stdout if done.returncode else ""

    assert broken("dieseltwin/settings.py", "import json\n") == ""
    assert "knows no orchestrator" in broken("dieseltwin/settings.py", "import mlflow\n")
    assert "networks never imports engine" in broken("dieseltwin/networks.py", "from dieseltwin import engine\n")
    assert "flows -> tasks -> dieseltwin" in broken("dieseltwin/symbols.py", "import tasks\n")
    assert "symbols <- engine" in broken("dieseltwin/settings.py", "import dieseltwin.engine\n")
    assert "twins <- likelihood" in broken("dieseltwin/discovery/twins.py", "import dieseltwin.discovery.search\n")
    assert "shed" in broken("dieseltwin/shed.py", "")  # a room that no layer names


def test_console_script(project: dict) -> None:
    assert project["project"]["scripts"] == {"dieseltwin": "dieseltwin.__main__:program"}


def test_package_data_is_declared(project_root: Path, project: dict) -> None:
    declared = project["tool"]["setuptools"]["package-data"]["dieseltwin"]
    assert "data/*" in declared
    assert {"whtc.csv", "whsc.csv"} <= {p.name for p in (project_root / "dieseltwin" / "data").iterdir()}
