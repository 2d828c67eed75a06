"""What a Python text says, read and never run: the digest of its code, what it imports, which definitions it uses."""

from __future__ import annotations

import ast
import copy
import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache

WHOLE = "*"
"""For the names that are taken from a module: all of them."""

# Trees (and single statements) whose meaning is kept: some times the library's.
_TREES = 8192

_PARSED_AGAIN = 5

# Dunder assignments of a package's __init__ that cannot change a result.
_INERT_NAMES = frozenset({"__all__", "__version__", "__author__"})


@lru_cache(maxsize=_TREES)
def parsed(text: str) -> ast.Module:
    """The tree of a text, which nobody may change: whoever reads the same text gets the same one.

    Before 3.11.8 Python counts the depth of all threads' trees in one place (cpython issue 106905): where the garbage
    collector lets another thread parse meanwhile, a tree is refused that nothing is wrong with, about one run in many.
    """
    for _ in range(_PARSED_AGAIN):
        try:
            return ast.parse(text)
        except SystemError:
            continue
    return ast.parse(text)


@lru_cache(maxsize=_TREES)
def imported_names(tree: ast.AST, name: str, is_package: bool, known: frozenset[str]) -> Mapping[str, frozenset[str]]:
    """Modules that ``tree`` imports, at any depth, with the names that it takes from them (``*``: the whole module).

    Modules in ``known`` are named in full, of others the top level.
    A string constant that is a known module's name counts as well ("pkg.module" or "pkg.module:function"): that is how
    lazy registries import. A package that looks for modules along its own ``__path__`` imports all that are known below
    it. What is imported for type checkers alone doesn't count, nor does a name that stands in function annotations
    alone.
    """
    found: dict[str, set[str]] = {}

    def add(module: str, imported: str) -> None:
        found.setdefault(module if module in known else module.split(".")[0], set()).add(imported)

    nodes = tuple(_running(tree))
    used = {node.id for node in nodes if isinstance(node, ast.Name)}
    exported = is_package or "__all__" in used
    if is_package and "__path__" in used:
        for module in known:
            if module.startswith(f"{name}."):
                add(module, WHOLE)
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                add(alias.name, WHOLE)
        elif isinstance(node, ast.ImportFrom):
            base = _resolve(node, name, is_package)
            for alias in node.names:
                if f"{base}.{alias.name}" in known:
                    add(f"{base}.{alias.name}", WHOLE)
                elif exported or (alias.asname or alias.name) in used or alias.name == WHOLE:
                    add(base, alias.name)
                else:
                    add(base, "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value.split(":")[0]
            if "." in text and text in known:
                add(text, WHOLE)
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


def used_definitions(source: ast.Module, wanted: Collection[str]) -> list[ast.stmt]:
    """The module's functions, classes and constants that ``wanted`` names and what those use; and what else it runs."""
    definitions: dict[str, list[ast.stmt]] = {}
    others = []
    for statement in source.body:
        names = _names_defined(statement)
        for name in names:
            definitions.setdefault(name, []).append(statement)
        if not names and not is_inert(statement):
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
        bare = copy.copy(node)
        bare.decorator_list = []
        return bare
    return node


@lru_cache(maxsize=_TREES)
def code_digest(tree: ast.AST) -> str:
    """sha256 of the code without comments, docstrings and layout."""
    parts: list[str] = []
    _write(tree, parts.append)
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def _write(node: object, put: Callable[[str], None]) -> None:
    """The tree as `ast.dump` writes it, without docstrings; twice as fast, and no copy of the tree is needed."""
    if isinstance(node, ast.AST):
        put(f"{type(node).__name__}(")
        for name in node._fields:
            value = getattr(node, name, None)
            if value is None or name == "kind":  # of a text: whether it was written u"..."
                continue
            if name == "body" and isinstance(node, _WITH_DOCSTRING) and _is_docstring(value[:1]):
                value = value[1:]
            put(f"{name}=")
            _write(value, put)
        put(")")
    elif isinstance(node, list):
        put("[")
        for item in node:
            _write(item, put)
        put("]")
    else:
        put(f"{node!r},")


_WITH_DOCSTRING = (ast.Module, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def _is_docstring(first: Sequence[ast.stmt]) -> bool:
    return any(isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str) for node in first)


def is_inert(node: ast.stmt) -> bool:
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
