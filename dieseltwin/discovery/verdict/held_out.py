"""The later part of a recording, kept from a fit: how well it is foretold before and after the repair."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Array, Twin, rows_of
from dieseltwin.discovery.twins.several import SeveralTwin

HELD_SHARE = 0.3
"""Of the windows, the last ones; of several recordings the last ones of each."""


def held_windows(twin: Twin) -> np.ndarray:
    """(W,) True for windows that are kept from the fit."""
    recordings = twin.rows if isinstance(twin, SeveralTwin) else (slice(0, twin.time_s.size),)
    held = np.zeros(twin.starts.size, dtype=bool)
    for rows in recordings:
        first = rows.start + (1.0 - HELD_SHARE) * (rows.stop - rows.start)
        held |= (twin.starts >= first) & (twin.starts < rows.stop)
    return held


def held_out_scores(found: Search, after: Array) -> tuple[float, float]:
    """Negative log-likelihood per sample of the held-out windows, before and after the repair.

    Parameters and magnitudes are refitted, linearly about the full fit, on the other windows alone.
    """
    before = _score(found, found.null, found.null.residual)
    if found.kind == "healthy":
        return before, before
    if found.kind == "law" or found.best is None:
        return before, _score(found, found.null, found.twin.measured - after)
    return before, _score(found, found.best, found.best.residual)


def _score(found: Search, at: Linearisation, residual: Array) -> float:
    twin = found.twin
    held = held_windows(twin)
    if not held.any() or held.all():
        return float("nan")
    rows = rows_of(twin, held)
    residual = np.nan_to_num(residual)
    nuisances = at.nuisance_response if at.nuisance_response is not None else np.zeros((0, *residual.shape))
    columns = np.concatenate([at.jacobian, nuisances])
    precision = np.concatenate([np.maximum(at.precision, 1e-30), np.ones(len(nuisances))])
    training = at.metric.without_local(np.where(rows[:, None], 0.0, columns))
    target = at.metric.without_local(np.where(rows[:, None], 0.0, residual)[None])[0]
    change = np.linalg.solve(training @ training.T + np.diag(precision), training @ target)
    rest = residual - np.tensordot(change, columns, 1)
    later = at.metric.without_local(np.where(rows[:, None], rest, 0.0)[None])[0]
    logs = at.whitening.log_normaliser(at.whitening.present & rows[:, None])
    return float((0.5 * later @ later + logs) / max(rows.sum(), 1))
