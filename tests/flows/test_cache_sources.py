"""The digest covers what an entry really imports: no less (stale results), no more (lost hours)."""

from __future__ import annotations

from pathlib import Path

import pytest
import toy_steps
from toy_library import write_toylib

from tasks.sources import LibrarySources, function_sources
from tasks.workspace import PROJECT


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


def test_imports_inside_functions_packages_and_lazy_registries_are_followed(library: Path) -> None:
    (library / "toylib" / "sub").mkdir()
    (library / "toylib" / "sub" / "__init__.py").write_text('METHODS = {"a": "toylib.sub.method:run"}\n')
    (library / "toylib" / "sub" / "method.py").write_text("def run():\n    from ..scaling import scaled\n")
    modules = LibrarySources(library, "toylib").collect(["toylib.sub"]).modules
    assert set(modules) == {"toylib.sub", "toylib.sub.method", "toylib.scaling", "toylib.constants"}


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


def test_the_engine_does_not_rest_on_the_report() -> None:
    sources = LibrarySources(PROJECT)
    modules = sources.collect(["dieseltwin.config"]).modules
    assert "dieseltwin.config" in modules
    assert not any(name.startswith(("dieseltwin.report", "dieseltwin.identification")) for name in modules)
