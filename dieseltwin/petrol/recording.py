"""Recordings of a petrol engine's air path: strict reader, and means over blocks of a second.

A balance is integrated over a block: the mean flows in and out differ by the filling, which is the difference of the
pressures at the block's ends over its length. So time stamps are used as they are and nothing is differentiated.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.errors import InputError
from dieseltwin.petrol.components import displaced_flow, nozzle_flow, storage_flow
from dieseltwin.settings.strict import listed

Array = NDArray[np.float64]

BLOCK_S = 1.0
EDGE_ROWS = 7  # rows averaged for a block's end pressure: the manifold pulsates by 5 % at idle
FULLEST_HOLE = 0.5  # blocks with fewer than this part of the usual rows are left out
FEWEST_BLOCKS = 60
LEAST_FLOW = 1e-4  # kg/s, a twentieth of idle: keeps logarithms finite in overrun transients
# column -> (range of the median, unit)
COLUMNS: Mapping[str, tuple[float, float, str]] = {
    "p_ic_pa": (3e4, 5e5, "Pa"),
    "t_ic_k": (230.0, 450.0, "K"),
    "p_im_pa": (5e3, 5e5, "Pa"),
    "w_af_kg_s": (1e-4, 1.0, "kg/s"),
    "omega_e_rad_s": (30.0, 1000.0, "rad/s"),
    "alpha_th_pct": (0.0, 100.0, "%"),
    "p_amb_pa": (5e4, 1.1e5, "Pa"),
    "t_amb_k": (230.0, 330.0, "K"),
}


@dataclass(frozen=True)
class Signals:
    """Signals over n rows [SI]; `log_eta`, `log_area`, `leak_im`, `leak_ic` are what an effect adds, else 0.

    Attributes:
        time_s: (n,) from the recording's first row [s].
        p_ic, T_ic, p_im, W_af, omega_e, alpha, p_amb, T_amb: (n,) channels; alpha is the throttle's position [%].
        leak_im: flow into the intake manifold besides the throttle's [kg/s].
        leak_ic: flow out of the volume before the throttle besides the throttle's [kg/s].
        log_eta, log_area: logarithm of a factor on the volumetric efficiency and on the throttle's area [-].
    """

    time_s: Array
    p_ic: Array
    T_ic: Array
    p_im: Array
    W_af: Array
    omega_e: Array
    alpha: Array
    p_amb: Array
    T_amb: Array
    leak_im: Array | None = None
    leak_ic: Array | None = None
    log_eta: Array | None = None
    log_area: Array | None = None

    def part(self, start_s: float, end_s: float) -> Signals:
        """Rows with start_s <= time < end_s; the time starts at 0 again."""
        kept = (self.time_s >= start_s) & (self.time_s < end_s)
        cut = {k: v[kept] for k, v in vars(self).items() if v is not None}
        cut["time_s"] = cut["time_s"] - cut["time_s"][0]
        return replace(self, **cut)


@dataclass(frozen=True)
class PetrolRecording:
    """A recording with its origin; `time0_s` is the first time stamp of the file [s]."""

    signals: Signals
    time0_s: float
    path: str
    sha256: str
    columns: tuple[str, ...]


def read_petrol(path: str | Path) -> PetrolRecording:
    """Read a CSV or Parquet recording; column names are compared without regard to case.

    Raises:
        InputError: missing file or column, no rising time, values that can't be in the unit of the column's name.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
        table = pd.read_parquet(path) if path.suffix in (".parquet", ".pq") else pd.read_csv(path)
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "a CSV or Parquet recording", "check the path") from None
    except (ValueError, pd.errors.ParserError) as error:
        raise InputError(str(path), error, "a CSV or Parquet table", "check the file") from None
    table.columns = [str(c).strip().lower() for c in table.columns]
    missing = [c for c in ("time_s", *COLUMNS) if c not in table.columns]
    if missing:
        raise InputError(f"{path}: columns", f"no {listed(missing)}", f"time_s, {listed(list(COLUMNS))}",
                         "name the columns so, units as in the names")
    values = {}
    for column in ("time_s", *COLUMNS):
        numbers = pd.to_numeric(table[column], errors="coerce").to_numpy(dtype=np.float64)
        values[column] = numbers
    good = np.all([np.isfinite(v) for v in values.values()], axis=0)
    if good.sum() < FEWEST_BLOCKS:
        raise InputError(str(path), f"{int(good.sum())} complete rows", f"at least {FEWEST_BLOCKS} s", "record longer")
    values = {k: v[good] for k, v in values.items()}
    time = values.pop("time_s")
    if np.any(np.diff(time) <= 0.0):
        row = int(np.argmax(np.diff(time) <= 0.0)) + 2
        raise InputError(f"{path}: time_s", f"no rise at data row {row}", "strictly rising time", "sort the rows")
    for column, (low, high, unit) in COLUMNS.items():
        middle = float(np.median(values[column]))
        if not low <= middle <= high:
            raise InputError(f"{path}: column {column}", f"median {middle:.4g}", f"{low:g} to {high:g} {unit}",
                             f"convert to {unit}")
    if time[-1] - time[0] < FEWEST_BLOCKS:
        raise InputError(str(path), f"{time[-1] - time[0]:.0f} s", f"at least {FEWEST_BLOCKS} s", "record longer")
    signals = Signals(time - time[0], values["p_ic_pa"], values["t_ic_k"], values["p_im_pa"], values["w_af_kg_s"],
                      values["omega_e_rad_s"], values["alpha_th_pct"], values["p_amb_pa"], values["t_amb_k"])
    return PetrolRecording(signals, float(time[0]), str(path), hashlib.sha256(content).hexdigest(),
                           tuple(table.columns))


