"""Recordings of a petrol engine's air path: strict reader, and means over blocks of a second.

A balance is integrated over a block: the mean flows in and out differ by the filling, which is the difference of the
pressures at the block's ends over its length. So time stamps are used as they are and nothing is differentiated.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dieseltwin.errors import InputError
from dieseltwin.notes import Note
from dieseltwin.petrol.components import R_A, displaced_flow, nozzle_flow, storage_flow
from dieseltwin.recordings.channels import ChannelMap
from dieseltwin.recordings.derived import STAND_IN_PA
from dieseltwin.recordings.named_columns import Imported, columns_sha256, named_columns
from dieseltwin.recordings.plausibility import FRACTION, as_fraction
from dieseltwin.recordings.shared_rows import distinct, refuse_overlapping, share_known
from dieseltwin.settings.strict import listed

Array = NDArray[np.float64]

BLOCK_S = 1.0
EDGE_ROWS = 6  # rows averaged for a block's end pressure: the manifold pulsates by 5 % at idle
FULLEST_HOLE = 0.5  # blocks with fewer than this part of the usual rows are left out
GAP_S = 0.9  # a longer step of the time stamps ends one piece and begins another: no block is without rows then
APART_S = 10.0  # between recordings that are pooled: a gap
FEW_LEFT_OUT = 0.01  # of the rows: fewer that lack a reading aren't worth a word
COARSEST_STEP_S = 0.25  # of the rows: the filling of the volumes is read from pressures at a block's ends
FEWEST_BLOCKS = 60
LEAST_FACTOR = 0.05  # that a signal at a map may leave of it [-]
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
SURROUNDINGS: Mapping[str, float] = {"p_amb_pa": STAND_IN_PA, "t_amb_k": 293.15}
"""Columns that a recording may be judged without, and what is taken where they aren't recorded: a usual day."""


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
    """A recording with its origin; `time0_s`: first time stamp of the file [s]; `notes`: what reading did to it."""

    signals: Signals
    time0_s: float
    path: str
    sha256: str
    columns: tuple[str, ...]
    notes: tuple[Note, ...] = ()

    @property
    def rows_sha256(self) -> str:
        """Hash of the rows, the same for a copy with other line ends or in another format."""
        return columns_sha256({name: value for name, value in vars(self.signals).items() if value is not None})


