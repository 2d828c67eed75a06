"""Steady points: rows of a test bed without time, each the mean of a settled operating point.

The format is that of a recording without `time_s` (and, if wished, with `u_flap_pct` and further channels by the same
naming). A transient recording can stand in for them: `quasi_steady` averages the windows in which nothing moves, and
says how many it found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from dieseltwin.engine import we2011
from dieseltwin.engine.parameters import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.notes import counted
from dieseltwin.recordings.channels import (
    AMBIENT,
    INPUTS,
    OPTIONAL_INPUTS,
    SENSORS,
    TIME,
    ChannelMap,
    foreign_hint,
    known_columns,
)
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.derived import NOTHING, Made
from dieseltwin.recordings.moving import refuse_moving
from dieseltwin.recordings.named_columns import Imported, import_columns
from dieseltwin.recordings.plausibility import bridge_inputs, check_plausible, mask_wild
from dieseltwin.recordings.reader import check_time
from dieseltwin.recordings.unit_checks import unit_notes
from dieseltwin.settings.strict import listed

STATES = ("p_im_pa", "p_em_pa", "omega_t_rad_s", "w_c_kg_s", "w_egr_kg_s", "t_em_k")
"""Measured quantities of a point that the balances join, in the order of every array that holds them."""

NEVER_NOUGHT = tuple(name for name in STATES if name != "w_egr_kg_s")
"""What an engine that runs has at every point: 0 or less is no reading of it."""

BESIDE = ("p_es_pa", "p_bc_pa", "t_c_k")
"""Places of a test bed that points may be measured at besides."""

COMPRESSION = 0.286  # (gamma - 1)/gamma of air [-]
COOLANT_K = 360.0  # of an EGR cooler, the engine's own, which its thermostat holds
FEWEST_READ = 10  # points that the usual charge is told by

JUDGED = "judged"
"""Column of 1 for points that are judged and 0 for those of the reference; without it all are judged."""

USUAL_CHARGE = "usual:t_im_k"
"""Column of the usual charge [K], which points that are taken out of those beside a reference keep."""

SINCE = "since:"
"""Begin of columns "since:<name>": 1 for judged points in which something that was found acts, 0 elsewhere."""

LEAST = 1e-6  # kg/s (and any other unit): the flow through a shut valve, so that logarithms exist
WINDOW_S = 10.0  # a quasi-steady window lasts this long,
FEWEST_ROWS = 5  # has so many rows at least,
SPEED_RIPPLE = 0.01  # and its speed [-], fuel [-] and positions [%] vary by no more (standard deviation)
FUEL_RIPPLE = 0.03
POSITION_RIPPLE = 1.0
TURBO_DRIFT = 0.01  # nor does the turbo speed run away between its halves [-]


@dataclass(frozen=True)
class SteadyPoints:
    """n settled operating points.

    Attributes:
        columns: our column names -> (n,) float64 [unit in the name], NaN where missing.
        row: (n,) data row of the file that each point came from, from 1.
        path, sha256: where it was read from.
        origin: "points" as given, or "averaged quasi-steady windows of a transient recording".
        notes: what reading did to them, one sentence each.
        made: columns that a channel map computed from others.
        assumed: columns of the ambient that nothing gave: the engine's values, or the channel map's, stand in them.
    """

    columns: Mapping[str, np.ndarray]
    row: np.ndarray
    path: Path | None = None
    sha256: str = ""
    origin: str = "points"
    notes: tuple[str, ...] = ()
    made: Made = NOTHING
    assumed: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number of points n."""
        return int(self.row.size)

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    @cached_property  # a balance of the points asks for it thousands of times
    def usual_charge(self) -> np.ndarray | None:
        """Charge temperature (n,) [K] by how it is read over the ambient where the engine is known to be well (else in
        all points): air that a cooler left some of its compression's heat, mixed with EGR between its coolant's and the
        exhaust's temperature. On a colder day the air is colder and the coolant isn't. None where too few were read.

        Points with a column of it keep that (`with_usual_charge`): without the reference nobody knows what was usual.
        """
        if USUAL_CHARGE in self:
            return self[USUAL_CHARGE]
        read, T_0, p_0 = self["t_im_k"], self["t_amb_k"], self["p_amb_pa"]
        p_im, W_c, W_egr, T_em = (self.columns.get(name, np.full(self.size, np.nan))
                                  for name in ("p_im_pa", "w_c_kg_s", "w_egr_kg_s", "t_em_k"))  # fmt: skip
        heat, share = T_0 * ((p_im / p_0) ** COMPRESSION - 1.0), W_egr / (W_c + W_egr)
        air, egr = ((1.0 - share) * heat, 1.0 - share), (share * (COOLANT_K - T_0), share * (T_em - COOLANT_K))
        along = np.stack([*air, *egr], axis=1)
        along = np.where(np.isfinite(along), along, np.nanmedian(along, axis=0))
        well = self.columns.get(JUDGED, np.zeros(self.size)) < 0.5
        used = well & np.isfinite(read) & np.isfinite(along).all(axis=1)
        if used.sum() < FEWEST_READ:
            return None
        return np.asarray(T_0 + along @ np.linalg.lstsq(along[used], (read - T_0)[used], rcond=None)[0])

    def with_usual_charge(self, well: np.ndarray | None = None) -> SteadyPoints:
        """The same with the usual charge as a column where a reference tells it, so that parts of them have it too;
        without one the points of a mask `well` (n,) do, if given, the others being off since."""
        told = self if well is None or JUDGED in self else self.with_columns(**{JUDGED: np.where(well, 0.0, 1.0)})
        usual = told.usual_charge if JUDGED in told else None
        return self if usual is None else self.with_columns(**{USUAL_CHARGE: usual})

    def states(self) -> np.ndarray:
        """The measured states, (n, 6) in the order of `STATES`; NaN where not measured, none below `LEAST`."""
        return np.maximum(
            np.stack([self.columns.get(name, np.full(self.size, np.nan)) for name in STATES], axis=1), LEAST
        )

    def states_filled(self) -> np.ndarray:
        """`states`, (n, 6), with the median of all points where one wasn't measured."""
        states = self.states()
        return np.where(np.isfinite(states), states, np.nanmedian(states, axis=0))

    def inputs(self) -> np.ndarray:
        """(n, 4) in the order of `INPUTS` [rpm, mg/cycle, %, %]."""
        return np.stack([self[name] for name in INPUTS], axis=1)

    def take(self, chosen: np.ndarray) -> SteadyPoints:
        """The points of a mask or index array."""
        return replace(self, columns=Columns({n: v[chosen] for n, v in self.columns.items()}), row=self.row[chosen])

    @property
    def judged(self) -> SteadyPoints:
        """Without the points of a reference."""
        return self.take(self.columns[JUDGED] > 0.5) if JUDGED in self else self

    def with_columns(self, **columns: np.ndarray) -> SteadyPoints:
        """The same points with columns added or replaced."""
        return replace(self, columns=Columns({**self.columns, **columns}))


