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
    "engine": {"step_s": 0.025},  # as far apart as the finest labels; stable
    # no set can be much shorter: a minute of random driving behind its schedules
    "driving": {
        "sets": {
            "set_i": {"duration_s": 2860},
            "set_ii": {"duration_s": 1080},
            "set_iii": {"duration_s": 900},
            "set_iv": {"duration_s": 900},
        }
    },
    "pretrain": {
        "maps": {
            "paper": {"hidden": [8, 8], "steps": 30, "batch": 64, "finish_steps": 80, "finish_cells": 1000},
            "improved": {"cells": 200, "starts": 2, "members": 2, "steps": 4, "refine_steps": 2, "rounds": 1},
        },
        "operators": {"egr": {"updates": 60, "batch": 64}, "vgt": {"updates": 60, "batch": 64}},
        "bodies": {
            "heads": 40,
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


FRESH: dict[Path, Path] = {}
"""File of a workspace -> one as it is where nothing was done yet, but for what takes seconds each time."""

_CODE = Path(".cache") / "code.json"  # what the library's modules say


def write_params(root: Path) -> Path:
    """The project's params.yaml with the profile ``tiny`` in the workspace ``root``, and what is `FRESH`."""
    for place, template in FRESH.items():
        if template.exists() and not (root / place).exists():
            (root / place).parent.mkdir(exist_ok=True)
            shutil.copy(template, root / place)
    if not (_CODE in FRESH and FRESH[_CODE].exists()):
        FRESH[_CODE] = root / _CODE
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
