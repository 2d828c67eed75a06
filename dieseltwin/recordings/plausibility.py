"""Is a recording in the units that its column names say? Wrong units give plausible-looking, wrong health parameters.

The ranges are those of `symbols`: every engine of this class passes at any operating point, the usual wrong units do
not. They are about medians and quantiles, so that a few bad rows (which an estimator masks or weighs) do not refuse a
recording. Short holes of the inputs are bridged, longer ones split a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import DIESEL_COLUMNS, INPUTS, OPTIONAL_INPUTS, TIME
from dieseltwin.recordings.error_codes import without_codes
from dieseltwin.recordings.noise import cut_off
from dieseltwin.sensors import MEASURED
from dieseltwin.symbols import symbol


@dataclass(frozen=True)
class Slip:
    """A usual wrong unit: the median lies in [low, high] when the values are in `unit`."""

    unit: str
    low: float
    high: float


# our unit -> the wrong units met with
SLIPS: Mapping[str, tuple[Slip, ...]] = {
    "Pa": (Slip("bar", 0.3, 20.0), Slip("kPa", 30.0, 799.0), Slip("mbar or hPa", 799.0, 2e4)),
    "kg/s": (Slip("g/s or kg/h", 2.0, 1e5),),
    "K": (Slip("degC", -60.0, 230.0),),
    "rad/s": (Slip("rpm", 2.5e4, 3e5), Slip("krpm", 2.0, 250.0)),
}
LONGEST_GAP_S = 1.0
JITTER = 1.5  # steps: rows of 1 Hz that are 1.01 s apart are no gap
TINY_FUEL_MG = 0.5  # a median below this is no fuel of a running engine in mg/cycle: engines idle on 3 and more

FRACTION = 1.2  # positions whose largest value is below this are fractions, if the valve is not simply shut
COLDEST_EXHAUST = 0.85  # of the ambient temperature [-]: colder exhaust gas is in Celsius
# Exhaust temperature over ambient per fuel [K per mg/cycle and litre of one cylinder]: 5.5-14 for real engines,
# up to 4.5 when the column is in Celsius. Counted neither at idle nor at full load, where the two meet.
HEAT_PER_FUEL = 4.6
MEDIUM_FUEL = (19.0, 100.0)  # mg/cycle per litre of one cylinder
MEDIUM_ROWS = 20
LITRE = 1e-3  # m3


WILD = 1e3  # times the highest median of any engine: a counter's overflow or a broken cell, no reading
FEW_WILD = 0.01  # of the rows; more of them are another unit, which `check_plausible` tells


def mask_wild(columns: dict[str, np.ndarray]) -> list[str]:
    """Make values missing that are loggers' error codes, and single ones that no engine has in any unit (1e300, an
    overflow); a sentence for each column."""
    notes = []
    for name in (name for name in DIESEL_COLUMNS if name in columns):
        columns[name], coded = without_codes(name, columns[name], columns[name])
        notes.extend(coded)
        wild = np.abs(columns[name]) > WILD * symbol(name).high  # not so for NaN
        count = int(np.count_nonzero(wild))
        if 0 < count <= max(1.0, FEW_WILD * wild.size):
            columns[name] = np.where(wild, np.nan, columns[name])
            notes.append(f"{count} values of {name} are impossible and count as missing")
    return notes


def cut_off_notes(columns: Mapping[str, np.ndarray]) -> list[str]:
    """A note for each sensor that has no number for the lower half of its noise."""
    found = {name: cut_off(columns[name]) for name in MEASURED if name in columns}
    return [f"{name} has no number below {cut.lowest:.6g}: its noise is cut off there, in {np.count_nonzero(cut.near)} "
            "rows; `classical` and `discover` count with the mean that this gives"
            for name, cut in found.items() if cut is not None]  # fmt: skip


def check_plausible(
    columns: Mapping[str, np.ndarray], where: str, t_amb_k: float, cylinder_m3: float
) -> None:
    """Refuse columns that are in another unit than their name says.

    Args:
        columns: our column name -> values (n,), NaN where missing.
        where: name of the file, for messages.
        t_amb_k: ambient temperature [K].
        cylinder_m3: displacement of one cylinder [m3].

    Raises:
        InputError: a column without values, or values that cannot be in that unit.
    """
    for name in DIESEL_COLUMNS:
        values = columns.get(name)
        if values is None:
            continue
        finite = values[np.isfinite(values)]
        if finite.size == 0 and name in OPTIONAL_INPUTS:
            continue  # as good as not there
        if finite.size == 0:
            raise InputError(
                f"{where}: column {name}",
                "no value at all (every row is empty)",
                f"numbers, {symbol(name).allowed}",
                "record this channel or leave the column out if it is optional",
            )
        _check_median(name, float(np.median(finite)), where)
    _check_positions(columns, where)
    _check_exhaust(columns, where, t_amb_k, cylinder_m3)


def _check_median(name: str, median: float, where: str) -> None:
    range_ = symbol(name)
    low = TINY_FUEL_MG if name == "u_delta_mg" else range_.low
    if low <= median <= range_.high:
        return
    if name == "u_delta_mg" and 0.0 <= median < low:
        raise InputError(f"{where}: column {name}", f"a median of {median:.6g}", f"{low:g} mg/cycle or more in half of "
                         "the rows, of an engine under load", "cut motoring off, or give the unit in a channel map "
                         "(--channels) if this is in g")  # fmt: skip
    looks = next((s.unit for s in SLIPS.get(range_.unit, ()) if s.low <= median <= s.high), None)
    guess = f" (looks like {looks})" if looks else ""
    raise InputError(
        f"{where}: column {name}",
        f"a median of {median:.6g}{guess}",
        range_.allowed,
        f"convert to {range_.unit} or give the unit in a channel map (--channels)",
    )


def _check_positions(columns: Mapping[str, np.ndarray], where: str) -> None:
    largest = {
        name: float(np.nanmax(columns[name])) for name in ("u_egr_pct", "u_vgt_pct") if name in columns
    }
    fractions = [name for name, value in largest.items() if value <= FRACTION]
    if fractions == ["u_egr_pct"] and not _egr_flows(columns):
        fractions = []  # the EGR valve is really shut all the time
    for name in (name for name in OPTIONAL_INPUTS if name in columns):
        there = columns[name][np.isfinite(columns[name])]
        if there.size and there.min() < there.max() <= FRACTION:  # one that stands still may have nothing to say
            largest[name] = float(there.max())
            fractions.insert(0, name)
    if not fractions:
        return
    name = fractions[-1]  # u_vgt has no shut position, so it is the sure sign
    raise as_fraction(name, largest[name], where)


def as_fraction(name: str, largest: float, where: str) -> InputError:
    """What is said of a position in % whose largest value is that of a fraction."""
    return InputError(
        f"{where}: column {name}",
        f"no value above {largest:.3g} (looks like a fraction)",
        "positions in %, 0 to 100",
        "multiply by 100 or give unit: fraction in a channel map (--channels)",
    )


def _egr_flows(columns: Mapping[str, np.ndarray]) -> bool:
    """Whether more EGR flows than a valve open by 1 % can pass (f_egr about 0.02)."""
    flow, p_em = columns.get("w_egr_kg_s"), columns.get("p_em_pa")
    if flow is None or p_em is None:
        return False
    high = float(np.nanquantile(flow, 0.9))
    # choked flow through 2 % of 4e-4 m2 at 500 K is 1.4e-8 kg/s per Pa; three times that is a valve really open
    return high > 4.5e-8 * float(np.nanmedian(p_em))


def _check_exhaust(
    columns: Mapping[str, np.ndarray], where: str, t_amb_k: float, cylinder_m3: float
) -> None:
    temperature, fuel = columns.get("t_em_k"), columns.get("u_delta_mg")
    if temperature is None or fuel is None:
        return
    finite = temperature[np.isfinite(temperature)]
    coldest = float(np.quantile(finite, 0.01))
    allowed = "exhaust temperatures in K"
    do = "convert to K or give unit: degC in a channel map (--channels)"
    if coldest < COLDEST_EXHAUST * t_amb_k:
        raise InputError(
            f"{where}: column t_em_k",
            f"values down to {coldest:.4g} (colder than the ambient air, looks like degC)",
            allowed,
            do,
        )
    per_litre = fuel * LITRE / cylinder_m3
    medium = (per_litre > MEDIUM_FUEL[0]) & (per_litre < MEDIUM_FUEL[1]) & np.isfinite(temperature)
    if np.count_nonzero(medium) < MEDIUM_ROWS:
        return
    ratio = float(np.median((temperature[medium] - t_amb_k) / per_litre[medium]))
    if ratio < HEAT_PER_FUEL:
        raise InputError(
            f"{where}: column t_em_k",
            f"a median of {np.median(temperature[medium]):.4g} at medium fuel (too cold, looks like degC)",
            allowed,
            do,
        )


def longest_gap(time_s: np.ndarray) -> float:
    """The longest time between two rows (n,) of one piece [s]."""
    return max(LONGEST_GAP_S, JITTER * float(np.median(np.diff(time_s))))


def bridge_inputs(columns: dict[str, np.ndarray]) -> list[str]:
    """Fill holes of inputs that split nothing by straight lines; a sentence for each column.

    Args:
        columns: our column names -> (n,) [SI], time among them; replaced where they are bridged.
    """
    time, notes = columns[TIME], []
    for name in (name for name in (*INPUTS, *OPTIONAL_INPUTS) if name in columns):
        values = columns[name]
        there, missing = np.flatnonzero(np.isfinite(values)), np.flatnonzero(~np.isfinite(values))
        after = np.searchsorted(there, missing)  # number of the next row that is there
        inside = (after > 0) & (after < there.size)
        missing, after = missing[inside], after[inside]
        filled = missing[time[there[after]] - time[there[after - 1]] <= longest_gap(time)]
        if filled.size:
            columns[name] = values.copy()
            columns[name][filled] = np.interp(time[filled], time[there], values[there])
            notes.append(f"{filled.size} missing values of {name} are bridged by straight lines")
    return notes
