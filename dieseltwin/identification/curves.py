"""Convergence curves of an identification as one table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from dieseltwin.identification.result import Identification

EPOCH = "epoch"


def curves_table(identification: Identification) -> pd.DataFrame | None:
    """Convergence curves of all segments in long form: epoch, segment, run, quantity, value; None without curves.

    `SegmentEstimate.curves` holds arrays (n,) or (n, R) and, under "epoch", the epochs (n,) that belong to them.
    """
    parts = []
    for number, segment in enumerate(identification.segments):
        epochs = segment.curves.get(EPOCH)
        for name, curve in segment.curves.items():
            values = np.asarray(curve, dtype=np.float64)
            if name == EPOCH or values.ndim not in (1, 2) or not len(values):
                continue
            axis = (
                np.asarray(epochs)
                if epochs is not None and len(epochs) == len(values)
                else np.arange(len(values))
            )
            for run, column in enumerate(values.reshape(len(values), -1).T):
                frame = {"epoch": axis, "segment": number, "run": run, "quantity": name, "value": column}
                parts.append(pd.DataFrame(frame))
    return pd.concat(parts, ignore_index=True) if parts else None
