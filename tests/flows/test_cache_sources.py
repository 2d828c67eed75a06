"""The digest covers what an entry really imports: no less (stale results), no more (lost hours)."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import toy_steps
from toy_library import write_toylib

from tasks import evaluate, identify, pretrain, prove, report, watch
from tasks.progress import Display
from tasks.remembered import Remembered
from tasks.run_context import RunContext
from tasks.sources import LibrarySources, Sources, function_sources
from tasks.workspace import PROJECT, Workspace


@pytest.fixture
def library(tmp_path: Path) -> Path:
    write_toylib(tmp_path)
    return tmp_path


def digest(root: Path, *entries: str) -> str:
    return LibrarySources(root, "toylib").collect(entries).digest


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ("constants.py", "FACTOR = 3.0\n"),
        ("scaling.py", "from .constants import FACTOR\n\ndef scaled(x, scale):\n    return FACTOR * x\n"),
        ("__init__.py", '__version__ = "1"\nimport os\nos.environ["X"] = "1"\n'),
    ],
)
def test_a_change_that_can_matter_changes_the_digest(library: Path, changed: str, text: str) -> None:
    before = digest(library, "toylib.scaling")
    (library / "toylib" / changed).write_text(text)
    assert digest(library, "toylib.scaling") != before


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ("report.py", "COLOUR = 'blue'\n"),
        ("draw.py", "def draw(count, seed):\n    return [seed] * count\n"),
        ("constants.py", '"""Constants."""\n\n# why two\nFACTOR    = 2.0\n'),
        ("__init__.py", '"""Toy, new words."""\nfrom toylib.report import COLOUR\n__version__ = "2"\n'),
    ],
)
def test_a_change_that_cannot_matter_does_not(library: Path, changed: str, text: str) -> None:
    before = digest(library, "toylib.scaling")
    (library / "toylib" / changed).write_text(text)
    assert digest(library, "toylib.scaling") == before


def test_texts_that_an_earlier_process_read_are_not_parsed_again(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def collected(remembered: Remembered) -> Sources:
        found = LibrarySources(library, "toylib", remembered).collect(["toylib.scaling", "toylib.report"])
        remembered.save()
        return found

    path = tmp_path / "code.json"
    before = collected(Remembered(path))
    written = path.stat().st_mtime_ns
    read: list[str] = []
    monkeypatch.setattr("tasks.sources.parsed", lambda text: read.append(text) or ast.parse(text))
    assert collected(Remembered(path)) == before == collected(Remembered())
    assert path.stat().st_mtime_ns == written
    texts = {file.read_text() for file in (library / "toylib").glob("*.py")}
    assert read and set(read) <= texts  # by the one that was given no file
    read.clear()
    assert collected(Remembered(path)) == before and not read
    (library / "toylib" / "constants.py").write_text("FACTOR = 5.0\n")
    assert collected(Remembered(path)).digest != before.digest and set(read) == {"FACTOR = 5.0\n"}


@pytest.mark.parametrize("damage", [b"", b"\xff", b"0" * 64 + b"\n{}\n"])
def test_damaged_memories_are_as_good_as_none(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "code.json"
    remembered = Remembered(path)
    assert remembered.value(lambda: "first", "a text") == "first"
    remembered.save()
    assert Remembered(path).value(lambda: "another", "a text") == "first"
    path.write_bytes(path.read_bytes().replace(b"first", b"fjrst"))
    assert Remembered(path).value(lambda: "another", "a text") == "another"
    path.write_bytes(damage)
    assert Remembered(path).value(lambda: "another", "a text") == "another"


def test_imports_inside_functions_packages_and_lazy_registries_are_followed(library: Path) -> None:
    (library / "toylib" / "sub").mkdir()
    (library / "toylib" / "sub" / "__init__.py").write_text('METHODS = {"a": "toylib.sub.method:run"}\n')
    (library / "toylib" / "sub" / "method.py").write_text("def run():\n    from ..scaling import scaled\n")
    modules = LibrarySources(library, "toylib").collect(["toylib.sub"]).modules
    assert set(modules) == {"toylib.sub", "toylib.sub.method", "toylib.scaling", "toylib.constants"}


def test_a_package_that_finds_its_modules_by_itself_rests_on_all_of_them(library: Path) -> None:
    (library / "toylib" / "sub").mkdir()
    (library / "toylib" / "sub" / "__init__.py").write_text(
        "import importlib, pkgutil\n\n"
        "FOUND = [importlib.import_module(f'{__name__}.{m.name}') for m in pkgutil.iter_modules(__path__)]\n"
    )
    (library / "toylib" / "sub" / "one.py").write_text("from ..scaling import scaled\nHALF = scaled(0.25, 1)\n")
    modules = LibrarySources(library, "toylib").collect(["toylib.sub"]).modules
    assert set(modules) == {"toylib.sub", "toylib.sub.one", "toylib.scaling", "toylib.constants"}


@pytest.mark.parametrize("entry", ["dieseltwin.engine", "dieseltwin.discovery", "dieseltwin.report.style"])
def test_what_python_imports_is_in_the_digest(entry: str) -> None:
    told = f"import sys, {entry}; print(*(m for m in sys.modules if m.startswith('dieseltwin.')))"
    imported = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True, cwd=PROJECT)
    sources = LibrarySources(PROJECT)
    # What a package's __init__ imports only to name it (dieseltwin.version) is none of the code.
    files = {m for m in imported.stdout.split() if (PROJECT / f"{m.replace('.', '/')}.py").exists()}
    assert files - set(sources.collect([entry]).modules) == {"dieseltwin.version"}


def test_steps_rest_on_the_effects_and_pages_on_the_declared_methods() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    folder = PROJECT / "dieseltwin" / "engine" / "effects"
    effects = {f"dieseltwin.engine.effects.{path.stem}" for path in folder.glob("[!_]*.py")}
    for step in (identify.STEPS["classical"], prove.case, watch.watched):
        assert effects <= set(step.code(context).modules)
    for step in (report.comparison, report.report, evaluate.page):
        assert set(identify.declarations()) <= set(step.code(context).modules)


def test_versions_of_imported_packages_count(library: Path) -> None:
    sources = LibrarySources(library, "toylib").collect(["toylib.draw"])
    assert set(sources.packages) == {"numpy"}


def test_an_unknown_entry_is_an_error(library: Path) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"toylib\.nothing"):
        digest(library, "toylib.nothing")


def test_a_steps_own_code_is_its_function_and_what_that_uses() -> None:
    known = frozenset({"toylib.scaling", "toylib.draw"})
    code, imported = function_sources(toy_steps.total.function, known)
    assert "toylib.scaling" in imported and "toylib.draw" not in imported
    assert code != function_sources(toy_steps.make.function, known)[0]


def test_of_the_settings_only_the_imported_models_count(library: Path) -> None:
    (library / "toylib" / "settings").mkdir()
    (library / "toylib" / "settings" / "__init__.py").write_text("")
    config = library / "toylib" / "settings" / "params.py"
    config.write_text(
        "SIZE = 3\n\nclass Shared:\n    n = SIZE\n\nclass Maps(Shared):\n    a = 1\n\nclass Report:\n    b = 1\n"
    )
    user = library / "toylib" / "user.py"
    user.write_text(
        "from __future__ import annotations\nfrom .settings.params import Maps, Report\n\n"
        "def f(r: Report):\n    return Maps\n"
    )
    before, text = digest(library, "toylib.user"), config.read_text()
    config.write_text(text.replace("b = 1", "b = 2"))
    assert digest(library, "toylib.user") == before
    for old, new in (("a = 1", "a = 2"), ("SIZE = 3", "SIZE = 4")):
        config.write_text(text.replace(old, new))
        assert digest(library, "toylib.user") != before


def test_a_section_in_a_module_of_its_own_counts_for_whom_imports_it(library: Path) -> None:
    (library / "toylib" / "settings").mkdir()
    (library / "toylib" / "settings" / "__init__.py").write_text("")
    (library / "toylib" / "settings" / "params.py").write_text(
        "from .discovery import Proof\n\nclass Maps:\n    a = 1\n\n"
        "class Params:\n    proof: Proof\n    maps: Maps\n"
    )
    section = library / "toylib" / "settings" / "discovery.py"
    section.write_text("class Proof:\n    n = 1\n")
    (library / "toylib" / "maps.py").write_text("from .settings.params import Maps\n\ndef f():\n    return Maps\n")
    (library / "toylib" / "all.py").write_text(
        "from .settings.params import Maps\nfrom .maps import f\nfrom .settings.params import Params\n\n"
        "def g():\n    return Params, Maps, f\n"
    )
    before = digest(library, "toylib.maps"), digest(library, "toylib.all")
    section.write_text("class Proof:\n    n = 2\n")
    after = digest(library, "toylib.maps"), digest(library, "toylib.all")
    assert after[0] == before[0] and after[1] != before[1]


def test_imports_for_type_checkers_do_not_count(library: Path) -> None:
    (library / "toylib" / "user.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from toylib.report import COLOUR\n"
    )
    assert set(LibrarySources(library, "toylib").collect(["toylib.user"]).modules) == {"toylib.user"}


def test_a_steps_entry_stands_for_its_package_and_its_other_imports_stay(library: Path) -> None:
    modules = identify.STEPS["classical"].code(RunContext(Workspace(library), Display(library / "x"))).modules
    assert "dieseltwin.identification.maximum_likelihood" in modules and "dieseltwin.recordings.reader" in modules
    assert "dieseltwin.identification.few_shot.newton" not in modules


def test_a_new_field_of_the_report_leaves_pretraining_alone(library: Path) -> None:
    (library / "dieseltwin").symlink_to(PROJECT / "dieseltwin")
    before = pretrain.bodies.code(RunContext(Workspace(library), Display(library / "x"), library_root=library)).digest
    (library / "dieseltwin").unlink()
    shutil.copytree(PROJECT / "dieseltwin", library / "dieseltwin", ignore=shutil.ignore_patterns("__pycache__"))
    config = library / "dieseltwin" / "settings" / "params.py"
    config.write_text(config.read_text().replace("    dpi:", "    another: int = 3\n    dpi:"))
    assert "another: int" in config.read_text()
    after = pretrain.bodies.code(RunContext(Workspace(library), Display(library / "x"), library_root=library)).digest
    assert after == before


def test_a_written_file_touches_the_sources_and_an_editors_lock_is_none(library: Path) -> None:
    package = library / "toylib"
    (package / ".#maps.py").symlink_to("somebody@elsewhere")
    sources = LibrarySources(library, "toylib")
    assert not sources.touched()
    written = sorted(package.glob("[a-z]*.py"))[0]
    written.write_text(written.read_text() + "# a remark\n")
    assert sources.touched()


def test_the_engine_does_not_rest_on_the_report() -> None:
    sources = LibrarySources(PROJECT)
    modules = sources.collect(["dieseltwin.settings.params"]).modules
    assert "dieseltwin.settings.params" in modules
    assert not any(name.startswith(("dieseltwin.report", "dieseltwin.identification")) for name in modules)
