"""Ranks, for what is told by order alone."""

from __future__ import annotations

import numpy as np
import pandas as pd


def ranks(values: np.ndarray) -> np.ndarray:
    """Ranks (m,) of values (m,), those of one value share their mean (scipy.stats takes half a second to import)."""
    return pd.Series(values).rank().to_numpy()
