"""C texts compiled for this processor and loaded; what was compiled once lies beside the simulator's kernels."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from dieseltwin.engine._compiled import numba  # its folder is the project's

FLAGS = (
    "-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fPIC",
    "-fno-tree-sink", "-fno-tree-pre", "-fno-code-hoisting", "-fno-gcse", "-fno-thread-jumps",
)  # fmt: skip
"""Of the C compiler: fast mathematics lets sums and exp run over vectors, and no operation may move behind a condition.
One compiler on one machine gives one result."""
C_TYPES = {torch.float32: "float", torch.float64: "double"}
BLOCK = 80
"""Points that are computed side by side: five vectors of 16 numbers, ten of 8; their rows stay in the nearest cache."""


class NotCompiledError(Exception):
    """A tensor program holds something that no loop over points can be written for, or nothing compiles it."""


def networks_source(dtype: torch.dtype) -> str:
    """The head of every text: number type, block, and products and activations of small networks."""
    text = (Path(__file__).parent / "c" / "networks.c").read_text(encoding="utf-8")
    return f"#include <tgmath.h>\ntypedef {C_TYPES[dtype]} real;\nenum {{ BLOCK = {BLOCK} }};\n{text}"


def load(source: str) -> Any:
    """The loaded library of a text, compiled where that wasn't done before.

    Raises:
        NotCompiledError: no compiler, or it refuses.
    """
    compiler = next((c for c in (os.environ.get("CC"), "gcc", "cc", "clang") if c and shutil.which(c)), None)
    if compiler is None:
        raise NotCompiledError("no C compiler found")
    folder = Path(numba.config.CACHE_DIR)
    try:
        return ctypes.CDLL(str(_built(compiler, source, folder)))
    except OSError as error:
        raise NotCompiledError(f"compiled loop in {folder}: {error}") from None


@lru_cache(maxsize=4)
def _machine(compiler: str) -> str:
    """The compiler's version and the processor's abilities."""
    about = Path("/proc/cpuinfo")
    flags = about.read_text().partition("flags")[2].partition("\n")[0] if about.exists() else platform.processor()
    return subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout + flags


def _built(compiler: str, source: str, folder: Path) -> Path:
    """The library of a source, made if it isn't there; compiler and processor are part of its name."""
    name = hashlib.sha256("\0".join([source, compiler, _machine(compiler), *FLAGS]).encode()).hexdigest()[:24]
    path = folder / f"points-{name}.so"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        text, part, made = (str(Path(scratch) / f"points.{end}") for end in ("c", "o", "so"))
        Path(text).write_text(source)
        # linked on its own: a linker told of fast mathematics adds code that makes the whole process flush subnormals
        for command in ([*FLAGS, "-c", text, "-o", part], ["-shared", part, "-o", made, "-lmvec", "-lm"]):
            done = subprocess.run([compiler, *command], capture_output=True, text=True, check=False)
            if done.returncode:
                raise NotCompiledError(f"{compiler}: {(done.stderr.strip().splitlines() or ['failed'])[0]}")
        os.replace(made, path)
    return path
