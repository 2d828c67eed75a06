"""Where errors of maps within their tolerance don't act linearly: what readings scatter by there beside their noise.

A linear tolerance is taken out of every comparison (`likelihood.nuisance`). Next to an instability a map error of a few
tenths of a percent sends the turbo elsewhere; no linear tolerance covers that, and any effect that bends the trajectory
the right way would be taken for the cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.learned import LearnedTwin, belief_of
from dieseltwin.discovery.likelihood.metric import Metric, Whitening
from dieseltwin.discovery.likelihood.nuisance import Nuisance, at_sizes
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.learning.belief import MAPS_AT

_DRAWS = 16  # of the maps' errors: with two, half of the seeds miss a window in which the turbo goes elsewhere
_NOTICED = 0.2  # squared whitened distance of a window from linear, mean over draws
_TOO_FAR = 10.0  # the same, from which a window tells nothing that can be used
_MOST_LEFT_OUT = 1.0 / 3.0  # of the windows
_RUNS_AWAY = 1e9  # for a reading of a simulation that came to nothing

Bent = tuple[tuple[int, Array], ...]


def bent_windows(
    at: Linearisation, whitening: Whitening, nuisances: Sequence[Nuisance], responses: Array, seed: int
) -> tuple[np.ndarray, Bent]:
    """Windows that are left out, (W,), and of others in which maps' errors don't act linearly what that adds.

    Args:
        at: fit of health alone.
        whitening: of the readings.
        nuisances, responses: directions, and (K, n, C) how the readings respond.
        seed: of the draws.

    Returns:
        At most a third of the windows; and window -> covariance (r C, r C) of its readings, row by row, for
        `ModelScatter.bent`: the second moment of draws, which is of at most their number of directions.
    """
    twin = at.twin
    count = twin.starts.size
    bend = _bend if belief_of(twin) is None else _learned_bend
    if not any(nuisance.signal is not None or nuisance.loading is not None for nuisance in nuisances):
        return np.zeros(count, dtype=bool), ()
    rng = np.random.default_rng(seed)
    metric = Metric(whitening, twin.starts, at.local_response, twin.state_scales)
    squared, drawn = np.zeros(count), []
    for _ in range(_DRAWS):
        bent = bend(at, nuisances, responses, rng.standard_normal(len(nuisances)))
        drawn.append(np.nan_to_num(bent, nan=_RUNS_AWAY, posinf=_RUNS_AWAY, neginf=-_RUNS_AWAY))
        rows = metric.without_local(drawn[-1][None])[0][: bent.size].reshape(bent.shape)
        squared += np.add.reduceat((rows**2).sum(axis=1), twin.starts) / _DRAWS
    left_out = squared > max(_TOO_FAR, float(np.quantile(squared, 1.0 - _MOST_LEFT_OUT)))
    found, ends = [], np.append(twin.starts, twin.time_s.size)
    for window in np.flatnonzero((squared > _NOTICED) & ~left_out):
        within = np.stack([bent[ends[window] : ends[window + 1]].reshape(-1) for bent in drawn])
        found.append((int(window), within.T @ within / _DRAWS))
    return left_out, tuple(found)


def _bend(at: Linearisation, nuisances: Sequence[Nuisance], responses: Array, sizes: Array) -> Array:
    """How far the readings are from linear (n, C) at errors of maps, `sizes` (K,) in standard deviations."""
    signals, linear = at_sizes(at.twin, nuisances, responses, sizes)
    return np.asarray(at.twin.simulate(at.fit.lanes(signals=signals))[0] - at.simulated - linear)


def _learned_bend(at: Linearisation, nuisances: Sequence[Nuisance], responses: Array, sizes: Array) -> Array:
    """As `_bend`, at what is still open of the maps of an engine that was learned."""
    linear = np.tensordot(sizes, np.stack([n.of_maps for n in nuisances]), 1)  # type: ignore[misc]
    change = np.tensordot(sizes, np.stack([n.loading for n in nuisances]), 1)[MAPS_AT]  # type: ignore[misc]
    twin = cast(LearnedTwin, at.twin)
    drawn = twin.deviating(twin.deviation + change, twin.moved)
    return np.asarray(drawn.simulate(at.fit.lanes())[0] - at.simulated - linear)
