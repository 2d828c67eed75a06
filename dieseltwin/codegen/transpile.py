"""From the equations' Python to C: the same text, read as a syntax tree, so that no equation is written twice.

The equations are plain scalar Python: assignments, arithmetic, comparisons, calls of other equations, fields of named
tuples. That subset is translated; whatever lies outside is refused by name. Docstrings become comments.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dieseltwin.errors import DieselTwinError

REAL, TRUTH = "double", "int"

PRIMITIVES = {
    "exp": (1, REAL), "root": (1, REAL), "positive_power": (2, REAL), "maximum": (2, REAL), "minimum": (2, REAL),
    "where": (3, REAL),
}  # fmt: skip
"""Functions that stand ready in C (`c/primitives.c`): number of arguments and type."""

_OF_MODULES = {"log": "log", "exp": "exp", "sqrt": "sqrt", "maximum": "maximum", "minimum": "minimum"}
_OF_C = frozenset([
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "float",
    "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof",
    "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while",
])  # fmt: skip
_REALS = ("Array", "float", "Any", "int")
_OPERATORS: dict[type[ast.AST], tuple[str, int]] = {
    ast.Add: ("+", 1), ast.Sub: ("-", 1), ast.Mult: ("*", 2), ast.Div: ("/", 2),
}  # fmt: skip
_RELATIONS: dict[type[ast.AST], str] = {ast.Gt: ">", ast.Lt: "<", ast.GtE: ">=", ast.LtE: "<="}
_UNARY, _ATOM = 3, 4
_WIDTH = 110
_SHORT = 3  # fields of a tuple that stand in one line


class NotTranslatedError(DieselTwinError):
    """An equation uses what has no counterpart in C here."""


@dataclass(frozen=True)
class Equation:
    """An equation as it is written.

    Attributes:
        node: its definition.
        scope: the names that it sees beside its arguments.
    """

    node: ast.FunctionDef
    scope: Mapping[str, Any]

    @classmethod
    def of(cls, function: Callable[..., Any]) -> Equation:
        """The equation of a function of a module."""
        return cls.of_text(textwrap.dedent(inspect.getsource(function)), vars(sys.modules[function.__module__]))

    @classmethod
    def of_text(cls, text: str, scope: Mapping[str, Any]) -> Equation:
        """The equation that a text defines."""
        (node,) = ast.parse(text).body
        if not isinstance(node, ast.FunctionDef):
            raise NotTranslatedError(f"no function: {text[:60]!r}")
        return cls(node, scope)


@dataclass(frozen=True)
class Expression:
    """A C expression with its type and how tightly it binds."""

    text: str
    type: str = REAL
    binds: int = _ATOM

    def inside(self, least: int) -> str:
        """The text, in parentheses where it binds less than `least`."""
        return self.text if self.binds >= least else f"({self.text})"


@dataclass(frozen=True)
class Signature:
    """Of a translated function: its name in C, types and names of its arguments, type of its value."""

    name: str
    arguments: tuple[tuple[str, str], ...]
    type: str


@dataclass
class _Scope:
    """What is known inside one function."""

    equation: Equation
    types: dict[str, str] = field(default_factory=dict)
    functions: dict[str, str] = field(default_factory=dict)  # an argument that is a function -> the one that is meant
    values: dict[str, Mapping[str, float]] = field(default_factory=dict)  # an argument whose entries are known
    rest: tuple[str, ...] = ()  # names of what *arguments holds


def number(value: float) -> str:
    """A number as C writes it: a double, whatever it is in Python."""
    text = repr(float(value))
    if text in ("inf", "-inf", "nan"):
        raise NotTranslatedError(f"the number {text}")
    return text


def spelled(name: str) -> str:
    """A name that C accepts: its own words get an underscore."""
    return f"{name}_" if name in _OF_C else name


def comment(text: str) -> str:
    """A docstring as a comment."""
    flat = " ".join(text.split()).replace("*/", "* /")
    return "/* " + "\n   ".join(textwrap.wrap(flat, _WIDTH - 6)) + " */\n"


class Translation:
    """Equations translated on demand, each with what it calls before it.

    Args:
        equations: by name.
        structs: name of a tuple's type -> its fields, all of them numbers.
        known: name -> signature of what stands ready in C beside `PRIMITIVES`.
    """

    def __init__(
        self, equations: Mapping[str, Equation], structs: Mapping[str, tuple[str, ...]],
        known: Mapping[str, Signature],
    ) -> None:  # fmt: skip
        self.equations, self.structs = equations, structs
        self.signatures = dict(known)
        self.texts: list[str] = []
        self.constants: dict[str, str] = {}

    def need(self, name: str) -> Signature:
        """The equation of a name, translated if it isn't yet."""
        if name not in self.signatures:
            if name not in self.equations:
                raise NotTranslatedError(f"{name}: no such equation")
            self._translate(spelled(name), _Scope(self.equations[name]), of=name)
        return self.signatures[name]

    def with_values(self, name: str, equation: Equation, values: Mapping[str, Mapping[str, float]],
                    arguments: Mapping[str, str]) -> Signature:
        """A function of mappings: some known (`values`), the others structs (argument -> type)."""
        if name not in self.signatures:
            self._translate(spelled(name), _Scope(equation, types=dict(arguments), values=dict(values)), of=name)
        return self.signatures[name]

    def entries(self, equation: Equation, argument: str, kind: str) -> dict[str, str]:
        """Key -> C expression of a function that returns a dictionary, its mapping argument being a struct."""
        scope = _Scope(equation, types={argument: kind})
        *_, last = equation.node.body
        if not isinstance(last, ast.Return) or not isinstance(last.value, ast.Dict):
            raise self._refusal(scope, equation.node, "no dictionary is returned")
        return {
            str(ast.literal_eval(key)): self.expression(value, scope).text
            for key, value in zip(last.value.keys, last.value.values, strict=True) if key is not None
        }  # fmt: skip

    # One function

    def _translate(self, name: str, scope: _Scope, of: str, rest: tuple[tuple[str, str], ...] = ()) -> None:
        node = scope.equation.node
        arguments = []
        for argument in node.args.args:
            if argument.arg in scope.functions or argument.arg in scope.values:
                continue
            kind = scope.types.get(argument.arg) or self._type(argument.annotation, scope, argument)
            scope.types[argument.arg] = kind
            arguments.append((kind, spelled(argument.arg)))
        for kind, argument_name in rest:
            if argument_name in scope.types:
                raise self._refusal(scope, node, f"two arguments {argument_name}")
            scope.types[argument_name] = kind
        scope.rest = tuple(argument_name for _, argument_name in rest)
        arguments += rest
        if node.args.kwonlyargs or node.args.defaults or node.args.kwarg:
            raise self._refusal(scope, node, "keywords or defaults")
        lines, result = self._body(node.body, scope)
        signature = Signature(name, tuple(arguments), result)
        self.signatures[of] = signature
        head = f"static inline {result} {name}({', '.join(f'{kind} {n}' for kind, n in arguments)})"
        words = comment(ast.get_docstring(node) or of)
        self.texts.append(words + head + "\n{\n" + "".join(f"    {line}\n" for line in lines) + "}\n")

    def _body(self, body: list[ast.stmt], scope: _Scope) -> tuple[list[str], str]:
        lines: list[str] = []
        for statement in body:
            match statement:
                case ast.Expr(value=ast.Constant(value=str())):
                    continue
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    found = self.expression(value, scope)
                    if scope.types.setdefault(name, found.type) != found.type:
                        raise self._refusal(scope, statement, f"{name} changes its type")
                    known = any(line.startswith(f"{found.type} {spelled(name)} =") for line in lines)
                    is_argument = any(a.arg == name for a in scope.equation.node.args.args) or name in scope.rest
                    kind = "" if known or is_argument else f"{found.type} "
                    lines.append(f"{kind}{spelled(name)} = {found.text};")
                case ast.Return(value=ast.expr() as value):
                    found = self.expression(value, scope)
                    return [*lines, f"return {found.text};"], found.type
                case _:
                    raise self._refusal(scope, statement, "a statement that is neither assignment nor return")
        raise self._refusal(scope, scope.equation.node, "nothing is returned")

    def _type(self, annotation: ast.expr | None, scope: _Scope, node: ast.AST) -> str:
        name = annotation.id if isinstance(annotation, ast.Name) else ""
        if name in _REALS:
            return REAL
        if name in self.structs:
            return name
        raise self._refusal(scope, node, "an argument of an unknown type")

    # Expressions

    def expression(self, node: ast.expr, scope: _Scope) -> Expression:
        """An expression of an equation in C."""
        match node:
            case ast.Constant(value=bool() | str() | None):
                raise self._refusal(scope, node, "a constant that is no number")
            case ast.Constant(value=int() | float() as value):
                return Expression(number(value))
            case ast.Name(id=name):
                return self._name(name, node, scope)
            case ast.Attribute(value=ast.Name(id="math"), attr="pi"):
                return Expression(number(3.141592653589793))
            case ast.Attribute(value=value, attr=attribute):
                return self._field(self.expression(value, scope), attribute, node, scope)
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=str() as key)):
                if name in scope.values:
                    return Expression(number(scope.values[name][key]))
                return self._field(self._name(name, node, scope), key, node, scope)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return Expression(f"-{self._real(operand, scope).inside(_UNARY)}", REAL, _UNARY)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return Expression(f"pow({self._real(left, scope).text}, {self._real(right, scope).text})")
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                sign, binds = _OPERATORS[type(op)]
                first, second = self._real(left, scope).inside(binds), self._real(right, scope).inside(binds + 1)
                return Expression(f"{first} {sign} {second}", REAL, binds)
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _RELATIONS:
                sign = _RELATIONS[type(op)]
                return Expression(f"{self._real(left, scope).inside(1)} {sign} {self._real(right, scope).inside(1)}",
                                  TRUTH, 0)
            case ast.Call(func=function, args=given, keywords=[]):
                return self._call(function, given, node, scope)
        raise self._refusal(scope, node, "an expression without a counterpart in C")

    def _real(self, node: ast.expr, scope: _Scope) -> Expression:
        found = self.expression(node, scope)
        if found.type != REAL:
            raise self._refusal(scope, node, f"arithmetic with {found.type}")
        return found

    def _name(self, name: str, node: ast.AST, scope: _Scope) -> Expression:
        if name in scope.types:
            return Expression(spelled(name), scope.types[name])
        value = scope.equation.scope.get(name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return Expression(self._constant(name, float(value)))
        raise self._refusal(scope, node, f"the name {name}")

    def _constant(self, name: str, value: float) -> str:
        text, stem, count = number(value), name.lstrip("_"), 1
        found = stem
        while self.constants.get(found, text) != text:  # two modules may use one name for two numbers
            count += 1
            found = f"{stem}_{count}"
        self.constants[found] = text
        return found

    def _field(self, of: Expression, name: str, node: ast.AST, scope: _Scope) -> Expression:
        if name not in self.structs.get(of.type, ()):
            raise self._refusal(scope, node, f"{name} of {of.type}")
        return Expression(f"{of.inside(_ATOM)}.{spelled(name)}")

    def _call(self, function: ast.expr, given: list[ast.expr], node: ast.AST, scope: _Scope) -> Expression:
        if isinstance(function, ast.Attribute):
            name = _OF_MODULES.get(function.attr, "")
            if not (isinstance(function.value, ast.Name) and function.value.id in ("np", "math") and name):
                raise self._refusal(scope, node, "a call of a method")
            return Expression(f"{name}({', '.join(self._real(item, scope).text for item in given)})")
        if not isinstance(function, ast.Name):
            raise self._refusal(scope, node, "a call of an expression")
        name = scope.functions.get(function.id, function.id)
        if name in PRIMITIVES:
            count, kind = PRIMITIVES[name]
            if len(given) != count:
                raise self._refusal(scope, node, f"{name} of {len(given)}")
            return Expression(f"{name}({', '.join(self.expression(item, scope).text for item in given)})", kind)
        if name in self.structs:
            parts = [self._real(item, scope).text for item in given]
            if len(parts) != len(self.structs[name]):
                raise self._refusal(scope, node, f"{name} of {len(parts)} fields")
            if len(parts) <= _SHORT:
                return Expression(f"({name}){{{', '.join(parts)}}}", name)
            fields = zip(self.structs[name], parts, strict=True)
            inner = "".join(f"        .{spelled(part)} = {value},\n" for part, value in fields)
            return Expression(f"({name}){{\n{inner}    }}", name)
        if self._takes_functions(name):
            return self._specialised(name, given, node, scope)
        signature = self.need(name)
        found: list[Expression] = []
        for item in given:
            if isinstance(item, ast.Starred):
                found += [Expression(spelled(rest), scope.types[rest]) for rest in scope.rest]
            else:
                found.append(self.expression(item, scope))
        return self._called(name, signature, found, node, scope)

    def _called(
        self, name: str, signature: Signature, found: Sequence[Expression], node: ast.AST, scope: _Scope
    ) -> Expression:
        if [item.type for item in found] != [kind for kind, _ in signature.arguments]:
            raise self._refusal(scope, node, f"{name} of {[item.type for item in found]}")
        return Expression(f"{signature.name}({', '.join(item.text for item in found)})", signature.type)

    # Functions of functions

    def _takes_functions(self, name: str) -> bool:
        equation = self.equations.get(name)
        return equation is not None and any(_is_callable(a) for a in equation.node.args.args)

    def _specialised(self, name: str, given: list[ast.expr], node: ast.AST, scope: _Scope) -> Expression:
        """A call with functions among its arguments: a copy of the equation in which they are named."""
        equation = self.equations[name]
        scoped, plain = _Scope(equation), []
        wanted = equation.node.args.args
        for argument, item in zip(wanted, given, strict=False):
            if not _is_callable(argument):
                plain.append(item)
            elif isinstance(item, ast.Name):
                scoped.functions[argument.arg] = item.id
            else:
                raise self._refusal(scope, node, f"{name} of a function without a name")
        plain += given[len(wanted) :]
        own = f"{name}_of_{'_'.join(scoped.functions.values())}"
        if own not in self.signatures:
            first = self.need(next(iter(scoped.functions.values())))
            count = len(given) - len(wanted)
            self._translate(own, scoped, of=own, rest=first.arguments[len(first.arguments) - count :])
        return self._called(name, self.signatures[own], [self.expression(item, scope) for item in plain], node, scope)

    @staticmethod
    def _refusal(scope: _Scope, node: ast.AST, why: str) -> NotTranslatedError:
        text = ast.unparse(node).strip().splitlines()[0]
        return NotTranslatedError(f"equation {scope.equation.node.name} can't be written as C: {why}: {text}")


def _is_callable(argument: ast.arg) -> bool:
    return argument.annotation is not None and ast.unparse(argument.annotation).startswith("Callable")


__all__ = ["Equation", "Expression", "NotTranslatedError", "Signature", "Translation", "comment", "number", "spelled"]