def points(
    frame: pd.DataFrame | Mapping[str, np.ndarray],
    engine: EngineParameters | None = None,
    *,
    where: str = "points",
    needed: Sequence[str] = (*INPUTS, *SENSORS, "w_c_kg_s"),
    path: Path | None = None,
    sha256: str = "",
    origin: str = "points",
    made: Made = NOTHING,
) -> SteadyPoints:
    """Validate columns with our names and units. Ambient columns that are missing take the engine's values, and cells
    that are missing in one take the median of the others.

    Rows without inputs are dropped (`row` keeps the numbers), those of optional inputs too where most rows have them;
    an optional input that most rows lack is left out itself.

    Raises:
        InputError: a needed column is missing or holds text, or no row is left, or a unit is implausible.
    """
    engine = we2011.PARAMETERS if engine is None else engine
    names = [str(name) for name in frame]
    for name in needed:
        if name not in names:
            raise InputError(f"{where}: column {name}", f"none ({listed(names)})", "this column",
                             foreign_hint(name, names))
    columns: dict[str, np.ndarray] = {}
    notes = []
    read_as_numbers = {*needed, *known_columns(), *BESIDE}  # text elsewhere is somebody's remark
    for name in names:
        raw = pd.Series(np.asarray(frame[name]))
        values = pd.to_numeric(raw, errors="coerce").to_numpy(dtype=np.float64)
        if name in read_as_numbers and (np.isnan(values) & raw.notna().to_numpy()).any():
            row = int(np.flatnonzero(np.isnan(values) & raw.notna().to_numpy())[0])
            raise InputError(f"{where}: column {name}, data row {row + 1}", repr(raw.iloc[row]),
                             "numbers with a decimal point", "mend or empty this cell")
        columns[name] = np.where(np.isfinite(values), values, np.nan)
        nought = int(np.count_nonzero(values <= 0.0)) if name in NEVER_NOUGHT else 0
        if 0 < nought <= values.size // 2:
            columns[name] = np.where(values <= 0.0, np.nan, columns[name])
            notes.append(f"{counted(nought, 'value')} of {name} at or below 0 count as missing")
        infinite = int(np.count_nonzero(np.isinf(values)))
        if infinite and name in {*needed, *INPUTS, *STATES, "p_amb_pa", "t_amb_k"}:
            notes.append(f"{infinite} infinite values of {name} count as missing")
    notes.extend(mask_wild(columns))
    size = len(next(iter(columns.values()))) if columns else 0
    made, p_amb = made.of_recording(columns, engine.p_amb)
    read = {name: columns[name] for name in AMBIENT if name in columns and np.isfinite(columns[name]).any()}
    for name, value in zip(AMBIENT, (p_amb, engine.T_amb), strict=True):
        columns[name] = np.where(np.isnan(read[name]), np.nanmedian(read[name]), read[name]) if name in read \
            else np.full(size, value)
    for name in (name for name in OPTIONAL_INPUTS if name in columns):
        lacking = int(np.count_nonzero(np.isnan(columns[name])))
        if 2 * lacking > size:
            del columns[name]
            notes.append(f"{name} is missing in {lacking} of {size} rows and is left out")
    inputs = [*INPUTS, *(name for name in OPTIONAL_INPUTS if name in columns)]
    whole = np.all([np.isfinite(columns[name]) for name in inputs], axis=0) & (columns["n_e_rpm"] > 0.0)
    if not whole.any():
        raise InputError(where, "no row with all inputs", "rows with n_e, u_delta, u_egr and u_vgt", "check the file")
    columns = {name: np.ascontiguousarray(values[whole]) for name, values in columns.items()}
    check_plausible(columns, where, float(np.median(columns["t_amb_k"])), engine.V_d / engine.n_cyl)
    notes.extend(unit_notes(columns, engine.p_amb, engine.n_cyl))
    for values in columns.values():
        values.setflags(write=False)
    if not whole.all():
        notes.append(f"{int(np.count_nonzero(~whole))} of {size} rows are left out: an input is missing")
    assumed = tuple(name for name in AMBIENT if name not in read)
    return SteadyPoints(Columns(columns), np.flatnonzero(whole) + 1, path, sha256, origin, tuple(notes), made, assumed)


