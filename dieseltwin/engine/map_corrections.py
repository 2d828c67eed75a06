"""Corrections of the empirical maps: smooth relative functions of each map's own arguments.

A correction is a sum of fixed smooth functions, the leading ones of a Gaussian process with a squared-exponential
kernel (Rasmussen & Williams, 2006, sections 4.2 and 4.3) over fixed ranges of the map's arguments. They are the same
for every recording and every engine, so that a coefficient learned on one keeps its meaning on the next. A coefficient
of one is one standard deviation of a correction of 100 % rms.

Further functions stand behind them, for engines whose reference asks for them. Finer ones, with the smooth ones, hold
errors of half the correlation length. Functions of speed and blade speed ratio hold errors of the turbine's efficiency
that change with the exhaust's temperature: its formula (A.33) is one of both, and at equal speed and pressures the
ratio goes with the root of the temperature.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from dieseltwin.inner import kernel

CORRECTED_POINTS = ("eta_vol", "f_egr", "W_t", "eta_tm", "eta_c", "W_c")
"""Insertion points of the six maps, in the order of the tables."""

ARGUMENTS: dict[str, tuple[str, ...]] = {
    "eta_vol": ("p_im", "n_e"), "f_egr": ("u_egr",), "W_t": ("u_vgt", "Pi_t"), "eta_tm": ("omega_t", "Pi_t"),
    "eta_c": ("W_c", "Pi_c"), "W_c": ("Psi_c", "omega_t"),
}  # fmt: skip
"""Arguments of each map; of the valve's opening there is one."""

GRIDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    *((point, ARGUMENTS[point]) for point in CORRECTED_POINTS), ("eta_tm", ("omega_t", "BSR")),
)  # fmt: skip
"""Map and arguments of every grid that corrections are tables on: each map's own, and the further one."""

CORRECTED: Mapping[tuple[str, str], str] = {("eta_c", "W_c"): "W_cc", ("W_c", "omega_t"): "omega_c"}
"""Map and argument -> variable that the argument is: the compressor's flow and speed as corrected for the weather
(`turbocharger.corrected_flow`, `corrected_speed`)."""

OF_RATIO = len(CORRECTED_POINTS)
"""Grid over the blade speed ratio, among `GRIDS`."""

RANGES: dict[str, tuple[float, float]] = {
    "p_im": (0.9e5, 3.5e5), "n_e": (500.0, 2000.0), "u_egr": (0.0, 80.0), "u_vgt": (20.0, 100.0), "Pi_t": (0.3, 1.0),
    "omega_t": (1500.0, 12000.0), "W_c": (0.0, 0.6), "Pi_c": (1.0, 3.5), "Psi_c": (0.0, 1.6),
    "BSR": (0.2, 1.2),
}  # fmt: skip
"""Ranges of the arguments over which corrections are spread, held beyond: what the engine can reach [SI, rpm, %]."""

CORRELATION_LENGTH = 0.25
"""Of the ranges: of a third of what is usually driven, which is some three quarters of them [-]."""

FINER_LENGTH = 0.5 * CORRELATION_LENGTH
"""Correlation length of errors that the finer functions are for, of the ranges [-]."""

NODES = 41
_KEPT_VARIANCE = 0.998  # of a correction; the rest of 2 % rms is 0.09 %
_KEPT_OF_FINER = 0.98  # of one of the finer length; with 0.95 one of three healthy rough engines kept its alarm
_USUAL_BESIDE = 1e-3  # of the variance of smoother errors
_FINER_ORDERS = 10  # of one argument, behind those of the smooth functions; what is left out of its variance is 1e-6


