"""Where the machine of settled points comes to rest, to first order about its readings, and corrections by that.

A balance that is off by 1 % moves the rest by 0.3 % or by 10 %: that of the turbocharger's power where it has little, a
nearly flat speed line of the compressor. Corrections that make balances likely leave those points where they are; of a
machine that is to be simulated it counts where it rests.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array, rms_of_most
from dieseltwin.calibration.likelihood import reading_noise
from dieseltwin.calibration.steady_model import ROWS, SteadyModel, law_variables
from dieseltwin.engine.map_corrections import CORRECTED_POINTS, basis, basis_along
from dieseltwin.recordings.steady_points import STATES, SteadyPoints

_STEP = 1e-4  # of the logarithm of a state, or of a function of a map
_LEAST_SINGULAR = 0.03  # of the balances' slopes over the states [-]: where they are flatter first order says nothing
_BESIDE = 3.0  # readings that tell as much of how far points lie off as their usual noise does
_FAR = 3.0  # times that, from which on a point counts less and less
_ROUNDS = 20


@dataclass(frozen=True)
class Rest:
    """Where the machine rests beside the readings of n points.

    Attributes:
        off: (n, 6) logarithm of the state at rest over its reading, in the order of `STATES` [-].
        along: (n, 6, F) what a coefficient of each function of the maps moves it by [-].
        read: (n, 6) whether there is such a reading, above nothing, and balances to tell by.
        noise: (n, 6) of the readings over what they read [-].
    """

    off: Array
    along: Array
    read: NDArray[np.bool_]
    noise: Array


def rest_of(
    points: SteadyPoints, model: SteadyModel, values: Mapping[str, float], which: NDArray[np.bool_]
) -> Rest:
    """By one Newton step from the readings; a state that wasn't read begins at the middle one.

    Args:
        points, model, values: as fitted.
        which: (K,) functions of `engine.map_corrections.basis` that are asked for.
    """
    x, rows = points.states_filled(), slice(len(ROWS))

    def left(states: Array, signals: Mapping[str, Array] | None = None) -> Array:
        """Balances (B, n, 6) at states (B, n, 6)."""
        moved = model if signals is None else replace(model, signals={**model.signals, **signals})
        return moved.relations(points, states, values).residual[..., rows]

    here = model.relations(points, x, values)
    r = here.residual[0, :, rows]
    steps = np.exp(_STEP * np.eye(len(STATES)))
    slopes = np.moveaxis((left(x * steps[:, None, :]) - r) / _STEP, 0, -1)
    told = np.asarray(np.isfinite(r).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2)))
    slopes, r = np.where(told[:, None, None], slopes, np.eye(len(STATES))), np.where(told[:, None], r, 0.0)
    across = np.swapaxes(slopes, 1, 2)
    inverse = np.linalg.solve(across @ slopes + _LEAST_SINGULAR**2 * np.eye(len(STATES)), across)

    functions = basis_along(law_variables(points, {k: np.asarray(v[0]) for k, v in here.quantities.items()}), which)
    maps, lanes = basis().maps[which], len(functions)
    signals = {}
    for m, name in enumerate(CORRECTED_POINTS):
        own = np.where((maps == m)[:, None], _STEP * np.nan_to_num(functions), 0.0)
        signals[name] = model.signals.get(name, 0.0) + own
    moved = (left(np.broadcast_to(x, (lanes, *x.shape)), signals) - r) / _STEP
    along = -np.einsum("nij,knj->nik", inverse, np.where(told[:, None], moved, 0.0))
    off = -np.einsum("nij,nj->ni", inverse, r)
    readings = points.states()
    return Rest(off, along, np.asarray(told[:, None] & (readings > 0.0)), reading_noise(readings))


def nearest_rest(rest: Rest, std: Array) -> Array:
    """Coefficients (F,) of the functions, with which the machine rests nearest to the readings.

    Each state's errors are weighed by how far points lie off it, few far ones setting nothing, and by its reading's
    noise at least.

    Args:
        rest: of the points; std: (F,) prior standard deviations about nought [-].
    """
    off, along = rest.off / rest.noise, std * rest.along / rest.noise[..., None]
    z: Array = np.zeros(std.size)
    for _ in range(_ROUNDS):
        left = off + along @ z
        size = np.array([
            max(rms_of_most(left[read, k], np.ones(int(read.sum())), _BESIDE), 1.0)
            for k, read in enumerate(rest.read.T)
        ])  # fmt: skip
        weight = np.where(rest.read, (1.0 + (left / (_FAR * size)) ** 2) ** -0.5 / size, 0.0)
        A, b = (along * weight[..., None]).reshape(-1, std.size), (off * weight).ravel()
        z = -np.asarray(np.linalg.solve(A.T @ A + np.eye(std.size), A.T @ b), dtype=np.float64)
    return np.asarray(std * z)
