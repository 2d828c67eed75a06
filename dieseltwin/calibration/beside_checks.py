"""What is seen in judged points beside those of their reference before anything is fitted: another engine or unit."""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.notes import Note, listing
from dieseltwin.recordings.steady_points import JUDGED, STATES, SteadyPoints

FARTHEST = 1.6  # times what the reference reads at the same inputs, in the middle point: no fault of the catalogue does
FARTHEST_EGR = 3.0  # the same of EGR, which a stuck valve and soot change far more
SHRINK = 0.1  # of the regression's columns, each of unit spread: points may be few
SMALL = 1e-3  # of a middle reading: below, logarithms say nothing


def far_from_reference(points: SteadyPoints) -> list[Note]:
    """A note where readings of the judged points are far from what the reference reads at the same inputs.

    Args:
        points: of a reference and judged.
    """
    known = points[JUDGED] < 0.5
    inputs = np.column_stack([np.log(np.maximum(points.inputs()[:, :2], 1.0)), points.inputs()[:, 2:] / 100.0])
    inputs = (inputs - inputs[known].mean(axis=0)) / np.maximum(inputs[known].std(axis=0), SMALL)
    inside = (np.abs(inputs) < 1.1 * np.abs(inputs[known]).max(axis=0)).all(axis=1)
    along = np.column_stack([np.ones(points.size), inputs, inputs**2, inputs[:, :1] * inputs[:, 1:]])
    off, columns = [], []
    for name in STATES:
        readings = points[name]
        middle = float(np.nanmedian(readings[known])) if np.isfinite(readings[known]).any() else 0.0
        used = np.isfinite(readings) & (readings > SMALL * middle) & inside
        if (used & known).sum() < along.shape[1] or not (used & ~known).any() or middle <= 0.0:
            continue
        times = _times(along, np.where(used, np.log(np.maximum(readings, SMALL * middle)), 0.0), used & known,
                       used & ~known)  # fmt: skip
        limit = FARTHEST_EGR if name == "w_egr_kg_s" else FARTHEST
        if not 1.0 / limit < times < limit:
            off.append(f"{name} is {times:.2g} times")
            columns.append(name)
    if not off:
        return []
    return [Note(f"{listing(off)} what the reference reads at the same inputs: is it the same engine, and the same "
                 "unit?", "wrong_engine", tuple(columns))]  # fmt: skip


def _times(along: Array, logarithm: Array, known: Array, judged: Array) -> float:
    """The middle judged reading over what the known ones foretell at its inputs [-]."""
    A, y = along[known], logarithm[known]
    shrink = SHRINK * np.diag([0.0, *np.ones(A.shape[1] - 1)])
    told = along[judged] @ np.linalg.solve(A.T @ A + shrink, A.T @ y)
    return float(np.exp(np.median(logarithm[judged] - told)))