@dataclass(frozen=True)
class Basis:
    """The functions that corrections are sums of.

    Attributes:
        tables: (K, NODES, NODES) each on the grid of its map's arguments, of unit prior variance.
        grids: (K,) index of each one's grid in `GRIDS`.
        maps: (K,) index of each one's map in `CORRECTED_POINTS`.
        names: (K,) "W_t 1", "W_t 2", ..., then "W_t finer 1", ..., then "eta_tm over BSR 1", ...
        finer: (K,) whether it is one of the finer ones.
        finer_covariance: (K, K) of the coefficients of an error of unit rms and the finer length.
        orders: (K, 2) order along each argument of the modes of the usual correlation, -1 for none.
    """

    tables: np.ndarray
    grids: np.ndarray
    maps: np.ndarray
    names: tuple[str, ...]
    finer: np.ndarray
    finer_covariance: np.ndarray
    orders: np.ndarray

    @property
    def of_ratio(self) -> np.ndarray:
        """(K,) whether it is one of the blade speed ratio."""
        return np.asarray(self.grids == OF_RATIO)

    @property
    def usual(self) -> np.ndarray:
        """(K,) whether it is one of the smooth ones that every engine has."""
        return ~self.finer & ~self.of_ratio

    def smoother(self, length: float) -> np.ndarray:
        """Covariance (K, K) of the coefficients of an error of unit rms with another correlation length; of the
        functions that aren't usual, as if they were independent and of unit variance.

        Args:
            length: times the usual one, at least 1 [-].
        """
        values, vectors = _modes(_kernel(CORRELATION_LENGTH))
        vectors = vectors[:, : 1 + int(self.orders[self.usual].max())]
        spread = vectors.T @ _kernel(length * CORRELATION_LENGTH) @ vectors
        at, first, second = np.flatnonzero(self.usual), self.orders[self.usual, 0], self.orders[self.usual, 1]
        two = np.minimum.outer(second, second) >= 0
        sizes = np.sqrt(values[first] * np.where(second >= 0, values[second], 1.0))
        found = np.equal.outer(self.grids[at], self.grids[at]) * spread[np.ix_(first, first)]
        found *= np.where(two, spread[np.ix_(second, second)], 1.0) / np.outer(sizes, sizes)
        out = np.eye(self.usual.size)
        # a thousandth of the usual errors beside, or functions that are none of the longer ones' have no variance
        out[np.ix_(at, at)] = (1.0 - _USUAL_BESIDE) * found + _USUAL_BESIDE * np.eye(at.size)
        return out


@lru_cache(maxsize=1)
def basis() -> Basis:
    """The fixed basis: the smooth functions of all maps, most important ones first, then the further ones."""
    values, vectors = _modes(_kernel(CORRELATION_LENGTH))
    smooth = [(m, pair) for m in range(len(CORRECTED_POINTS)) for pair in _leading(m, values, _KEPT_VARIANCE)]
    orders = 1 + max(max(pair) for _, pair in smooth)
    vectors = vectors[:, :orders]
    rest = np.eye(NODES) - vectors @ vectors.T
    further = _modes(rest @ _kernel(FINER_LENGTH) @ rest)[1][:, :_FINER_ORDERS]
    vectors = np.concatenate([vectors, further], axis=1)  # orthonormal functions of one argument
    spread = vectors.T @ _kernel(FINER_LENGTH) @ vectors  # covariance of an error of the finer length along them
    known = set(smooth)
    finer = [
        (m, pair)
        for m in range(len(CORRECTED_POINTS))
        for pair in _leading(m, np.diag(spread), _KEPT_OF_FINER, {p for n, p in known if n == m})
    ]
    of_ratio = [(OF_RATIO, pair) for pair in _leading(OF_RATIO, values, _KEPT_VARIANCE)]
    all_of_them = [*smooth, *finer, *of_ratio]
    grids, first, second = (np.array(column) for column in zip(*((m, *pair) for m, pair in all_of_them), strict=True))
    is_finer = np.repeat([False, True, False], [len(smooth), len(finer), len(of_ratio)])
    sizes = np.sqrt([
        _variance(np.diag(spread) if k else values, pair) for k, (_, pair) in zip(is_finer, all_of_them, strict=True)
    ])  # fmt: skip
    tables = [
        size * np.outer(vectors[:, i], vectors[:, j] if j >= 0 else np.ones(NODES))
        for size, (_, (i, j)) in zip(sizes, all_of_them, strict=True)
    ]
    along_second = np.where(np.minimum.outer(second, second) >= 0, spread[np.ix_(second, second)], 1.0)
    covariance = np.equal.outer(grids, grids) * spread[np.ix_(first, first)] * along_second
    covariance[:, grids == OF_RATIO] = covariance[grids == OF_RATIO] = 0.0
    names = (*_numbered(smooth, ""), *_numbered(finer, "finer "), *_numbered(of_ratio, "over BSR "))
    maps = np.array([CORRECTED_POINTS.index(GRIDS[g][0]) for g in grids])
    orders_of = np.stack([first, second], axis=1)
    return Basis(np.array(tables), grids, maps, names, is_finer, covariance / np.outer(sizes, sizes), orders_of)


