"""params.yaml with a profile ``tiny``: the same chain in seconds; its numbers mean nothing. Run contexts for it."""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml

from tasks import run_context
from tasks.progress import Display
from tasks.run_context import RunContext
from tasks.workspace import PROJECT, Workspace

TINY = {
    "driving": {
        "sets": {
            "set_i": {"duration_s": 3000},
            "set_iii": {"duration_s": 1200},
            "set_iv": {"duration_s": 1200},
        }
    },
    "pretrain": {
        "maps": {
            "paper": {"hidden": [8, 8], "steps": 30, "batch": 64, "finish_steps": 40, "finish_cells": 400},
            "improved": {"cells": 200, "starts": 2, "members": 2, "steps": 4, "refine_steps": 2, "rounds": 1},
        },
        "operators": {"egr": {"updates": 120, "batch": 64}, "vgt": {"updates": 120, "batch": 64}},
        "bodies": {
            "heads": 80,
            "paper": {"epochs": 5},
            "conditioned": {"epochs": 3, "lbfgs_steps": 2},
        },
    },
    "proof": {"cases": 3, "duration_s": 120.0, "baseline_cases": 0},
    # hardly trained networks: wide limits, and without the two tests that take seconds (tests/identification has them)
    "promotion": {"minutes": 3.0, "acceptance": {"balances": 0.2, "rest": 0.2, "driving": None, "known_engine": None}},
    "identify": {
        "runs": 2,
        "minutes": 1.0,
        "methods": {"few-shot-adam": {"epochs": 20, "weights_until_epoch": 10, "members": 2}},
    },
}


_known: list[Path] = []


def write_params(root: Path) -> Path:
    """The project's params.yaml with the profile ``tiny`` in the workspace ``root``.

    What the library's modules say is taken over from an earlier workspace: reading 400 of them takes seconds.
    """
    code = Path(".cache") / "code.json"
    read = next((other / code for other in reversed(_known) if (other / code).exists()), None)
    if read is not None and not (root / code).exists():
        (root / code).parent.mkdir(exist_ok=True)
        shutil.copy(read, root / code)
    _known.append(root)
    settings = yaml.safe_load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    settings["profiles"]["tiny"] = TINY
    path = root / "params.yaml"
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    return path


def new_context(root: Path) -> RunContext:
    """What a new process would begin with, in use."""
    display = Display(root / ".cache" / "expected_seconds.json")
    display.console.quiet = True
    made = RunContext(Workspace(root), display)
    run_context.use(made)
    return made
