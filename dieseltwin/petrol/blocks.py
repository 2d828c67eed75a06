"""Means of a petrol recording over blocks of a second, and the flows that the balances need.

A balance is integrated over a block: the mean flows in and out differ by the filling, which is the difference of the
pressures at the block's ends over its length. So time stamps are used as they are and nothing is differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.petrol.components import R_A, displaced_flow, nozzle_flow, storage_flow
from dieseltwin.petrol.recording import Signals, gaps

BLOCK_S = 1.0
EDGE_ROWS = 6  # rows averaged for a block's end pressure: the manifold pulsates by 5 % at idle
FULLEST_HOLE = 0.5  # blocks with fewer than this part of the usual rows are left out
LEAST_FACTOR = 0.05  # that a signal at a map may leave of it [-]
LEAST_FLOW = 1e-4  # kg/s, a twentieth of idle: keeps logarithms finite in overrun transients


@dataclass(frozen=True)
class Geometry:
    """Volumes of the engine: displacement, intake manifold, intercooler with pipes [m3]."""

    V_d: float
    V_im: float
    V_ic: float


@dataclass(frozen=True)
class Grid:
    """Blocks of a recording: which rows belong to which, fixed under every hypothesis. No block reaches over a gap.

    Attributes:
        index: (n,) block of each row.
        count: (m,) rows of each block.
        kept: (m,) bool, blocks full enough; the last one of a piece is seldom full.
        low, high: (m, 2) range of rows about each block's begin and end, for its end values.
        lasted_s: (m,) time between the rows nearest to a block's ends [s].
        mid_s: (m,) middle of each block [s].
        piece: (m,) number of the piece between gaps.
    """

    index: NDArray[np.int64]
    count: Array
    kept: NDArray[np.bool_]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    lasted_s: Array
    mid_s: Array
    piece: NDArray[np.int64]

    def mean(self, x: Array) -> Array:
        """(m,) mean of x over each block."""
        return np.asarray(np.bincount(self.index, x, minlength=len(self.count)) / self.count)

    def slope(self, x: Array) -> Array:
        """(m,) difference of x (smoothed over EDGE_ROWS rows) between a block's ends over their time [unit/s]."""
        total = np.concatenate([[0.0], np.cumsum(x)])
        at = (total[self.high] - total[self.low]) / (self.high - self.low)
        return np.asarray((at[:, 1] - at[:, 0]) / self.lasted_s)


def make_grid(time_s: Array) -> Grid:
    """Blocks of BLOCK_S over the rows at `time_s`, anew in every piece between gaps."""
    half, n = EDGE_ROWS // 2, len(time_s)
    index = np.empty(n, dtype=np.int64)
    parts: list[tuple[NDArray[np.int64], Array, Array, NDArray[np.bool_]]] = []  # edges (rows), span, middle, last
    at = 0
    low, high, piece = [], [], []
    starts = gaps(time_s)
    for number, (a, b) in enumerate(zip(starts, np.append(starts[1:], n), strict=True)):
        own = time_s[a:b] - time_s[a]
        blocks = np.floor(own / BLOCK_S).astype(np.int64)
        size = int(blocks[-1]) + 1
        index[a:b] = at + blocks
        edges = a + np.searchsorted(own, np.arange(size + 1) * BLOCK_S).clip(0, b - a - 1)
        ends = np.stack([edges[:-1], edges[1:]], axis=1)
        low.append(np.maximum(ends - half, a))
        high.append(np.minimum(ends + half, b))
        middle = time_s[a] + (np.arange(size, dtype=np.float64) + 0.5) * BLOCK_S
        lasted = np.maximum(np.diff(time_s[edges]), 0.5 * BLOCK_S)
        parts.append((edges, lasted, middle, np.arange(size) < size - 1))
        piece.append(np.full(size, number))
        at += size
    count = np.bincount(index, minlength=at).astype(np.float64)
    usual = float(np.median(count[count > 0]))
    kept = (count >= FULLEST_HOLE * usual) & np.concatenate([part[3] for part in parts])
    return Grid(
        index, np.maximum(count, 1.0), kept, np.concatenate(low), np.concatenate(high),
        np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts]),
        np.concatenate(piece),
    )  # fmt: skip