def beside_reference(judged: SteadyPoints, references: Sequence[SteadyPoints]) -> SteadyPoints:
    """Points with those of the same engine when it was well; columns that only some have are left out.

    Raises:
        InputError: points that are in a reference as well.
    """
    known = {row.tobytes() for reference in references for row in _as_rows(reference)}
    shared = sum(row.tobytes() in known for row in _as_rows(judged))
    if shared:
        raise InputError(str(judged.path or "points"), f"{shared} of {judged.size} points that are in a reference too",
                         "other points than the reference's", "judge points that the engine isn't learned from")
    parts = [*references, judged]
    common = [name for name in judged.columns if all(name in part for part in parts)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in common}
    columns[JUDGED] = np.concatenate([np.full(part.size, float(part is judged)) for part in parts])
    notes = [note for part in parts for note in part.notes]
    assumed = tuple(name for name in AMBIENT if any(name in part.assumed for part in parts))
    notes += [f"{name} is there in some of the files only, and the engine file's or the channel map's value stands in "
              "the others: what other weather does may look like a fault" for name in assumed
              if not all(name in part.assumed for part in parts)]  # fmt: skip
    return replace(judged, columns=Columns(columns), row=np.concatenate([part.row for part in parts]),
                   notes=tuple(notes), assumed=assumed)  # fmt: skip


def once_each(points: SteadyPoints) -> SteadyPoints:
    """Without rows whose inputs and readings are those of an earlier row: the same point again tells nothing new, and
    a copy among the held-out points would be foretold by what it is a copy of."""
    _, first = np.unique([row.tobytes() for row in _as_rows(points)], return_index=True)
    if first.size == points.size:
        return points
    note = f"{points.size - first.size} of {points.size} points are copies of others, digit by digit, and count once"
    return replace(points.take(np.sort(first)), notes=(*points.notes, note))


