"""Noise of a twin's readings: of each recording by itself, where there are several.

Sensors are the same in all of them, their noise needn't be: it goes with the driving's level, the weather and the
logger. One noise for all left 1.64 of chi-square a reading in three healthy recordings of one engine, whose noise was
0.7 to 1.5 times the usual; a noise of each leaves 1.04.
"""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.between_rows import noise_beside
from dieseltwin.discovery.twins.interface import Array, OverRecordings, Twin
from dieseltwin.recordings.noise import Noise, estimate_noise


def noise_of(twin: Twin, explained: Array | None = None, windows: tuple[Array, ...] = ()) -> Noise:
    """As `estimate_noise`, of every recording; of each reading where there are several.

    Args:
        twin: bound to its readings; explained: (n, C) a model's readings, or None.
        windows: covariance of each window that inputs between the rows make; none: they make nothing.
    """
    if not isinstance(twin, OverRecordings):
        return _of_rows(twin, slice(0, twin.measured.shape[0]), explained, windows)
    apart = [_of_rows(twin, rows, explained, windows) for rows in twin.rows]
    sizes = [rows.stop - rows.start for rows in twin.rows]
    each = (np.repeat([getattr(own, name) for own in apart], sizes, axis=0) for name in ("sigma", "rho"))
    return Noise(*each)


def _of_rows(twin: Twin, rows: slice, explained: Array | None, windows: tuple[Array, ...]) -> Noise:
    measured = twin.measured[rows]
    if explained is None:
        return estimate_noise(measured)
    noise = estimate_noise(measured, explained=explained[rows])
    inside = (twin.starts >= rows.start) & (twin.starts < rows.stop)
    own = tuple(windows[w] for w in np.flatnonzero(inside)) if windows else ()
    return noise_beside(noise, measured - explained[rows], twin.starts[inside] - rows.start, own)