@dataclass(frozen=True)
class Geometry:
    """Volumes of the engine: displacement, intake manifold, intercooler with pipes [m3]."""

    V_d: float
    V_im: float
    V_ic: float


@dataclass(frozen=True)
class Grid:
    """Blocks of a recording: which rows belong to which, fixed under every hypothesis.

    Attributes:
        index: (n,) block of each row.
        count: (m,) rows of each block.
        kept: (m,) bool, blocks full enough.
        edges: (m + 1,) row nearest to each block boundary.
        mid_s: (m,) middle of each block [s].
    """

    index: NDArray[np.int64]
    count: Array
    kept: NDArray[np.bool_]
    edges: NDArray[np.int64]
    mid_s: Array

    def mean(self, x: Array) -> Array:
        """(m,) mean of x over each block."""
        return np.asarray(np.bincount(self.index, x, minlength=len(self.count)) / self.count)

    def slope(self, x: Array, time_s: Array) -> Array:
        """(m,) difference of x (smoothed over EDGE_ROWS rows) between a block's ends over their time [unit/s]."""
        half = EDGE_ROWS // 2
        total = np.concatenate([[0.0], np.cumsum(x)])
        low, high = np.maximum(self.edges - half, 0), np.minimum(self.edges + half + 1, len(x))
        at = (total[high] - total[low]) / (high - low)
        return np.asarray(np.diff(at) / np.maximum(np.diff(time_s[self.edges]), 0.5 * BLOCK_S))


def make_grid(time_s: Array) -> Grid:
    """Blocks of BLOCK_S over the rows at `time_s`."""
    index = np.floor(time_s / BLOCK_S).astype(np.int64)
    size = int(index[-1]) + 1
    count = np.bincount(index, minlength=size).astype(np.float64)
    usual = float(np.median(count[count > 0]))
    edges = np.searchsorted(time_s, np.arange(size + 1) * BLOCK_S).clip(0, len(time_s) - 1)
    kept = count >= FULLEST_HOLE * usual
    middle = (np.arange(size, dtype=np.float64) + 0.5) * BLOCK_S
    return Grid(index, np.maximum(count, 1.0), kept, edges, middle)


@dataclass(frozen=True)
class Blocks:
    """Balances over m blocks [SI]; see `Signals` for the symbols.

    Attributes:
        y_cyl: log of measured over displaced cylinder flow: log eta_vol [-].
        y_th: log of measured throttle flow over that of a throttle of 1 m2: log area [m2].
        y_ic: log(p_ic/p_amb) [-].
        log_jacobian_cyl, log_jacobian_th: d y/d log W_af, for the density of the measured flow.
    """

    mid_s: Array
    y_cyl: Array
    y_th: Array
    y_ic: Array
    omega_e: Array
    p_im: Array
    p_ic: Array
    alpha: Array
    psi: Array
    W_af: Array
    p_amb: Array
    T_ic: Array
    T_amb: Array
    log_jacobian_cyl: Array
    log_jacobian_th: Array


def balances(s: Signals, grid: Grid, g: Geometry) -> Blocks:
    """The three balances over each block, with what an effect adds to `s` taken into account."""
    mean = grid.mean
    zero = np.zeros(len(grid.count))
    T_ic, p_im, p_ic, W_af = mean(s.T_ic), mean(s.p_im), mean(s.p_ic), mean(s.W_af)
    leak_ic = zero if s.leak_ic is None else mean(s.leak_ic)
    leak_im = zero if s.leak_im is None else mean(s.leak_im)
    W_th = W_af - leak_ic - storage_flow(grid.slope(s.p_ic, s.time_s), T_ic, g.V_ic)
    W_ei = W_th + leak_im - storage_flow(grid.slope(s.p_im, s.time_s), T_ic, g.V_im)
    W_th, W_ei = np.maximum(W_th, LEAST_FLOW), np.maximum(W_ei, LEAST_FLOW)
    unit_flow = np.maximum(mean(nozzle_flow(1.0, s.p_ic, s.T_ic, s.p_im)), 1.0)
    W_d = displaced_flow(p_im, mean(s.omega_e), T_ic, g.V_d)
    psi = unit_flow / (p_ic / np.sqrt(287.0 * T_ic))
    y_cyl, y_th = np.log(W_ei / W_d), np.log(W_th / unit_flow)
    if s.log_eta is not None:
        y_cyl = y_cyl - mean(s.log_eta)
    if s.log_area is not None:
        y_th = y_th - mean(s.log_area)
    W = np.maximum(W_af, LEAST_FLOW)
    return Blocks(grid.mid_s, y_cyl, y_th, np.log(p_ic / mean(s.p_amb)), mean(s.omega_e), p_im, p_ic, mean(s.alpha),
                  psi, W_af, mean(s.p_amb), T_ic, mean(s.T_amb), np.log(W / W_ei), np.log(W / W_th))
