"""A drive and engines that are written as C and as FMUs."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dieseltwin.engine import Inputs
from dieseltwin.engine.inputs import INPUT_COLUMNS

REFERENCE = Path(__file__).parents[1] / "reference" / "field_random_300s.csv"
ROWS = 301


@pytest.fixture(scope="session")
def drive() -> Inputs:
    """A minute of driving with an exhaust flap that moves."""
    table = pd.read_csv(REFERENCE, usecols=["time_s", *INPUT_COLUMNS], nrows=ROWS)
    columns = [table[name].to_numpy() for name in ("time_s", *INPUT_COLUMNS)]
    return Inputs(*columns, u_flap_pct=60.0 + 20.0 * np.sin(columns[0] / 7.0))


@pytest.fixture(scope="session")
def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        pytest.skip("no C compiler")
    return found
