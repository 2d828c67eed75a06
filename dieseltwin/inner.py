"""What is compiled: kernels, kept in the project's folder, and functions that compiled functions alone call.

For every function that numba compiles it makes a way in from Python and one from C, which take all arguments apart (the
model's eighty constants among them), with machine code for both. A kernel has some 180 functions, and nobody enters any
but through the kernel: without ways in the code is the same and its compilation takes less than half of the time.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core.registry import CPUDispatcher

from dieseltwin.kernel_cache import alone, kernel_folder

_PACKAGE = Path(__file__).parent
_EQUATIONS = ("engine/**/*.py", "sensors.py", "petrol/*.py", "challenge/plant*.py", "challenge/actuators.py")
"""Files whose functions and numbers kernels of other files hold."""
_SOURCES = tuple(file for pattern in _EQUATIONS for file in sorted(_PACKAGE.glob(pattern)))
_FOLDER = kernel_folder(_SOURCES, (numba.__version__, np.__version__))
numba.config.CACHE_DIR = str(_FOLDER)  # type: ignore[attr-defined]  # read when a function is declared to be compiled

_NO_WAYS_IN: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class Inner(CPUDispatcher):  # type: ignore[misc]
    """A function without a way in; called from Python, it is compiled once more behind one that has it."""

    @cached_property
    def _entered(self) -> Any:
        names = ", ".join(inspect.signature(self.py_func).parameters)
        scope: dict[str, Any] = {"inner": self}
        exec(f"def entered({names}):\n    return inner({names})\n", scope)
        return numba.njit(error_model="numpy")(scope["entered"])

    def __call__(self, *arguments: Any) -> Any:
        """For tests: as from a kernel."""
        return self._entered(*arguments)


def inner(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` for a function that is called from compiled ones."""

    def compiled(function: Callable[..., Any]) -> Any:
        made = numba.njit(**options, **_NO_WAYS_IN)(function)
        made.__class__ = Inner
        return made

    return compiled


class Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function that one process compiles while others that want it wait, and find what it kept."""

    def compile(self, sig: Any) -> Any:
        """As numba's: from the folder of kernels, else compiled and kept there."""
        with alone(_FOLDER / f"{self.py_func.__module__}.{self.py_func.__qualname__}.lock"):
            return super().compile(sig)


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` for a function that is called from Python; its machine code is kept in the project's folder."""

    def compiled(function: Callable[..., Any]) -> Any:
        made = numba.njit(cache=True, **options)(function)
        made.__class__ = Kernel
        return made

    return compiled
