"""Compiled functions that compiled functions alone call.

For every function that numba compiles it makes a way in from Python and one from C, which take all arguments apart (the
model's eighty constants among them), with machine code for both. A kernel has some 180 functions, and nobody enters any
but through the kernel: without ways in the code is the same and its compilation takes less than half of the time.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numba
from numba.core.registry import CPUDispatcher

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
