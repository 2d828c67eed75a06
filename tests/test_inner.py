"""Functions that compiled functions call: no way in is compiled, and from Python they answer all the same."""

from __future__ import annotations

import re
from pathlib import Path

import numba
import numpy as np

import dieseltwin
from dieseltwin.challenge import plant
from dieseltwin.engine import _compiled, bind, constants, we2011
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


def test_kernels_are_kept_in_the_projects_folder_whatever_is_imported_first() -> None:
    """Those that were declared before the engine's were kept beside their sources: the plant's was compiled twice."""
    sources = Path(dieseltwin.__file__).parent.rglob("*.py")
    declaring = {path.name for path in sources if re.search(r"\bcache\W{1,3} ?True", path.read_text(encoding="utf-8"))}
    assert declaring == {"inner.py"}
    for kernel in (plant._integrate, _compiled.integrate_one):
        assert Path(kernel.stats.cache_path).parent == Path(numba.config.CACHE_DIR)
