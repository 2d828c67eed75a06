"""What a step's key sees: every constant that its function uses, every file that the library opens for it."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

import pytest
from toy_library import write_toylib

from tasks import discover, prove
from tasks.library_files import named_folders
from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.sources import LibrarySources, function_sources
from tasks.workspace import PROJECT, Workspace

_CONSTANTS = """
NAMES = {}
(LOW, HIGH), (FIRST, *REST) = (1, 2), (3, 4)
STEP = 1
STEP = STEP + 1
NAMES["a"] = 1


def used():
    return HIGH, REST, NAMES, STEP


def unused():
    return OTHER


OTHER = 1
"""


@pytest.mark.parametrize(
    ("old", "new", "seen"),
    [
        ("(1, 2)", "(1, 5)", True),
        ("(3, 4)", "(3, 5)", True),
        ('NAMES["a"] = 1', 'NAMES["a"] = 2', True),
        ("STEP = 1", "STEP = 5", True),
        ("OTHER = 1", "OTHER = 2", False),
    ],
)
def test_constants_count_however_they_are_assigned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, seen: bool
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    digests = []
    for number, text in enumerate((_CONSTANTS, _CONSTANTS.replace(old, new))):
        name = f"constants_{abs(hash((old, number)))}"
        (tmp_path / f"{name}.py").write_text(text)
        digests.append(function_sources(importlib.import_module(name).used)[0])
        del sys.modules[name]
    assert (digests[0] != digests[1]) is seen


@pytest.mark.parametrize(
    ("text", "folders"),
    [
        ('table = resources.files("toylib").joinpath(f"data/{name}.csv")', {"toylib/data"}),
        ('table = files("toylib") / "data/a.csv"', {"toylib/data"}),
        ("page = PackageLoader('toylib')", {"toylib/templates"}),
        ("page = jinja2.PackageLoader('toylib', 'data')", {"toylib/data"}),
        ("table = Path(__file__).parent / 'data' / name", {"toylib/data"}),
        ("table = Path(__file__).resolve().parent / 'data'", {"toylib/data"}),
        ("table = resources.files('toylib').joinpath(name)", {"toylib"}),  # which one isn't told: all of it
        ("table = resources.files('elsewhere').joinpath(name)", set()),
        ("table = Path(name) / 'data'", set()),
    ],
)
def test_files_that_a_module_opens_in_its_package(tmp_path: Path, text: str, folders: set[str]) -> None:
    for name in ("data", "templates"):
        (tmp_path / "toylib" / name).mkdir(parents=True)
    found = named_folders(ast.parse(text), "toylib")
    assert {folder for folder in found if (tmp_path / folder).is_dir()} == folders


def test_a_changed_file_of_the_library_changes_the_digest_of_whom_reads_it(tmp_path: Path) -> None:
    write_toylib(tmp_path)
    folder = tmp_path / "toylib" / "data"
    folder.mkdir()
    (tmp_path / "toylib" / "reader.py").write_text(
        "from importlib import resources\n\ndef read(name):\n"
        "    return resources.files('toylib').joinpath(f'data/{name}.csv').read_text()\n"
    )
    (tmp_path / "toylib" / "user.py").write_text("def f():\n    from .reader import read\n    return read('a')\n")
    found = {}
    for text in ("1\n", "2\n"):
        (folder / "a.csv").write_text(text)
        sources = LibrarySources(tmp_path, "toylib")
        found[text] = [sources.collect([f"toylib.{name}"]).digest for name in ("user", "scaling")]
    assert found["1\n"][0] != found["2\n"][0] and found["1\n"][1] == found["2\n"][1]


def test_steps_see_the_templates_and_schedules_that_the_library_reads_for_them() -> None:
    context = RunContext(Workspace(PROJECT), Display(PROJECT / "unused"))
    assert "dieseltwin/report/templates" in discover.discover.code(context).data
    assert "dieseltwin/data" in prove.benchmark.code(context).data


def test_every_file_of_the_library_that_is_no_code_is_known_to_be_read() -> None:
    """A new way to open one would be missed by the keys; here it is noticed."""
    library = PROJECT / "dieseltwin"
    modules = [path for path in library.rglob("*.py") if "__pycache__" not in path.parts]
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in modules}
    known = set().union(*(named_folders(tree, path.parent.relative_to(PROJECT).as_posix())
                          for path, tree in trees.items()))  # fmt: skip
    others = {library / "py.typed", library / "params.yaml"}  # what a step reads of the settings is in its parameters
    for path in library.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".py" and path not in others:
            assert path.parent.relative_to(PROJECT).as_posix() in known, path
