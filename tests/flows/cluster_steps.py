"""Steps for a cluster: no library of their own, so that a worker process finds them with nothing but their module."""

from __future__ import annotations

import os
import time
from pathlib import Path

from tasks.run_context import step


@step("cluster-member", "a member of an ensemble", expected_s=1.0)
def member(out: Path, progress, *, kind: str, seed: int, hold: str | None = None) -> None:
    """Numbers of one member; the first time that ``hold`` names a file, it waits there to be killed."""
    import numpy as np

    values = np.random.default_rng(seed).normal(size=1000)
    if hold is not None and Path(hold).exists():
        Path(hold).unlink()
        (out / "held.txt").write_text(str(os.getpid()))
        time.sleep(120.0)
    np.savetxt(out / "member.txt", np.cumsum(values))


@step("cluster-mean", "their mean", expected_s=1.0)
def mean(out: Path, progress, *, first: Path, second: Path, third: Path) -> None:
    """Of three members."""
    import numpy as np

    parts = [np.loadtxt(path / "member.txt") for path in (first, second, third)]
    np.savetxt(out / "mean.txt", np.mean(parts, axis=0))