def _as_rows(points: SteadyPoints) -> np.ndarray:
    """Inputs and readings of each point, (n, 10)."""
    return np.column_stack([*(points[name] for name in INPUTS), points.states()])


def read_points(
    source: str | Path | pd.DataFrame | Imported,
    channels: ChannelMap | str | Path | None = None,
    engine: EngineParameters | None = None,
    needed: Sequence[str] = (*INPUTS, *SENSORS, "w_c_kg_s"),
) -> SteadyPoints:
    """Read steady points, or quasi-steady averages of a transient recording (it has `time_s`).

    Args:
        source: a file of any format or a table; or what was imported of one already.
        needed: columns that must be there.

    Raises:
        InputError: one line saying what is wrong with the file.
    """
    read = import_columns(source, channels)
    where, columns, origin = str(read.path or "points"), dict(read.columns), "points"
    notes: Sequence[str]
    if TIME not in columns:
        notes = refuse_moving(columns, where)
    else:
        columns, notes = quasi_steady(columns, str(read.path or "recording"))
        origin = "averaged quasi-steady windows of a transient recording"
    found = points(columns, engine, where=where, needed=needed, path=read.path, sha256=read.sha256 or "", origin=origin,
                   made=read.made)  # fmt: skip
    return replace(found, notes=(*read.notes, *notes, *found.notes))


def quasi_steady(
    columns: Mapping[str, np.ndarray], where: str = "recording"
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Averages over the windows of `WINDOW_S` in which speed, fuel, positions and turbo speed stand still, and notes.

    Error codes are no readings, and short holes of inputs are bridged, as in a recording. A sensor that is slower than
    the rows is averaged over its own readings.

    Args:
        columns: our column names -> (n,), with `time_s`.

    Raises:
        InputError: times that aren't numbers or don't rise, no such window.
    """
    numbers = {k: np.asarray(v, dtype=np.float64) for k, v in columns.items()
               if np.issubdtype(np.asarray(v).dtype, np.number)}
    if TIME not in numbers:
        raise InputError(f"{where}: column {TIME}", "text", "seconds as numbers", "mend the column")
    time = numbers[TIME]
    check_time(time, where, any_rate=True)
    notes = [*mask_wild(numbers), *bridge_inputs(numbers)]
    edges = np.arange(time[0], time[-1] - WINDOW_S + 1e-9, WINDOW_S)
    means: list[dict[str, float]] = []
    for start in edges:
        rows = (time >= start) & (time < start + WINDOW_S)
        if rows.sum() < FEWEST_ROWS or not all(name in numbers for name in INPUTS):
            continue
        cut = {name: values[rows] for name, values in numbers.items()}
        n_e, fuel = cut["n_e_rpm"], cut["u_delta_mg"]
        still = (
            np.std(n_e) <= SPEED_RIPPLE * np.mean(n_e)
            and np.std(fuel) <= FUEL_RIPPLE * max(np.mean(fuel), 10.0)
            and max(np.std(cut["u_egr_pct"]), np.std(cut["u_vgt_pct"])) <= POSITION_RIPPLE
        )
        if still and "omega_t_rad_s" in cut:
            half = rows.sum() // 2
            omega = cut["omega_t_rad_s"]
            still = abs(_mean(omega[:half]) - _mean(omega[half:])) <= TURBO_DRIFT * _mean(omega)
        if still:
            means.append({name: _mean(values) for name, values in cut.items()})
    if not means and (step := float(np.median(np.diff(time)))) > WINDOW_S / FEWEST_ROWS:
        raise InputError(f"{where}: column {TIME}", f"a row every {step:.3g} s",
                         f"a recording of at least {FEWEST_ROWS} rows in {WINDOW_S:g} s, or settled points",
                         f"leave {TIME} out where each row is a settled point")
    if not means:
        raise InputError(where, f"no {WINDOW_S:g} s in which speed, fuel and positions stand still",
                         "steady points (no time_s) or a recording with quiet stretches",
                         "give steady points, or record steps and hold them")
    return {name: np.array([mean[name] for mean in means]) for name in means[0] if name != TIME}, notes


def _mean(values: np.ndarray) -> float:
    """Mean of the readings that are there (n,); NaN without one."""
    there = values[np.isfinite(values)]
    return float(np.mean(there)) if there.size else np.nan
