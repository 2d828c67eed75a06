"""Reference traces of an independent implementation (RK4 at 1 ms), and the engines they were made with."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import INPUT_COLUMNS, EngineParameters, Inputs, we2011
from tests.engine.grown import copied, write_effect, write_sensor

REFERENCE = Path(__file__).parents[1] / "reference"
ENGINES = {
    "lab_whtc_500s_800s": we2011.PARAMETERS,
    "field_random_300s": we2011.FIELD,
    "limits_180s": we2011.PARAMETERS,
    "step_vgt_75_65": we2011.PARAMETERS,
    "step_vgt_30_25": we2011.PARAMETERS,
}


def trace(name: str) -> tuple[pd.DataFrame, Inputs, EngineParameters, np.ndarray]:
    """Table, inputs, engine and initial state (3,) of one reference trace."""
    table = pd.read_csv(REFERENCE / f"{name}.csv")
    inputs = Inputs(*(table[column].to_numpy() for column in ("time_s", *INPUT_COLUMNS)))
    initial = table.loc[0, ["p_im_pa", "p_em_pa", "omega_t_rad_s"]].to_numpy(dtype=float)
    return table, inputs, ENGINES[name], initial


@pytest.fixture(scope="session")
def field_trace() -> tuple[pd.DataFrame, Inputs, EngineParameters, np.ndarray]:
    return trace("field_random_300s")


@pytest.fixture(scope="session")
def grown(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    """A folder with the library and both patches of `grown`, for which kernels are compiled once."""
    folder = tmp_path_factory.mktemp("grown")
    library = copied(project_root, folder)
    write_effect(library)
    write_sensor(library)
    return folder


@pytest.fixture(scope="session")
def run_grown(grown: Path) -> Callable[..., str]:
    """Python with arguments in the folder of `grown`: what it prints."""
    told = {**os.environ, "PYTHONPATH": str(grown), "NUMBA_CACHE_DIR": str(grown / "cache")}

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=grown, env=told, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run
