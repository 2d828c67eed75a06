"""YAML of plain values: text, numbers, yes and no, lists and mappings, each key once and nothing that grows on reading.

What a file can do beyond that is refused before a value is made: tags of other types, lists in lists thousands deep,
and aliases of aliases, by which ten lines become a billion values.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from typing import Any, ClassVar

import yaml

from dieseltwin.errors import InputError

DEEPEST = 50  # lists and mappings in each other; our own files have six
MOST_VALUES = 1_000_000  # with every alias written out; a calibrated petrol engine has some thousands

_PREFIX = "tag:yaml.org,2002:"
_MERGE = f"{_PREFIX}merge"
_TEXT = f"{_PREFIX}str"
_PLAIN = {_PREFIX + name for name in ("null", "bool", "int", "float", "str", "seq", "map")}
_SCALAR = _PLAIN - {f"{_PREFIX}seq", f"{_PREFIX}map"}
_OF_NODE = {yaml.ScalarNode: _SCALAR, yaml.SequenceNode: {f"{_PREFIX}seq"}, yaml.MappingNode: {f"{_PREFIX}map"}}


class _PlainLoader(yaml.SafeLoader):
    """SafeLoader for plain values; dates stay text."""

    yaml_implicit_resolvers: ClassVar = {
        first: [(tag, pattern) for tag, pattern in resolvers if tag == _MERGE or tag in _PLAIN]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.depth += 1
        if self.depth > DEEPEST:
            raise yaml.constructor.ConstructorError(
                None, None, f"lists and mappings more than {DEEPEST} deep", self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep=deep)
        except (ValueError, KeyError, AttributeError, IndexError, OverflowError):  # "!!int abc", and 5,000 digits
            kind = node.tag.removeprefix(_PREFIX)
            raise _error(f"{str(node.value)[:40]!r}, which is no {kind}", node) from None


def _error(problem: str, node: yaml.Node) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


def plain_yaml(text: str, where: str) -> Any:
    """The value that one YAML document of plain values holds; None for an empty one. Reading the same text again, as
    settings are, costs a copy.

    Args:
        where: name of the file, for messages.

    Raises:
        InputError: not YAML, a key twice, a value or a key of another type, too deep, or too many values.
    """
    return deepcopy(_document(text, where))


@lru_cache(maxsize=8)
def _document(text: str, where: str) -> Any:
    try:
        loader = _PlainLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        _count(node, {}, set())
        return loader.construct_document(node)
    except yaml.YAMLError as error:
        mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
        line = f" in line {mark.line + 1}" if mark is not None else ""
        problem = (error.problem if isinstance(error, yaml.MarkedYAMLError) else None) or error
        raise InputError(f"{where}{line}", problem, "YAML of text and numbers, every key once", "mend that line"
                         ) from None  # fmt: skip


def _count(node: yaml.Node, known: dict[int, int], above: set[int]) -> int:
    """Values in a node with every alias written out; makes every key text.

    Args:
        known: node -> its count; above: nodes that this one is in.
    """
    if id(node) in above:
        raise _error("a list or mapping that holds itself", node)
    if id(node) in known:
        return known[id(node)]
    if node.tag not in _OF_NODE[type(node)]:
        raise _error(f"a {node.tag.removeprefix(_PREFIX)[:60]}", node)
    above.add(id(node))
    count = 1
    if isinstance(node, yaml.SequenceNode):
        count += sum(_count(item, known, above) for item in node.value)
    elif isinstance(node, yaml.MappingNode):
        _text_keys(node)
        count += sum(1 + _count(value, known, above) for _, value in node.value)
    above.remove(id(node))
    if count > MOST_VALUES:
        raise _error(f"more than {MOST_VALUES} values once the aliases are written out", node)
    known[id(node)] = count
    return count


def _text_keys(node: yaml.MappingNode) -> None:
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag not in (_MERGE, *_SCALAR):
            raise _error("a key that is no text", key)
        if key.tag != _MERGE:
            key.tag = _TEXT
        if key.value in seen:  # YAML would silently keep the last one
            raise _error(f"key {key.value[:60]!r} is given twice", key)
        seen.add(key.value)
