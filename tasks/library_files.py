"""Which files beside its code does a module of the library read? Told from the text, the module isn't imported.

Three ways of opening a file of the package are known: ``importlib.resources.files(PACKAGE)``, Jinja's
``PackageLoader(PACKAGE)`` and ``Path(__file__).parent / NAME``. What they name is taken as a folder with all its files.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence

_TEMPLATES = "templates"  # PackageLoader's own default


def named_folders(tree: ast.Module, package: str) -> frozenset[str]:
    """Folders (relative to the project, POSIX) whose files a module of that package (a path) reads, if they are there.

    A file of ``resources.files`` whose folder isn't spelled out stands for the whole package.
    """
    nodes = tuple(ast.walk(tree))
    return frozenset((*_of_loaders(nodes), *_of_resources(nodes), *_beside(nodes, package)))


def _of_loaders(nodes: Sequence[ast.AST]) -> Iterator[str]:
    for call in _calls(nodes, "PackageLoader"):
        names = [argument.value for argument in call.args if isinstance(argument, ast.Constant)]
        if names:
            yield "/".join([*str(names[0]).split("."), str(names[1]) if len(names) > 1 else _TEMPLATES])


def _of_resources(nodes: Sequence[ast.AST]) -> Iterator[str]:
    inner = {}
    for node in nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "joinpath":
            inner[id(node.func.value)] = _beginning(node.args[0]) if node.args else ""
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
            inner[id(node.left)] = _beginning(node.right)
    for call in _calls(nodes, "files"):
        if call.args and isinstance(call.args[0], ast.Constant):
            package = str(call.args[0].value).replace(".", "/")
            folder = inner.get(id(call), "").rpartition("/")[0]
            yield f"{package}/{folder}" if folder else package


def _beside(nodes: Sequence[ast.AST], package: str) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and _ends_in_own_folder(node.left):
            yield f"{package}/{_beginning(node.right)}"


def _ends_in_own_folder(node: ast.expr) -> bool:
    """Whether it is ``Path(__file__).parent``, perhaps resolved."""
    if not isinstance(node, ast.Attribute | ast.Call):
        return False
    return ast.unparse(node).replace(".resolve()", "") == "Path(__file__).parent"


def _beginning(node: ast.expr) -> str:
    """What a text begins with, as far as it is written out."""
    if isinstance(node, ast.JoinedStr) and node.values:
        node = node.values[0]
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def _calls(nodes: Sequence[ast.AST], name: str) -> Iterator[ast.Call]:
    for node in nodes:
        if isinstance(node, ast.Call) and name in (getattr(node.func, "id", None), getattr(node.func, "attr", None)):
            yield node
