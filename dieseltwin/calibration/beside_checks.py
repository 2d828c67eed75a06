"""What is seen in judged points beside those of their reference before anything is fitted: another engine or unit."""

from __future__ import annotations

import numpy as np

from dieseltwin.arrays import Array
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.engine.terms import effect_terms
from dieseltwin.errors import InputError
from dieseltwin.notes import Note, listing
from dieseltwin.recordings.steady_points import JUDGED, STATES, SteadyPoints

FARTHEST = 1.6  # times what the reference reads at the same inputs, in the middle point: no fault of the catalogue does
FARTHEST_EGR = 3.0  # the same of EGR, which a stuck valve and soot change far more
SHRINK = 0.1  # of the regression's columns, each of unit spread: points may be few
SAME = 1e-4  # of a reading: four that agree by this in two points are no two measurements
_FINE = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "t_em_k")
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


def refuse_copies(points: SteadyPoints, where: str) -> None:
    """Refuse judged points that are the reference's with other digits: rounded, or converted to a unit and back.

    Args:
        points: of a reference and judged.
        where: name for messages.

    Raises:
        InputError: more than half of the judged points are.
    """
    readings = np.column_stack([points[name] for name in _FINE])
    known, judged = readings[points[JUDGED] < 0.5], readings[points[JUDGED] > 0.5]
    apart = np.abs(judged[:, None] / known - 1.0).max(axis=2)
    same = int(np.count_nonzero(np.nan_to_num(apart, nan=np.inf).min(axis=1) < SAME))
    if same > 0.5 * len(judged):
        raise InputError(where, f"{same} of {len(judged)} points whose readings are the reference's but for rounding",
                         "other points than the reference's", "judge points that the engine isn't learned from")


def terms_of_then(points: SteadyPoints, engine: EngineParameters) -> list[Note]:
    """A note where the engine file has effects: beside a reference they are taken as there at its time already.

    Args:
        points: of a reference and judged, or judged alone.
        engine: as given.
    """
    there = sorted({term.slot for term in effect_terms(engine.terms)})
    if JUDGED not in points or not there:
        return []
    return [Note(f"the engine file has {listing(there)}, which is taken as there in the reference already and isn't "
                 "looked for: give the file from when the engine was well if it came since", "reference")]  # fmt: skip


def _times(along: Array, logarithm: Array, known: Array, judged: Array) -> float:
    """The middle judged reading over what the known ones foretell at its inputs [-]."""
    A, y = along[known], logarithm[known]
    shrink = SHRINK * np.diag([0.0, *np.ones(A.shape[1] - 1)])
    told = along[judged] @ np.linalg.solve(A.T @ A + shrink, A.T @ y)
    return float(np.exp(np.median(logarithm[judged] - told)))
