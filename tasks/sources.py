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
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from tasks.library_files import folders_read
from tasks.store import content_hash

LIBRARY = "dieseltwin"

# Modules of declarations: of these only the imported names and what they use count.
_DECLARATIONS = frozenset(
    {"settings.params", "settings.discovery", "symbols", "identification.settings", "paper.loop_settings"}
)

# The library's link to the settings is no data of it: what a step reads of them is among its parameters.
_SETTINGS_FILE = "params.yaml"

_WHOLE = "*"

# Trees (and single statements) whose meaning is kept: some times the library's.
_TREES = 8192

# Dunder assignments of a package's __init__ that cannot change a result.
_INERT_NAMES = frozenset({"__all__", "__version__", "__author__"})


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

    An instance reads each file once: make a new one to see changed files. What a text says is worked out once a
    process; trees are never changed after that.
    """

    def __init__(self, root: Path, package: str = LIBRARY) -> None:
        self.package = package
        self._root = root
        self._files = {
            _module_name(path.relative_to(root)): path
            for path in sorted((root / package).rglob("*.py"))
            if "__pycache__" not in path.parts
        }
        self._trees: dict[str, ast.Module] = {}
        self._imported: dict[tuple[str, frozenset[str]], dict[str, frozenset[str]]] = {}
        self._digests: dict[tuple[str, frozenset[str]], str] = {}
        self._data: dict[str, dict[str, str]] = {}

    @property
    def modules(self) -> frozenset[str]:
        """Names of all modules of the package."""
        return frozenset(self._files)

    def collect(
        self, entries: Iterable[str] | Mapping[str, set[str]], own_code: Mapping[str, str] | None = None
    ) -> Sources:
        """Digest everything the modules ``entries`` import; a mapping says which names are taken from them.

        ``own_code``: further code by a label of its own (the step's function). Raises ``ModuleNotFoundError`` where an
        entry isn't a module of the package: a silent omission would return stale results.
        """
        names: dict[str, set[str]] = {}
        for entry in entries:
            names[entry] = set(entries[entry]) if isinstance(entries, Mapping) else {_WHOLE}
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
            if name in self._files:
                statements = [node for node in self._tree(name).body if not _is_inert(node)]
                if statements:
                    modules[name] = _code_digest(ast.Module(body=statements, type_ignores=[]))
        modules |= dict(own_code or {})
        data = {folder: digest for name in inside for folder, digest in self._data_of(name).items()}
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        return Sources(modules=modules, packages=_versions(frozenset(outside)), python=version, data=data)

    def _data_of(self, name: str) -> dict[str, str]:
        """Folders that the module reads, with the hashes of their contents."""
        if name not in self._data:
            folders = folders_read(self._tree(name), self._files[name], self._root)
            self._data[name] = {
                folder: content_hash(self._root / folder, without=_SETTINGS_FILE) for folder in sorted(folders)
            }
        return self._data[name]

    def _is_sliced(self, name: str, imported: Collection[str]) -> bool:
        """Whether only the imported names of that module count."""
        return name.removeprefix(f"{self.package}.") in _DECLARATIONS and _WHOLE not in imported

    def _digest(self, name: str, imported: set[str]) -> str:
        sliced = self._is_sliced(name, imported)
        key = (name, frozenset(imported) if sliced else frozenset())
        if key not in self._digests:
            tree = self._tree(name)
            if sliced:
                tree = ast.Module(body=_used_definitions(tree, imported), type_ignores=[])
            self._digests[key] = _code_digest(tree)
        return self._digests[key]

    def _tree(self, name: str) -> ast.Module:
        if name not in self._trees:
            self._trees[name] = _parsed(self._files[name].read_text(encoding="utf-8"))
        return self._trees[name]

    def _imports(self, name: str, taken: frozenset[str]) -> dict[str, frozenset[str]]:
        """What ``name`` imports for the names that are taken from it, as :func:`imported_names` gives it."""
        sliced = self._is_sliced(name, taken)
        key = (name, taken if sliced else frozenset())
        if key not in self._imported:
            tree, is_package = self._tree(name), self._files[name].name == "__init__.py"
            if sliced:
                imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
                tree = ast.Module(body=[*imports, *_used_definitions(tree, set(taken))], type_ignores=[])
            found = imported_names(tree, name, is_package, frozenset(self._files))
            self._imported[key] = {module: names for module, names in found.items() if not sliced or names != {""}}
        return self._imported[key]


@lru_cache(maxsize=_TREES)
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


@lru_cache(maxsize=_TREES)
def imported_names(tree: ast.AST, name: str, is_package: bool, known: frozenset[str]) -> Mapping[str, frozenset[str]]:
    """Modules that ``tree`` imports, at any depth, with the names that it takes from them (``*``: the whole module).

    Modules in ``known`` are named in full, of others the top level.
    A string constant that is a known module's name counts as well ("pkg.module" or "pkg.module:function"): that is how
    lazy registries import. What is imported for type checkers alone doesn't count, nor does a name that stands in
    function annotations alone.
    """
    found: dict[str, set[str]] = {}

    def add(module: str, imported: str) -> None:
        found.setdefault(module if module in known else module.split(".")[0], set()).add(imported)

    nodes = tuple(_running(tree))
    used = {node.id for node in nodes if isinstance(node, ast.Name)}
    exported = is_package or "__all__" in used
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                add(alias.name, _WHOLE)
        elif isinstance(node, ast.ImportFrom):
            base = _resolve(node, name, is_package)
            for alias in node.names:
                if f"{base}.{alias.name}" in known:
                    add(f"{base}.{alias.name}", _WHOLE)
                elif exported or (alias.asname or alias.name) in used or alias.name == _WHOLE:
                    add(base, alias.name)
                else:
                    add(base, "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value.split(":")[0]
            if "." in text and text in known:
                add(text, _WHOLE)
    found.pop("__future__", None)
    return {module: frozenset(names) for module, names in found.items()}


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of what runs: without function annotations and ``if TYPE_CHECKING:`` blocks."""
    todo = [tree]
    while todo:
        node = todo.pop()
        yield node
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            todo += node.orelse
        elif isinstance(node, ast.FunctionDef):
            todo += [child for child in ast.iter_child_nodes(node) if child is not node.returns]
        elif not isinstance(node, ast.arg):
            todo += ast.iter_child_nodes(node)


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
    source = _parsed(textwrap.dedent(inspect.getsource(module)))
    body = ast.Module(body=_used_definitions(source, {function.__name__}), type_ignores=[])
    digest = _code_digest(body)
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


def _used_definitions(source: ast.Module, wanted: set[str]) -> list[ast.stmt]:
    """The module's functions, classes and constants that ``wanted`` names and what those use; and what else it runs."""
    definitions: dict[str, list[ast.stmt]] = {}
    others = []
    for statement in source.body:
        names = _names_defined(statement)
        for name in names:
            definitions.setdefault(name, []).append(statement)
        if not names and not _is_inert(statement):
            others.append(statement)
    used: dict[str, list[ast.stmt]] = {}
    todo = list(wanted)
    while todo:
        name = todo.pop()
        if name in used or name not in definitions:
            continue
        used[name] = definitions[name]
        for statement in definitions[name]:
            todo += _names_used(statement)
    statements = {id(statement): statement for name in sorted(used) for statement in used[name]}
    return [_undecorated(statement) for statement in statements.values()] + others


@lru_cache(maxsize=_TREES)
def _names_used(statement: ast.stmt) -> tuple[str, ...]:
    return tuple(node.id for node in _running(statement) if isinstance(node, ast.Name))


def _names_defined(statement: ast.stmt) -> list[str]:
    """Names that a definition or an assignment gives (``A, B = 1, 2`` gives two); none for all other statements."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return [statement.name]
    if not isinstance(statement, ast.Assign | ast.AnnAssign):
        return []
    targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
    stored = [node for target in targets for node in ast.walk(target)]
    return [node.id for node in stored if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]


def _undecorated(node: ast.stmt) -> ast.stmt:
    """The definition without decorators: a step's label or expected seconds don't change its result."""
    if isinstance(node, ast.FunctionDef):
        copy = ast.parse(ast.unparse(node)).body[0]
        if isinstance(copy, ast.FunctionDef):
            copy.decorator_list = []
            return copy
    return node


@lru_cache(maxsize=_TREES)
def _code_digest(tree: ast.AST) -> str:
    bare = ast.parse(ast.unparse(tree))
    for node in ast.walk(bare):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(getattr(first.value, "value", None), str):
                node.body = node.body[1:]
    return hashlib.sha256(ast.dump(bare).encode()).hexdigest()


def _is_inert(node: ast.stmt) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    return isinstance(node, ast.Assign) and all(
        isinstance(target, ast.Name) and target.id in _INERT_NAMES for target in node.targets
    )


def _resolve(node: ast.ImportFrom, name: str, is_package: bool) -> str:
    if not node.level:
        return node.module or ""
    parts = name.split(".")
    parts = parts[: len(parts) - node.level + (1 if is_package else 0)]
    return ".".join(parts + ([node.module] if node.module else []))


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
