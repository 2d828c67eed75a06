"""Reference traces of an independent implementation (RK4 at 1 ms), and the engines they were made with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import INPUT_COLUMNS, EngineParameters, Inputs, we2011

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
