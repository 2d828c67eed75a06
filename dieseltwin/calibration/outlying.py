"""Points far off what all the others say: which rows they are, and which reading would have to be another one.

A fit that is robust bounds what such a point does, but doesn't end it: one p_em ten times too high among 60 points
moved a boost leak by one and a half of its deviations.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dieseltwin.arrays import MAD_TO_STD, Array
from dieseltwin.calibration.likelihood import FLOOR, balance_deviation, reading_noise
from dieseltwin.calibration.steady_model import SteadyModel
from dieseltwin.notes import Note, listing
from dieseltwin.recordings.steady_points import JUDGED, LEAST, STATES, SteadyPoints

FAR_OFF = 15.0  # deviations of a balance; 145 points of an engine whose flap the model lacks come to 10
FEW = 0.05  # of the points: where more of them are far off it is no slip of single readings
CURED = 1.0 / 3.0  # a reading is wrong if another one alone lowers the worst balance to this; map errors are left
OF_NOISE = 4.0  # deviations of a reading: what they explain is no slip
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
    deviation = balance_deviation(model, points, values, np.maximum(MAD_TO_STD * np.median(residual, axis=0), FLOOR))
    off = residual / deviation
    rows = np.flatnonzero(np.max(off, axis=1) > FAR_OFF)
    if not 0 < rows.size <= max(1.0, FEW * points.size):
        return points, []
    keep, notes = np.ones(points.size, dtype=bool), []
    noise = np.nan_to_num(reading_noise(points.states()))
    for i in rows:
        instead = _would_fit(model, points, values, int(i), np.median(deviation, axis=0), noise[i])
        if instead is None:
            continue
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
               deviation: Array, noise: Array) -> dict[str, float] | None:  # fmt: skip
    """Readings of a point of which each alone would cure all its balances, if it were another one [its unit].

    None where the noise of one reading cures them: beside a kink a balance is bent, and its slope says nothing of the
    other side (p_em read below p_im, where no EGR flows).

    Args:
        deviation: (R,) what a balance may usually be off by [-].
        noise: (6,) relative standard deviation of each reading [-].
    """
    readings = points.states()

    def worst(lanes: Array) -> Array:
        """Of the point's balances, (B,), at B sets of its readings (B, 6); a small flow is one beside the others."""
        x = np.repeat(readings[None], len(lanes), axis=0)
        x[:, i] = lanes
        residual = np.nan_to_num(model.relations(points, x, values).residual[:, i])
        return np.max(np.abs(residual) / deviation, axis=1)

    cured = CURED * float(worst(readings[[i]])[0])
    step = OF_NOISE * np.diag(noise)
    if worst(np.maximum(readings[i] * (1.0 + np.concatenate([step, -step])), LEAST)).min() < cured:
        return None
    found = {}
    for j in np.flatnonzero(np.isfinite(readings[i])):
        others = np.delete(readings[:, j], i)
        lanes = np.repeat(readings[[i]], TRIED, axis=0)
        lanes[:, j] = np.geomspace(np.nanmin(others) / BEYOND, np.nanmax(others) * BEYOND, TRIED)
        off = worst(lanes)
        if off.min() < cured:
            found[STATES[j]] = float(lanes[np.argmin(off), j])
    return found


def _plain(value: float) -> str:
    """Three digits without an exponent, as readings are written down."""
    return f"{float(f'{value:.3g}'):g}"
