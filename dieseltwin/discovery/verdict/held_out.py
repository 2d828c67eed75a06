"""The later part of a recording, kept from a fit: how well it is foretold before and after the repair."""

from __future__ import annotations

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.search.state import Search
from dieseltwin.discovery.twins.interface import Twin, rows_of
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


def held_out_scores(found: Search, at: Linearisation) -> tuple[float, float]:
    """Negative log-likelihood per row of the held-out windows, before and after the repair.

    Health, sizes of effects and numbers of a law are refitted, linearly about the full fit, on the other windows alone.
    Which effect or form it is, its onset and its region were chosen with all of them.

    Args:
        found: the search.
        at: the chosen explanation, as `explained.explained_at`.
    """
    before = _score(found.twin, found.null)
    return before, before if found.kind == "healthy" else _score(found.twin, at)


def _score(twin: Twin, at: Linearisation) -> float:
    held = held_windows(twin)
    if not held.any() or held.all():
        return float("nan")
    rows = rows_of(twin, held)
    residual = np.nan_to_num(at.residual)
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
