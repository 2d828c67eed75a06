"""Initial states of every window at their minimum, the rest held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dieseltwin.discovery.likelihood.metric import Metric
from dieseltwin.discovery.twins.interface import Array, Twin, rows_of

_SETTLED = 1e-3  # of a state's scale
_SHORTER = 0.3  # a window's next step after one that led uphill


def bounded(twin: Twin, local: Array) -> Array:
    """Initial states (W, S) kept near what the readings say, where the twin says how near (`local_limits`).

    Far from the truth a step of the parameters drags initial states into other basins, from where no step leads back.
    """
    limits = twin.local_limits()
    return local if limits is None else np.clip(local, *limits)


def settled_windows(
    twin: Twin, metric: Metric, local: Array, residual: Array, elsewhere: Array,
    residual_at: Callable[[Array], Array], rounds: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Initial states (W, S) at their minimum, each window by itself, and the residual (n, C) there.

    A full linear step overshoots in a window that is nearly unstable, so each window's own misfit decides on its step.
    The arrays that were given are returned where no step was worth taking.

    Args:
        twin: of the readings; metric: in which windows' misfits count.
        local: where to begin; residual: readings less simulation there.
        elsewhere: (n, C) what is not the initial states' of the residual.
        residual_at: residual at initial states; rounds: most steps.
    """
    cost, shrink = metric.window_costs(residual - elsewhere), np.ones(len(local))
    for _ in range(rounds):
        step = metric.local_step(residual - elsewhere)
        if not np.any(np.abs(step) > _SETTLED * twin.state_scales):
            break
        trial = bounded(twin, local + shrink[:, None] * step)
        moved = residual_at(trial)
        costs = metric.window_costs(moved - elsewhere)
        better = costs < cost
        local = np.where(better[:, None], trial, local)
        residual = np.where(rows_of(twin, better)[:, None], moved, residual)
        cost = np.where(better, costs, cost)
        shrink = np.where(better, np.minimum(1.0, 2.0 * shrink), _SHORTER * shrink)
    return local, residual


__all__ = ["bounded", "settled_windows"]
