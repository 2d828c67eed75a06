"""Which versions a result was made with."""

from __future__ import annotations

import platform
import sys
from importlib.metadata import PackageNotFoundError, version

from dieseltwin.version import __version__

PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "numba", "pydantic", "matplotlib", "torch")
"""What results rest on; torch is needed for learned maps and networks alone."""


def show_versions() -> None:
    """Print the versions of this package, the interpreter, the machine and what results rest on."""
    for name, found in versions().items():
        print(f"{name:<12}{found}")


def versions() -> dict[str, str]:
    """Name -> version, "not installed" where there is none."""
    found = {"dieseltwin": __version__, "python": sys.version.split()[0], "platform": platform.platform()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
