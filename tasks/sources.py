"""Which code does a result rest on: the transitive imports of a library module, as a digest.

Prefect's ``TASK_SOURCE`` sees only the task's own text, so a changed helper returns a stale result; hashing the whole
library throws hours of pretraining away for a new colour in the report. Here the digest covers exactly the modules of
``dieseltwin`` that a step's entry modules import, directly or through others, inside functions too.

Files of the library that are no code (driving schedules, templates of a page) count for whom imports a module that
opens them: :mod:`tasks.library_files` tells which.

What counts is a module's code, not its text: comments, docstrings and layout are left out of the digest. Of the
settings' module, which every other imports, only the models that are really imported count: a new field for the report
doesn't run the pretraining again.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import os
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from tasks.code_reading import WHOLE, code_digest, imported_names, is_inert, parsed, used_definitions
from tasks.library_files import named_folders
from tasks.remembered import Remembered
from tasks.store import content_hash

LIBRARY = "dieseltwin"

# Modules of declarations: of these only the imported names and what they use count.
_DECLARATIONS = frozenset(
    {"settings.params", "settings.discovery", "symbols", "identification.settings", "paper.loop_settings"}
)


@dataclass(frozen=True)
class Sources:
    """The code a result rests on.

    ``modules``: module name -> sha256 of its code; ``packages``: distribution of another project -> its version;
    ``python``: ``major.minor`` of the interpreter; ``data``: folder of the library (relative to the project) whose
    files the modules read -> sha256 of its contents.
    """

    modules: Mapping[str, str]
    packages: Mapping[str, str]
    python: str
    data: Mapping[str, str] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """One sha256 over modules, versions, interpreter and data."""
        text = "\n".join(
            [self.python]
            + [f"{name} {code}" for name, code in sorted(self.modules.items())]
            + [f"{name}=={version}" for name, version in sorted(self.packages.items())]
            + [f"{name}/ {contents}" for name, contents in sorted(self.data.items())]
        )
        return hashlib.sha256(text.encode()).hexdigest()


class LibrarySources:
    """Reads the modules of one package below ``root`` (never imports them) and follows their imports.

    An instance reads each file once: make a new one to see changed files. What a text says is worked out once, here or
    in an earlier process (``remembered``); trees are never changed.
    """

    def __init__(self, root: Path, package: str = LIBRARY, remembered: Remembered | None = None) -> None:
        self.package = package
        self._root = root
        self._stamps = _stamps(root / package)
        self._remembered = remembered or Remembered()
        self._files = {
            _module_name(path.relative_to(root)): path
            for path in sorted((root / package).rglob("*.py"))
            if "__pycache__" not in path.parts
        }
        self._known = " ".join(self._files)
        self._texts: dict[str, str] = {}
        self._imported: dict[tuple[str, frozenset[str]], dict[str, frozenset[str]]] = {}
        self._digests: dict[tuple[str, frozenset[str]], str] = {}
        self._data: dict[str, dict[str, str]] = {}

    @property
    def modules(self) -> frozenset[str]:
        """Names of all modules of the package."""
        return frozenset(self._files)

    def touched(self) -> bool:
        """Whether a file of the package was written, added or removed since this was made: a hundredth of the time
        that reading them all anew takes."""
        return _stamps(self._root / self.package) != self._stamps

    def collect(
        self, entries: Iterable[str] | Mapping[str, set[str]], own_code: Mapping[str, str] | None = None
    ) -> Sources:
        """Digest everything the modules ``entries`` import; a mapping says which names are taken from them.

        ``own_code``: further code by a label of its own (the step's function). Raises ``ModuleNotFoundError`` where an
        entry isn't a module of the package: a silent omission would return stale results.
        """
        names: dict[str, set[str]] = {}
        for entry in entries:
            names[entry] = set(entries[entry]) if isinstance(entries, Mapping) else {WHOLE}
        todo = list(names)
        for name in todo:
            if name not in self._files:
                raise ModuleNotFoundError(f"no module {name!r} below {self.package}; entries: {sorted(todo)}")
        inside: dict[str, frozenset[str]] = {}
        outside: set[str] = set()
        while todo:
            name = todo.pop()
            taken = frozenset(names[name])
            # More names of a module of declarations may import more.
            if name in inside and (inside[name] == taken or not self._is_sliced(name, taken)):
                continue
            inside[name] = taken
            for module, imported in self._imports(name, taken).items():
                if module in self._files:
                    todo.append(module)
                    names.setdefault(module, set()).update(imported)
                else:
                    outside.add(module)
        modules = {name: self._digest(name, names[name]) for name in inside}
        for name in sorted({parent for module in inside for parent in _parents(module)} - set(inside)):
            # A parent package's __init__ runs too, but its re-exports aren't used: only its own statements count.
            own = self._own_statements(name) if name in self._files else ""
            if own:
                modules[name] = own
        modules |= dict(own_code or {})
        data = {folder: digest for name in inside for folder, digest in self._data_of(name).items()}
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        return Sources(modules=modules, packages=_versions(frozenset(outside)), python=version, data=data)

    def _own_statements(self, name: str) -> str:
        """Digest of what a package's __init__ does but import and name; empty where that is nothing."""

        def work() -> str:
            statements = [node for node in self._tree(name).body if not is_inert(node)]
            return code_digest(ast.Module(body=statements, type_ignores=[])) if statements else ""

        return str(self._remembered.value(work, "own statements", self._text(name)))

    def _data_of(self, name: str) -> dict[str, str]:
        """Folders that the module reads, with the hashes of their contents."""
        if name not in self._data:
            package = self._files[name].parent.relative_to(self._root).as_posix()
            folders = self._remembered.value(
                lambda: sorted(named_folders(self._tree(name), package)), "folders", package, self._text(name)
            )
            self._data[name] = {
                folder: content_hash(self._root / folder)
                for folder in folders
                if (self._root / folder).is_dir()
            }
        return self._data[name]

    def _is_sliced(self, name: str, imported: Collection[str]) -> bool:
        """Whether only the imported names of that module count."""
        return name.removeprefix(f"{self.package}.") in _DECLARATIONS and WHOLE not in imported

    def _digest(self, name: str, imported: set[str]) -> str:
        taken = frozenset(imported) if self._is_sliced(name, imported) else frozenset()

        def work() -> str:
            tree = self._tree(name)
            return code_digest(ast.Module(body=used_definitions(tree, taken), type_ignores=[]) if taken else tree)

        key = (name, taken)
        if key not in self._digests:
            names = " ".join(sorted(taken))
            self._digests[key] = str(self._remembered.value(work, "digest", names, self._text(name)))
        return self._digests[key]

    def _text(self, name: str) -> str:
        if name not in self._texts:
            self._texts[name] = self._files[name].read_text(encoding="utf-8")
        return self._texts[name]

    def _tree(self, name: str) -> ast.Module:
        return parsed(self._text(name))

    def _imports(self, name: str, taken: frozenset[str]) -> dict[str, frozenset[str]]:
        """What ``name`` imports for the names that are taken from it, as :func:`imported_names` gives it."""
        sliced = self._is_sliced(name, taken)
        key = (name, taken if sliced else frozenset())

        def work() -> dict[str, list[str]]:
            tree, is_package = self._tree(name), self._files[name].name == "__init__.py"
            if sliced:
                imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
                tree = ast.Module(body=[*imports, *used_definitions(tree, taken)], type_ignores=[])
            found = imported_names(tree, name, is_package, frozenset(self._files))
            return {module: sorted(names) for module, names in found.items() if not sliced or names != {""}}

        if key not in self._imported:
            names = " ".join(sorted(key[1])) if sliced else WHOLE
            parts = ("imports", name, str(self._files[name].name), names, self._known, self._text(name))
            found = self._remembered.value(work, *parts)
            self._imported[key] = {module: frozenset(names) for module, names in found.items()}
        return self._imported[key]


def function_sources(
    function: Callable[..., Any], known: frozenset[str] | None = None
) -> tuple[str, dict[str, set[str]]]:
    """Digest of a function and of the functions, classes and constants of its own module that it uses, and the modules
    it imports inside itself.

    Returns (sha256, imports as :func:`imported_names` gives them). What the module imports at its top level isn't
    followed: a step imports what it computes with inside itself, which also keeps the flows quick to start. Functions
    of other task modules that it imports inside itself count as its own.
    """
    module = inspect.getmodule(function)
    if module is None:
        raise ValueError(f"{function!r} has no module")
    source = parsed(textwrap.dedent(inspect.getsource(module)))
    body = ast.Module(body=used_definitions(source, {function.__name__}), type_ignores=[])
    digest = code_digest(body)
    found = imported_names(body, module.__name__, False, known or frozenset())
    imported = {name: set(names) for name, names in found.items()}
    for helper in _task_functions(body):
        helper_digest, helper_imports = function_sources(helper, known)
        digest = hashlib.sha256(f"{digest} {helper_digest}".encode()).hexdigest()
        for name, names in helper_imports.items():
            imported.setdefault(name, set()).update(names)
    return digest, imported


def _task_functions(body: ast.Module) -> list[Callable[..., Any]]:
    """Functions that the code imports from other modules of ``tasks``."""
    found = []
    for node in ast.walk(body):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tasks."):
            module = importlib.import_module(node.module or "")
            found += [getattr(module, alias.name) for alias in node.names]
    return [item for item in found if inspect.isfunction(item)]


def _stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """File below the folder -> time of its last change [ns] and size [byte]; what Python compiled is left out."""
    found = {}
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        for name in names:
            path = os.path.join(place, name)
            with suppress(FileNotFoundError):  # an editor's lock is a link to nothing; what goes meanwhile is gone
                about = os.stat(path)
                found[path] = about.st_mtime_ns, about.st_size
    return found


def _module_name(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _parents(module: str) -> list[str]:
    parts = module.split(".")
    return [".".join(parts[:depth]) for depth in range(1, len(parts))]


@lru_cache(maxsize=256)
def _versions(modules: frozenset[str]) -> Mapping[str, str]:
    """Installed versions of the distributions that give ``modules`` (standard library: none)."""
    givers = _distributions()
    names = {name for module in modules if module not in sys.stdlib_module_names for name in givers.get(module, [])}
    return {name: metadata.version(name) for name in sorted(names)}


@lru_cache(maxsize=1)
def _distributions() -> Mapping[str, list[str]]:
    return metadata.packages_distributions()
