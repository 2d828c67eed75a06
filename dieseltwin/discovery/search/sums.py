"""Effects and terms that act in a part of a recording, by sums over groups of its rows.

Masked responses needn't be projected one by one: information and push of a part are sums over its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from dieseltwin.discovery.laws.features import Structure
from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.score import Scored
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.discovery.twins.windows import window_of_rows

LEAST_SHARE = 0.08  # of the samples that a variant must act on, and leave out


class Sums:
    """Information and push of masked responses, by sums over groups of rows.

    Args:
        at: the health-only fit.
        items: effects with their responses; terms: without a name, behind them.
        least_share: of the samples that a part must hold, and leave out.
    """

    def __init__(
        self, at: Linearisation, items: Sequence[Scored], least_share: float = LEAST_SHARE,
        terms: Sequence[Structure] = (),
    ) -> None:  # fmt: skip
        metric = at.metric
        self.at, self.items, self.least_share = at, items, least_share
        responses = np.stack([*(item.response for item in items), *(term.response for term in terms)])
        self.vectors = metric.without_local(responses)  # (H, rows)
        self.rows = self.vectors.shape[1]
        self.residual = metric.without_local(np.nan_to_num(at.residual)[None])[0]
        information = at.projected @ at.projected.T + np.diag(at.precision)
        held = np.hstack([at.projected, np.diag(np.sqrt(at.precision))])  # each by its prior, in a row of its own
        parameters = solve_triangular(cholesky(information, lower=True), held, lower=True)
        bases, pull = [parameters[:, : self.rows]], [parameters[:, -len(held):] @ at.pulled_residual[-len(held):]]
        if metric.nuisance_basis is not None:
            bases.append(metric.nuisance_basis[:, : self.rows])
            pull.append(np.zeros(len(bases[-1])))
        self.basis = np.vstack(bases)  # (K, rows): tolerances and parameters
        self.known = self.basis @ self.residual + np.concatenate(pull)
        limits = np.array([
            *(at.twin.hypotheses[item.name].limits for item in items),
            *((0.0 if term.feature.behind else -np.inf, np.inf) for term in terms),
        ])  # fmt: skip
        self.low, self.high = limits[:, 0], limits[:, 1]

    def only(self, h: int) -> Sums:
        """The same for one hypothesis."""
        part = copy(self)
        part.items, part.vectors = [self.items[h]], self.vectors[h : h + 1]
        part.low, part.high = self.low[h : h + 1], self.high[h : h + 1]
        return part

    def of(self, group: np.ndarray, count: int) -> tuple[Array, Array, Array]:
        """Squares (G, H), pushes (G, H) and inner products with the basis (G, K, H) of each group of rows.

        group: (rows,) number of each row's group, -1 for rows that never act.
        """
        hypotheses = len(self.vectors)
        squares, pushes = np.zeros((count, hypotheses)), np.zeros((count, hypotheses))
        inner = np.zeros((count, self.basis.shape[0], hypotheses))
        order = np.argsort(group, kind="stable")
        edges = np.searchsorted(group[order], np.arange(count + 1))
        for g in range(count):
            at = order[edges[g] : edges[g + 1]]
            part = self.vectors[:, at]
            squares[g] = np.einsum("hr,hr->h", part, part)
            pushes[g] = part @ self.residual[at]
            inner[g] = self.basis[:, at] @ part.T
        return squares, pushes, inner

    def gains(self, squares: Array, pushes: Array, inner: Array) -> Array:
        """Gains (..., H) of sums over groups."""
        information = np.maximum(squares - (inner**2).sum(axis=-2), 1e-9 * np.maximum(squares, 1e-300))
        push = pushes - np.einsum("...kh,k->...h", inner, self.known)
        gains = gain_of(push, information, self.low, self.high)
        return np.where(information > 1e-4 * squares, gains, 0.0)

    def gains_where(self, acts: np.ndarray) -> Array:
        """Gains (H,) of acting in some samples (n,)."""
        return self.gains(*(part[0] for part in self.of(self.per_row(np.where(acts, 0, -1)), 1)))

    def per_row(self, of_sample: np.ndarray) -> np.ndarray:
        """(n,) group of each sample -> (rows,) group of each row; rows of priors belong to none."""
        channels = self.at.residual.shape[1]
        group = np.full(self.rows, -1, dtype=np.int64)
        group[: of_sample.size * channels] = np.repeat(of_sample, channels)
        return group


def gain_of(push: Array | float, information: Array | float, low: Array | float, high: Array | float) -> Array:
    """Decrease of -2 log likelihood by the best magnitude inside its limits."""
    estimate = np.clip(push / information, low, high)
    return np.asarray(estimate * (2.0 * push - estimate * information))


def gains_since(sums: Sums) -> Array:
    """Gains (W, H) of acting from the start of each window on, 0 too near to either end."""
    twin = sums.at.twin
    n, W = twin.time_s.size, twin.starts.size
    group = sums.per_row(window_of_rows(twin.starts, n))
    squares, pushes, inner = (np.cumsum(part[::-1], axis=0)[::-1] for part in sums.of(group, W))
    gains = sums.gains(squares, pushes, inner)
    allowed = (twin.starts > sums.least_share * n) & (twin.starts < (1.0 - sums.least_share) * n)
    gains[~allowed] = 0.0
    return gains


def best_onset(at: Linearisation, structure: Sequence[Structure], least_share: float) -> float:
    """Since when one of some terms without a name gains most [s], at the start of a window.

    Args:
        at: what they were scored at.
        structure: terms without a name, some.
        least_share: of the samples that lie before and behind.
    """
    gains, twin = gains_since(Sums(at, (), least_share, structure)), at.twin
    return float(twin.time_s[twin.starts[int(gains.max(axis=1).argmax())]])
