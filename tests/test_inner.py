"""Functions that compiled functions call: no way in is compiled, and from Python they answer all the same."""

from __future__ import annotations

import numba
import numpy as np

from dieseltwin.engine import bind, constants, we2011
from dieseltwin.inner import inner


def test_no_way_in_is_compiled() -> None:
    @inner(error_model="numpy")
    def half(x):  # type: ignore[no-untyped-def]
        return 0.5 * x

    @numba.njit
    def kernel(x):  # type: ignore[no-untyped-def]
        return half(x) + 1.0

    assert kernel(3.0) == 2.5
    (made,) = half.overloads.values()
    names = (made.fndesc.llvm_cpython_wrapper_name, made.fndesc.llvm_cfunc_wrapper_name)
    assert not any(name in made.library.get_llvm_str() for name in names)
    assert half(3.0) == 1.5 and half.py_func(3.0) == 1.5


def test_an_equation_can_be_asked_from_python() -> None:
    c, point = constants(we2011.PARAMETERS), (1.4e5, 1300.0)
    np.testing.assert_allclose(bind("numba").eta_vol(*point, c), bind("numpy").eta_vol(*point, c), rtol=1e-12)