@dataclass(frozen=True)
class Blocks:
    """What the balances need over m blocks [SI]; see `Signals` for the symbols.

    Attributes:
        mid_s: middle of each block [s].
        omega_e, p_im, p_ic, alpha, W_af, p_amb, T_ic, T_amb: means.
        psi: flow factor of the throttle [-].
        W_d: flow that the cylinders would take at a volumetric efficiency of 1 [kg/s].
        unit_flow: flow through a throttle of 1 m2 [kg/s].
        before_throttle: air that is metered but doesn't pass the throttle: filling and leaks before it [kg/s].
        before_cylinders: air that is metered but isn't taken in: filling and leaks of both volumes [kg/s].
        log_eta, log_area: logarithm of what an effect multiplies both maps by [-].
    """

    mid_s: Array
    omega_e: Array
    p_im: Array
    p_ic: Array
    alpha: Array
    W_af: Array
    p_amb: Array
    T_ic: Array
    T_amb: Array
    psi: Array
    W_d: Array
    unit_flow: Array
    before_throttle: Array
    before_cylinders: Array
    log_eta: Array
    log_area: Array

    def cylinder(self, W_af: Array) -> Array:
        """Log of the cylinders' flow over the displaced one, log eta_vol [-], were `W_af` [kg/s] metered."""
        return np.asarray(np.log(np.maximum(W_af - self.before_cylinders, LEAST_FLOW) / self.W_d) - self.log_eta)

    def throttle(self, W_af: Array) -> Array:
        """Log of the throttle's flow over that of 1 m2, log area [m2], were `W_af` [kg/s] metered."""
        return np.asarray(np.log(np.maximum(W_af - self.before_throttle, LEAST_FLOW) / self.unit_flow) - self.log_area)

    @property
    def boost(self) -> Array:
        """log(p_ic/p_amb) [-]."""
        return np.asarray(np.log(self.p_ic / self.p_amb))

    @property
    def cooler(self) -> Array:
        """log(T_ic/T_amb) [-]."""
        return np.asarray(np.log(self.T_ic / self.T_amb))


class Once:
    """What is worked out of a recording's own arrays, and of what came of them, is worked out once.

    An effect changes a channel or two, and hundreds of hypotheses share what it leaves. An array is known by being the
    same object, so none may be changed in place.
    """

    def __init__(self, own: Iterable[Array | None] = ()) -> None:
        self._own = {id(x): x for x in own if x is not None}
        self._known: dict[tuple[object, ...], Array] = {}

    def __call__(self, name: str, work: Callable[[], Array], *of: Array) -> Array:
        """What `work` gives; the same `name` and the same own arrays `of` that it is made of: as the first time."""
        if not all(id(x) in self._own for x in of):
            return work()
        key = (name, *map(id, of))
        if key not in self._known:
            self._known[key] = value = work()
            self._own[id(value)] = value
        return self._known[key]


def blocks_of(
    s: Signals, grid: Grid, g: Geometry, added: Mapping[str, Array] | None = None, once: Once | None = None
) -> Blocks:
    """Means and flows over each block, with what an effect adds to `s` taken into account.

    Args:
        s: signals.
        grid: blocks.
        g: volumes.
        added: point of the twin -> (m,) signal that enters there: relative at `eta_vol` and `A_th`, else kg/s.
        once: what is known of these blocks already.
    """
    more, known = added or {}, once or Once()
    zero = np.zeros(len(grid.count))

    def mean(x: Array) -> Array:
        return known("mean", lambda: grid.mean(x), x)

    def slope(x: Array) -> Array:
        return known("slope", lambda: grid.slope(x), x)

    def given(x: Array | None) -> Array:
        return zero if x is None else mean(x)

    def factor(name: str) -> Array:
        return np.asarray(np.log1p(np.maximum(more.get(name, zero), LEAST_FACTOR - 1.0)))

    T_ic, p_im, p_ic = mean(s.T_ic), mean(s.p_im), mean(s.p_ic)
    before = storage_flow(slope(s.p_ic), T_ic, g.V_ic) + given(s.leak_ic) - more.get("intercooler_balance", zero)
    inside = storage_flow(slope(s.p_im), T_ic, g.V_im) - given(s.leak_im) - more.get("intake_balance", zero)
    through = (s.p_ic, s.T_ic, s.p_im)
    unit_flow = known("unit_flow", lambda: np.maximum(grid.mean(nozzle_flow(1.0, *through)), 1.0), *through)
    psi = known("psi", lambda: np.asarray(unit_flow / (p_ic / np.sqrt(R_A * T_ic))), unit_flow, p_ic, T_ic)
    omega_e = mean(s.omega_e)
    return Blocks(
        grid.mid_s, omega_e, p_im, p_ic, mean(s.alpha), mean(s.W_af), mean(s.p_amb), T_ic, mean(s.T_amb),
        psi, displaced_flow(p_im, omega_e, T_ic, g.V_d), unit_flow, before,
        before + inside, given(s.log_eta) + factor("eta_vol"), given(s.log_area) + factor("A_th"),
    )  # fmt: skip
