"""Steps with nothing of the engine in them: what is tested is the cache, not the library. They import `toylib`, which
the tests write into a temporary folder."""

from __future__ import annotations

import os
import time
from pathlib import Path

from tasks.run_context import step


@step("toy-make", "toy data", expected_s=1.0)
def make(out: Path, progress, *, count: int, seed: int) -> None:
    """Numbers in a file."""
    import numpy as np
    from toylib.draw import draw

    progress(1, 2)
    np.savetxt(out / "numbers.txt", draw(count, seed))
    (out / "runtime.json").write_text(f'{{"pid": {os.getpid()}}}')


@step("toy-sum", "toy sum", expected_s=1.0)
def total(out: Path, progress, *, numbers: Path, scale: float) -> None:
    """Their scaled sum; waits while a file tells it to, so that a test can kill it."""
    import numpy as np
    from toylib.scaling import scaled

    (out / "half.txt").write_text("half-written")
    hold = os.environ.get("TOY_HOLD")
    while hold and Path(hold).exists():
        time.sleep(0.05)
    (out / "total.txt").write_text(repr(scaled(float(np.loadtxt(numbers / "numbers.txt").sum()), scale)))


@step("toy-fail", "toy failure")
def fail(out: Path, progress, *, user: bool) -> None:
    """Fails after writing half."""
    from toylib import errors

    (out / "half.txt").write_text("half-written")
    raise errors.InputError("wrong column") if user else ValueError("broken")


@step("toy-loaded", "toy libraries")
def loaded(out: Path, progress) -> None:
    """Which of its libraries a step finds loaded when it begins."""
    import sys

    (out / "loaded.txt").write_text(" ".join(sys.modules))
    from toylib.pictures import VERSION

    (out / "version.txt").write_text(VERSION)


def written(out: Path, progress, *, word: str) -> None:
    """One text that two steps share, as the methods do."""
    (out / "word.txt").write_text(word)


SHARED = {
    name: step(f"toy-{name}", f"toy {name}", expected_s=1.0, entries=(f"toylib.{name}",))(written)
    for name in ("draw", "report")
}
