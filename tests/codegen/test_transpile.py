"""Python to C: the subset that equations are written in, and a refusal by name of all else."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from dieseltwin.codegen.transpile import Equation, NotTranslatedError, Translation

STRUCTS = {"Pair": ("a", "b")}


def _translated(*texts: str, **scope: object) -> Translation:
    equations = [Equation.of_text(text, scope) for text in texts]
    return Translation({equation.node.name: equation for equation in equations}, STRUCTS, {})


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("x - (1 - x)", 5.0), ("x / (2 * x) / 2", 0.25), ("-x**2", -9.0), ("2 * -x", -6.0), ("x - 1 - 1", 1.0),
        ("LIMIT * x", 12.0), ("pair(x, 1).b", 1.0), ("half(x) + half(x)", 3.0),
    ],
)  # fmt: skip
def test_values(expression: str, value: float, compiler: str, tmp_path: Path):
    translation = _translated(
        f"def f(x: float):\n    static = x\n    static = static + 0\n    x = static\n    return {expression}",
        "def half(x: float):\n    return x / 2", "def pair(a: float, b: float):\n    return Pair(a, b)", LIMIT=4,
    )  # fmt: skip
    signature = translation.need("f")
    constants = "".join(f"static const double {name} = {text};\n" for name, text in translation.constants.items())
    (tmp_path / "f.c").write_text(
        "#include <math.h>\n#include <stdio.h>\ntypedef struct { double a, b; } Pair;\n" + constants
        + "\n".join(translation.texts) + f'int main(void) {{ printf("%.17g", {signature.name}(3.0)); return 0; }}\n'
    )  # fmt: skip
    subprocess.run([compiler, "-Wall", "-Werror", "-o", tmp_path / "f", tmp_path / "f.c", "-lm"], check=True)
    assert float(subprocess.run([tmp_path / "f"], capture_output=True, check=True).stdout) == value


@pytest.mark.parametrize(
    "body",
    [
        "if x > 0:\n        return x\n    return 0.0", "for i in range(3):\n        x = x + i\n    return x",
        "return unknown(x)", "return other", "return x[0]", "return [x]", "return x and 1", "return x.a",
        "x, y = 1, 2\n    return x", "return x if x > 0 else 1", "return np.sinh(x)", "x = Pair(1, 2)\n    return x",
        "return Pair(1)", "return x % 2", "return 1 < x < 2", "x += 1\n    return x", "return lambda: x",
        "return (x > 1) + 1", "return maximum(x)", "pass", "return 'text'", "return f(x=1)",
    ],
)  # fmt: skip
def test_what_has_no_counterpart_is_refused(body: str):
    with pytest.raises(NotTranslatedError):
        _translated(f"def f(x: float):\n    {body}", "def g(x: float):\n    return x").need("f")


def test_unknown_types_are_refused():
    with pytest.raises(NotTranslatedError, match="unknown type"):
        _translated("def f(x: str):\n    return x").need("f")


def test_two_numbers_of_one_name_are_kept_apart():
    first = Equation.of_text("def f(x: float):\n    return LEAST * x", {"LEAST": 1.0})
    second = Equation.of_text("def g(x: float):\n    return LEAST * f(x)", {"LEAST": 2.0})
    translation = Translation({"f": first, "g": second}, {}, {})
    translation.need("g")
    assert set(translation.constants.values()) == {"1.0", "2.0"} and len(translation.constants) == 2