def _kernel(length: float) -> np.ndarray:
    """Covariance (NODES, NODES) of a random function of one argument, of unit variance."""
    at = np.linspace(0.0, 1.0, NODES)
    return np.asarray(np.exp(-0.5 * (np.subtract.outer(at, at) / length) ** 2))


def _modes(kernel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variances, largest first, and modes (NODES, NODES), one a column."""
    values, vectors = np.linalg.eigh(kernel)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    return values, vectors * np.sign(vectors[-1])  # a mode's sign is any; its last element is never zero


def _leading(
    m: int, values: np.ndarray, kept: float, known: Collection[tuple[int, int]] = ()
) -> list[tuple[int, int]]:
    """Orders of the functions on a grid, one of each argument, that with those known carry a share of the variance.

    Args:
        m: of the grid; the second order of one of one argument is -1.
        values: variance along each order; kept: share that is carried.
        known: orders of functions that are there already.
    """
    if len(GRIDS[m][1]) == 1:
        pairs = [(i, -1) for i in range(values.size)]
    else:
        pairs = [(i, j) for i in range(values.size) for j in range(values.size)]
    shares = {pair: _variance(values, pair) for pair in pairs}
    # the variance of a function of unit variance is NODES, along each argument
    whole = float(NODES) ** len(GRIDS[m][1])
    # rounded, so that the order of the pairs (i, j) and (j, i) is that of their names on every machine
    order = sorted((p for p in pairs if p not in known), key=lambda p: (-float(f"{shares[p]:.9g}"), p))
    carried = sum(shares[pair] for pair in known) + np.cumsum([shares[pair] for pair in order])
    return order[: int(np.searchsorted(carried / whole, kept)) + 1]


def _variance(of_order: np.ndarray, pair: tuple[int, int]) -> float:
    """Of a function with an order of each argument."""
    return float(of_order[pair[0]] * (of_order[pair[1]] if pair[1] >= 0 else 1.0))


def _numbered(functions: Sequence[tuple[int, tuple[int, int]]], kind: str) -> Iterator[str]:
    """Names of the functions on each grid, in their order."""
    count = dict.fromkeys(range(len(GRIDS)), 0)
    for m, _ in functions:
        count[m] += 1
        yield f"{GRIDS[m][0]} {kind}{count[m]}"


@dataclass(frozen=True)
class MapCorrections:
    """Relative corrections on grids, as the compiled simulator reads them.

    Attributes:
        tables: (G, NODES, NODES) relative corrections [-] over both arguments, of the first G of `GRIDS`: of all, of
            all but the further one, or of none.
        low: (7, 2) first node of each argument; per_unit: (7, 2) nodes a unit.
    """

    tables: np.ndarray
    low: np.ndarray
    per_unit: np.ndarray


def _grid() -> tuple[np.ndarray, np.ndarray]:
    ends = np.array(
        [[RANGES.get(argument, (0.0, 1.0)) for argument in (*arguments, "none")[:2]] for _, arguments in GRIDS]
    )
    low, high = ends[..., 0], ends[..., 1]
    return np.ascontiguousarray(low), np.ascontiguousarray((NODES - 1) / (high - low))


_LOW, _PER_UNIT = _grid()

NO_CORRECTIONS = MapCorrections(np.zeros((0, NODES, NODES)), _LOW, _PER_UNIT)
"""The maps as they are."""


def corrections_of(coefficients: np.ndarray) -> MapCorrections:
    """Corrections from coefficients (K,) of `basis()` [-]; nobody writes into them, they are shared."""
    return _corrections_of(np.asarray(coefficients, dtype=np.float64).tobytes())


@lru_cache(maxsize=8)  # a search asks for those of one engine along every trajectory
def _corrections_of(coefficients: bytes) -> MapCorrections:
    functions, values = basis(), np.frombuffer(coefficients)
    tables = np.zeros((len(GRIDS), NODES, NODES))
    for m in range(len(tables)):
        at = functions.grids == m
        tables[m] = np.tensordot(values[at], functions.tables[at], 1)
    return MapCorrections(tables if tables[OF_RATIO].any() else tables[:OF_RATIO], _LOW, _PER_UNIT)


def variable_of(point: str, argument: str, there: Container[str]) -> str:
    """Variable that an argument of a map's is, among those that are there: one that holds the compressor's flow and
    speed alone has them of the weather that the maps are of."""
    corrected = CORRECTED.get((point, argument), argument)
    return corrected if corrected in there else argument


def arguments_of(m: int, variables: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Both arguments of grid m along a trajectory, (n,) each; zeros for the second of one of one argument."""
    names = [variable_of(GRIDS[m][0], name, variables) for name in GRIDS[m][1]]
    first = np.asarray(variables[names[0]], dtype=np.float64)
    return first, np.asarray(variables[names[1]], dtype=np.float64) if len(names) > 1 else np.zeros_like(first)


def look_up(tables: np.ndarray, m: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear look-up as in the compiled simulator: tables (..., NODES, NODES) of grid m at points -> (..., *points);
    x and y of the points' shape, or of one that is broadcast to it."""
    several = np.ascontiguousarray(tables, dtype=np.float64).reshape(-1, NODES, NODES)
    shape = np.broadcast_shapes(np.shape(x), np.shape(y))
    flat = (np.broadcast_to(np.asarray(values, dtype=np.float64), shape).ravel() for values in (x, y))
    return _bilinear(several, *flat, _LOW[m], _PER_UNIT[m]).reshape(*tables.shape[:-2], *shape)  # type: ignore[no-any-return]


@kernel(error_model="numpy")
def _bilinear(tables, x, y, low, per_unit):  # type: ignore[no-untyped-def]
    """Tables (F, N, N) at n points, held beyond the edges -> (F, n); where a point is unknown, at 0."""
    out, last = np.empty((tables.shape[0], x.size)), tables.shape[1] - 1
    for k in range(x.size):
        a = ((0.0 if np.isnan(x[k]) else x[k]) - low[0]) * per_unit[0]
        b = ((0.0 if np.isnan(y[k]) else y[k]) - low[1]) * per_unit[1]
        a, b = min(max(a, 0.0), float(last)), min(max(b, 0.0), float(last))
        i, j = min(int(a), last - 1), min(int(b), last - 1)
        a, b = a - i, b - j
        for f in range(tables.shape[0]):
            near = (1.0 - b) * tables[f, i, j] + b * tables[f, i, j + 1]
            far = (1.0 - b) * tables[f, i + 1, j] + b * tables[f, i + 1, j + 1]
            out[f, k] = (1.0 - a) * near + a * far
    return out


def with_corrections_at(
    tables: np.ndarray, variables: Mapping[str, np.ndarray], signals: Mapping[str, Any]
) -> dict[str, Any]:
    """Insertion point -> signal with the corrections added that tables (G, NODES, NODES) of the first G of `GRIDS` say
    at variables that hold their arguments."""
    out = dict(signals)
    for m, table in enumerate(tables):
        point = GRIDS[m][0]
        out[point] = out.get(point, 0.0) + look_up(table, m, *arguments_of(m, variables))
    return out


def basis_along(variables: Mapping[str, np.ndarray], which: np.ndarray | None = None) -> np.ndarray:
    """Functions of `basis()` along a trajectory, (F, n) [-]; `which` (K,) says whose, None: of all."""
    functions = basis()
    which = np.ones(len(functions.maps), dtype=bool) if which is None else which
    tables, grids = functions.tables[which], functions.grids[which]
    first = next(iter(ARGUMENTS.values()))[0]
    out = np.empty((len(grids), len(variables[first])))
    for m in np.unique(grids):
        at = grids == m
        out[at] = look_up(tables[at], m, *arguments_of(m, variables))
    return out


def smooth_functions(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The usual functions of a map of two arguments at points (n,), for what is none of the six maps, (F, n) [-].

    Args:
        first, second: the arguments, each from 0 to 1 over its range.
    """
    functions = basis()
    own = functions.tables[functions.usual & (functions.grids == CORRECTED_POINTS.index("eta_vol"))]
    return np.asarray(_bilinear(own, first, second, np.zeros(2), np.full(2, NODES - 1.0)))
