"""Points far off what all the others say: which rows they are, and which reading would have to be another one.

A fit that is robust bounds what such a point does, but doesn't end it: one p_em ten times too high among 60 points
moved a boost leak by one and a half of its deviations.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dieseltwin.calibration.likelihood import FLOOR, balance_deviation
from dieseltwin.calibration.steady_model import SteadyModel
from dieseltwin.notes import Note, listing
from dieseltwin.recordings.steady_points import JUDGED, STATES, SteadyPoints

Array = NDArray[np.float64]

FAR_OFF = 15.0  # deviations of a balance; 145 points of an engine whose flap the model lacks come to 10
FEW = 0.05  # of the points: where more of them are far off it is no slip of single readings
CURED = 1.0 / 3.0  # a reading is wrong if another one alone lowers the worst balance to this; map errors are left
TRIED = 120  # values of a reading, evenly spaced on a logarithmic scale,
BEYOND = 1.5  # from the points' lowest by this factor less to their highest by this factor more


def without_slips(model: SteadyModel, points: SteadyPoints,
                  values: Mapping[str, float]) -> tuple[SteadyPoints, list[Note]]:  # fmt: skip
    """The points without those that only a slip of one reading explains, and a note for each point that is far off.

    Args:
        model: relations, with what is known to act.
        points: n settled points.
        values: coefficients and magnitudes of terms, fitted robustly.
    """
    residual = np.abs(np.nan_to_num(model.relations(points, points.states(), values).residual[0]))
    deviation = balance_deviation(model, points, values, np.maximum(1.4826 * np.median(residual, axis=0), FLOOR))
    off = residual / deviation
    rows = np.flatnonzero(np.max(off, axis=1) > FAR_OFF)
    if not 0 < rows.size <= max(1.0, FEW * points.size):
        return points, []
    keep, notes = np.ones(points.size, dtype=bool), []
    for i in rows:
        instead = _would_fit(model, points, values, int(i), np.median(deviation, axis=0))
        keep[i] = not instead
        balances = [model.rows[k].replace("_", " ") for k in np.argsort(-off[i]) if off[i, k] > FAR_OFF]
        notes.append(_note(points, int(i), balances, instead))
    return points.take(keep), notes


def _note(points: SteadyPoints, i: int, balances: list[str], instead: Mapping[str, float]) -> Note:
    where = " of the reference" if JUDGED in points and points[JUDGED][i] < 0.5 else ""
    text = f"data row {points.row[i]}{where} lies far off what the other points say ({listing(balances)})"
    if not instead:
        return Note(f"{text}; no single reading would mend it, and the fit gives it little weight", "spikes")
    others = [f"{name} at about {_plain(value)} in place of {_plain(points[name][i])}"
              for name, value in instead.items()]  # fmt: skip
    return Note(f"{text} and is left out; it would fit with {listing(others, 'or')}", "spikes", tuple(instead))


def _would_fit(model: SteadyModel, points: SteadyPoints, values: Mapping[str, float], i: int,
               deviation: Array) -> dict[str, float]:  # fmt: skip
    """Readings of a point of which each alone would cure all its balances, if it were another one [its unit].

    Args:
        deviation: (R,) what a balance may usually be off by [-].
    """
    here, readings = points.take(np.array([i])), points.states()

    def worst(x: Array) -> Array:
        residual = np.nan_to_num(model.relations(here, x, values).residual[:, 0])
        return np.max(np.abs(residual) / deviation, axis=1)

    now = float(worst(readings[[i]])[0])
    found = {}
    for j, name in enumerate(STATES):
        others = np.delete(readings[:, j], i)
        tried = np.geomspace(np.nanmin(others) / BEYOND, np.nanmax(others) * BEYOND, TRIED)
        x = np.repeat(readings[[i]][None], TRIED, axis=0)
        x[:, 0, j] = tried
        off = worst(x)
        if np.isfinite(readings[i, j]) and off.min() < CURED * now:
            found[name] = float(tried[np.argmin(off)])
    return found


def _plain(value: float) -> str:
    """Three digits without an exponent, as readings are written down."""
    return f"{float(f'{value:.3g}'):g}"
