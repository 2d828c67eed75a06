"""A library of four lines, written into a temporary folder, and run contexts that use it."""

from __future__ import annotations

from pathlib import Path

from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.workspace import Workspace

TOYLIB = {
    "__init__.py": '"""Toy."""\n__version__ = "1"\n',
    "errors.py": "class InputError(Exception):\n    pass\n",
    "draw.py": "import numpy as np\n\ndef draw(count, seed):\n    return np.random.default_rng(seed).random(count)\n",
    "scaling.py": "from .constants import FACTOR\n\ndef scaled(x, scale):\n    return FACTOR * scale * x\n",
    "constants.py": "FACTOR = 2.0  # a helper constant of another module\n",
    "pictures.py": "import matplotlib\n\nVERSION = matplotlib.__version__\n",
    "report.py": "from .scaling import scaled\n\nCOLOUR = 'red'\n",
}


def write_toylib(root: Path) -> None:
    """The toy library below ``root``."""
    for name, text in TOYLIB.items():
        path = root / "toylib" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def fresh_context(root: Path) -> RunContext:
    """As a new process would make it: sources are read anew."""
    display = Display(root / ".cache" / "expected_seconds.json")
    display.console.quiet = True
    return RunContext(Workspace(root), display, library_root=root, library="toylib")