def read_petrol(
    source: str | Path | pd.DataFrame | Imported, channels: ChannelMap | str | Path | None = None,
    absent: Collection[str] = (),
) -> PetrolRecording:
    """Read a recording of any format, or take a table of one; names are compared without regard to case.

    Args:
        source: a file of any format of `recordings.importers`, or a table with its columns; or what was imported.
        channels: map of foreign names and units to ours, see `recordings.channels`.
        absent: columns among `SURROUNDINGS` that it needn't have.

    Raises:
        InputError: missing file or column, no rising time, values that can't be in the unit of the column's name.
    """
    columns, path, sha256, read_notes = named_columns(source, channels)
    table = {name.strip().lower(): values for name, values in columns.items()}
    recorded = tuple(table)
    missing = [c for c in ("time_s", *COLUMNS) if c not in table and c not in absent]
    if missing:
        do = "name the columns so, units as in the names, or give a channel map (--channels)"
        if all(c in SURROUNDINGS for c in missing):
            do = "name the columns so, give a channel map, or leave them out with --sensors (`discover`)"
        raise InputError(f"{path}: columns", f"no {listed(missing)}", f"time_s, {listed(list(COLUMNS))}", do)
    for column in absent:
        if column not in table:
            table[column] = np.full(len(table["time_s"]), SURROUNDINGS[column])
    values = {}
    for column in ("time_s", *COLUMNS):
        values[column] = np.asarray(pd.to_numeric(pd.Series(table[column]), errors="coerce"), dtype=np.float64)
    good = np.all([np.isfinite(v) for v in values.values()], axis=0)
    if good.sum() < FEWEST_BLOCKS:
        raise InputError(path, f"{int(good.sum())} complete rows", f"at least {FEWEST_BLOCKS} s", "record longer")
    notes = (*read_notes, *_left_out(values, good))
    values = {k: v[good] for k, v in values.items()}
    time = values.pop("time_s")
    if np.any(np.diff(time) <= 0.0):
        row = int(np.argmax(np.diff(time) <= 0.0)) + 2
        raise InputError(f"{path}: time_s", f"no rise at data row {row}", "strictly rising time", "sort the rows")
    step = float(np.median(np.diff(time)))
    if step > COARSEST_STEP_S:
        raise InputError(f"{path}: time_s", f"a row every {step:.3g} s", f"one every {COARSEST_STEP_S:g} s at least",
                         "record faster")
    for column, (low, high, unit) in COLUMNS.items():
        middle = float(np.median(values[column]))
        if not low <= middle <= high:
            raise InputError(f"{path}: column {column}", f"median {middle:.4g}", f"{low:g} to {high:g} {unit}",
                             f"convert to {unit}")
    if (widest := float(values["alpha_th_pct"].max())) <= FRACTION:
        raise as_fraction("alpha_th_pct", widest, path)
    if time[-1] - time[0] < FEWEST_BLOCKS:
        raise InputError(path, f"{time[-1] - time[0]:.0f} s", f"at least {FEWEST_BLOCKS} s", "record longer")
    signals = Signals(time - time[0], values["p_ic_pa"], values["t_ic_k"], values["p_im_pa"], values["w_af_kg_s"],
                      values["omega_e_rad_s"], values["alpha_th_pct"], values["p_amb_pa"], values["t_amb_k"])
    return PetrolRecording(signals, float(time[0]), path, sha256, recorded, notes)


def _left_out(values: Mapping[str, Array], good: NDArray[np.bool_]) -> tuple[Note, ...]:
    share = float(np.mean(~good))
    if share < FEW_LEFT_OUT:
        return ()
    lacking = [column for column, read in values.items() if np.mean(~np.isfinite(read)) >= 0.1 * share]
    have = "have" if len(lacking) > 1 else "has"
    return (Note(f"{100.0 * share:.2g} % of the rows left out, as {listed(lacking)} {have} no number there", "left_out",
                 lacking),)  # fmt: skip


def pooled(recordings: Sequence[PetrolRecording]) -> PetrolRecording:
    """Several recordings of one engine as one with gaps, in an order of its own; copies with the same rows count once.

    Args:
        recordings: one at least.

    Raises:
        InputError: one that is, in part, driving of another.
    """
    once = distinct(recordings)
    if len(once) == 1:
        return once[0]
    refuse_overlapping(
        once, lambda others, one: share_known(rows_of(one.signals), [rows_of(other.signals) for other in others])
    )
    names = [f.name for f in fields(Signals) if getattr(once[0].signals, f.name) is not None]
    values = {name: np.concatenate([getattr(r.signals, name) for r in once]) for name in names}
    ends = np.cumsum([0.0, *(r.signals.time_s[-1] + APART_S for r in once[:-1])])
    values["time_s"] = np.concatenate([r.signals.time_s + end for r, end in zip(once, ends, strict=True)])
    sha256 = hashlib.sha256("".join(r.sha256 for r in once).encode()).hexdigest()
    columns = tuple(c for c in once[0].columns if all(c in r.columns for r in once))
    return PetrolRecording(Signals(**values), 0.0, ", ".join(r.path for r in once), sha256, columns,
                           tuple(note for r in once for note in r.notes))  # fmt: skip


def rows_of(signals: Signals) -> Array:
    """All channels but the time side by side, (n, C)."""
    return np.stack([value for name, value in vars(signals).items() if value is not None and name != "time_s"], axis=1)


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


def gaps(time_s: Array) -> NDArray[np.int64]:
    """First row of every piece between gaps of more than GAP_S, ascending, the first 0."""
    return np.concatenate([[0], np.flatnonzero(np.diff(time_s) > GAP_S) + 1]).astype(np.int64)


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
