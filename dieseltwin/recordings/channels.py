"""Channels of a recording: our columns and units, and maps from foreign names and units.

A channel map is a YAML file, one entry a channel, foreign name first::

    Time: time_s                                    # same unit, other name
    P_boost: {column: p_im_pa, unit: kPa}           # a named unit
    T_exh: {column: t_em_k, unit: degC}
    EGR_pos: {column: u_egr_pct, scale: 100.0}      # ours = scale * theirs + offset
    T_cool: {column: t_im_k, unit: degC, offset: -1.5}           # offset in our unit, added last

Columns that already carry our names need no entry. What follows from other channels is computed: see `derived`. The
key `dbc:` names the DBC of a CAN trace, beside the map or by its full path. `dieseltwin channels FILE --out map.yaml`
writes a first map. Everything is SI (and %, mg/cycle, rpm) after the reader.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from dieseltwin.errors import InputError
from dieseltwin.recordings.derived import (
    DERIVATIONS,
    DIESEL_KG_L,
    MASS_RATE,
    PRESSURE,
    SHARE,
    Constants,
    Derivation,
    Made,
)
from dieseltwin.recordings.error_codes import without_codes
from dieseltwin.recordings.time_units import SECONDS
from dieseltwin.sensors import MEASURED, NEEDED
from dieseltwin.settings.strict import StrictModel, did_you_mean, listed, read_mapping, unknown_name, validate
from dieseltwin.symbols import BY_COLUMN, INPUT_COLUMNS

TIME = "time_s"
DATABASE_KEY = "dbc"  # key of a channel map that names a database of CAN messages instead of a channel
DATABASE_SUFFIXES = (".dbc", ".arxml", ".kcd", ".sym")
INPUTS = INPUT_COLUMNS
SENSORS = NEEDED
OPTIONAL_INPUTS = ("u_flap_pct",)
THROTTLE = "alpha_th_pct"  # by which a petrol engine's recording is known (`petrol.recording`)
INTAKE = "t_im_k"  # no sensor of the table: the model takes it from the recording
AMBIENT = ("p_amb_pa", "t_amb_k")
DIESEL_COLUMNS = (*INPUTS, *OPTIONAL_INPUTS, *MEASURED, INTAKE, *AMBIENT)

# suffix of our columns -> the unit they are in
SUFFIX_UNITS: Mapping[str, str] = {
    "_pa": "Pa",
    "_k": "K",
    "_kg_s": "kg/s",
    "_rad_s": "rad/s",
    "_rpm": "rpm",
    "_pct": "%",
    "_mg": "mg/cycle",
    "_nm": "N m",
    "_w": "W",
    "_s": "s",
}

_RPM_TO_RAD_S = np.pi / 30.0
_KELVIN_AT_0_C = 273.15

# our unit -> foreign unit -> (scale, offset): ours = scale * theirs + offset
CONVERSIONS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "Pa": {unit: (factor, 0.0) for unit, factor in PRESSURE.items()},
    "K": {
        "K": (1.0, 0.0),
        "degC": (1.0, _KELVIN_AT_0_C),
        "C": (1.0, _KELVIN_AT_0_C),
        "degF": (5.0 / 9.0, _KELVIN_AT_0_C - 32.0 * 5.0 / 9.0),
        "degR": (5.0 / 9.0, 0.0),
    },
    "kg/s": {unit: (factor, 0.0) for unit, factor in MASS_RATE.items()},
    "rad/s": {"rad/s": (1.0, 0.0), "rpm": (_RPM_TO_RAD_S, 0.0), "krpm": (1e3 * _RPM_TO_RAD_S, 0.0),
              "Hz": (60.0 * _RPM_TO_RAD_S, 0.0), "1/s": (60.0 * _RPM_TO_RAD_S, 0.0)},
    "rpm": {"rpm": (1.0, 0.0), "1/s": (60.0, 0.0), "Hz": (60.0, 0.0), "rad/s": (1.0 / _RPM_TO_RAD_S, 0.0)},
    "%": {unit: (100.0 * factor, 0.0) for unit, factor in SHARE.items()},
    "mg/cycle": {"mg/cycle": (1.0, 0.0), "mg": (1.0, 0.0), "g/cycle": (1e3, 0.0), "kg/cycle": (1e6, 0.0)},
    "N m": {"N m": (1.0, 0.0), "Nm": (1.0, 0.0), "kN m": (1e3, 0.0)},
    "W": {"W": (1.0, 0.0), "kW": (1e3, 0.0)},
    "s": {unit: (size, 0.0) for unit, size in SECONDS.items()},
}


def unit_of(column: str) -> str | None:
    """Unit of one of our columns by its suffix ("p_im_pa" -> "Pa"), None for a dimensionless one."""
    for suffix, unit in SUFFIX_UNITS.items():  # longer suffixes stand before the shorter ones that they end in
        if column.endswith(suffix):
            return unit
    return None


def optional_inputs(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Further inputs that columns hold in at least one row, (n,) each."""
    return {name: columns[name] for name in OPTIONAL_INPUTS if name in columns and np.isfinite(columns[name]).any()}


def known_columns() -> tuple[str, ...]:
    """Columns that a recording may carry by DISCOVERY's recording format, required ones first."""
    return (TIME, *DIESEL_COLUMNS, "torque_nm")


LARGEST_FACTOR = 1e15  # of a scale or an offset


class ChannelEntry(StrictModel):
    """One entry of a channel map: ours = scale(unit) * scale * theirs + offset(unit) + offset.

    With `via` the formula of that name comes last: ours = formula(scale(unit) * scale * theirs + offset, others).
    """

    column: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    via: str | None = None
    cylinders: int | None = Field(default=None, ge=1, le=32)
    density_kg_l: float = Field(default=DIESEL_KG_L, gt=0.5, lt=1.2)
    ambient_pa: float | None = Field(default=None, gt=3e4, lt=2e5)

    @field_validator("scale", "offset")
    @classmethod
    def _of_a_size(cls, value: float) -> float:
        """No conversion of units is larger, and times of 1e-300 s would be simulated step by step."""
        if value != 0.0 and not 1.0 / LARGEST_FACTOR <= abs(value) <= LARGEST_FACTOR:
            raise ValueError(f"a number of size {1.0 / LARGEST_FACTOR:g} to {LARGEST_FACTOR:g}")
        return value

    @property
    def derivation(self) -> Derivation | None:
        """The formula named by `via`, None without."""
        return None if self.via is None else DERIVATIONS[self.via]

    @property
    def needs(self) -> tuple[str, ...]:
        """Our columns that the formula takes besides."""
        if self.derivation is None:
            return ()
        return tuple(name for name in self.derivation.needs if not (name == "p_amb_pa" and self.ambient_pa is not None))

    def converted(self, values: np.ndarray) -> np.ndarray:
        """Values (n,) in our unit, or in the one that the formula takes."""
        scale, offset = 1.0, 0.0
        if self.derivation is not None:
            scale = 1.0 if self.unit is None else self.derivation.units[self.unit]
        elif self.unit is not None:
            scale, offset = CONVERSIONS[unit_of(self.column) or ""][self.unit]
        return scale * self.scale * np.asarray(values, dtype=np.float64) + (offset + self.offset)

    def derived(self, converted: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Our column (n,) from converted values and the other columns at the same times."""
        if self.derivation is None:
            return converted
        constants = Constants(self.cylinders, self.density_kg_l, self.ambient_pa)
        return self.derivation.formula(converted, columns, constants)


@dataclass(frozen=True)
class ChannelMap:
    """Foreign name -> entry; `source` names the file in messages, `database` is the DBC of a CAN trace."""

    entries: Mapping[str, ChannelEntry]
    source: str = "channel map"
    database: Path | None = None

    def in_order(self) -> list[tuple[str, ChannelEntry]]:
        """The entries, computed ones after those that they need.

        Raises:
            InputError: two formulas need each other.
        """
        ordered = [(name, entry) for name, entry in self.entries.items() if entry.via is None]
        waiting = [(name, entry) for name, entry in self.entries.items() if entry.via is not None]
        computed = {entry.column for _, entry in waiting}
        while waiting:
            ready = [(name, entry) for name, entry in waiting if not computed.intersection(entry.needs)]
            if not ready:
                raise InputError(f"{self.source}: channel {waiting[0][0]!r}", "formulas that need each other",
                                 "one of them measured", "drop one `via`")
            ordered.extend(ready)
            computed -= {entry.column for _, entry in ready}
            waiting = [item for item in waiting if item not in ready]
        return ordered

    @property
    def made(self) -> Made:
        """What the entries compute, and the ambient pressure that they assume."""
        computed = [entry for _, entry in self.in_order() if entry.derivation is not None]
        assumed = [entry.ambient_pa for entry in computed if entry.ambient_pa is not None]
        return Made({e.column: e.derivation.follows for e in computed if e.derivation}, assumed[0] if assumed else None)

    def refuse_unknown(self, names: Sequence[str], where: str) -> None:
        """Every foreign name must be in the file.

        Raises:
            InputError: one is not.
        """
        missing = [name for name in self.entries if name not in names]
        if missing:
            name = missing[0]
            raise InputError(f"{self.source}: channel {name!r}", f"no such column in {where}", listed(list(names)),
                             did_you_mean(name, list(names)))

    def refuse_unfit(self, name: str, entry: ChannelEntry, given: Collection[str], where: str) -> None:
        """A column has one source, and what its formula needs must be mapped too.

        Raises:
            InputError: it isn't so.
        """
        if entry.column in given:
            raise InputError(f"{self.source}: channel {name!r}", f"{entry.column}, which {where} has already",
                             "one source for each column", "drop one of the two")  # fmt: skip
        absent = [need for need in entry.needs if need not in given]
        if absent:
            hint = " or give ambient_pa in this line" if absent[0] == "p_amb_pa" else ""
            raise InputError(f"{self.source}: channel {name!r}, via {entry.via}", f"no column {absent[0]}",
                             f"{entry.column} by {entry.via} needs {listed(entry.needs)}",
                             f"map a channel to {absent[0]}{hint}")

    def apply(self, columns: Mapping[str, np.ndarray], where: str) -> tuple[dict[str, np.ndarray], list[str]]:
        """Rename and convert columns, error codes left out; the ones without an entry pass through. And notes.

        Args:
            columns: foreign name -> values (n,).
            where: what is being read, for messages.

        Raises:
            InputError: a foreign name is not in the file, or two columns would get the same name.
        """
        self.refuse_unknown(list(columns), where)
        notes: list[str] = []
        renamed: dict[str, np.ndarray] = {
            name: values for name, values in columns.items() if name not in self.entries
        }
        for name, entry in self.in_order():
            self.refuse_unfit(name, entry, renamed, where)
            values = entry.derived(entry.converted(columns[name]), renamed)
            renamed[entry.column], coded = without_codes(entry.column, columns[name], values)
            notes.extend(coded)
        return renamed, notes


def channel_map(content: Mapping[str, Any], source: str = "channel map") -> ChannelMap:
    """Build a map from {foreign name: our column, or {column, unit, scale, offset, via, ...}}; `dbc` is no channel.

    Raises:
        InputError: unknown column, unit or key; two foreign names for one column.
    """
    entries: dict[str, ChannelEntry] = {}
    taken: dict[str, str] = {}
    database = content.get(DATABASE_KEY)
    if not isinstance(database, str) or Path(database).suffix.lower() not in DATABASE_SUFFIXES:
        database = None  # a channel that happens to be called so
    for name, value in content.items():
        if name == DATABASE_KEY and database is not None:
            continue
        place = f"{source}: channel {str(name)!r}"
        if isinstance(value, str):
            value = {"column": value}
        if not isinstance(value, Mapping):
            raise InputError(place, repr(value), "a column name or {column, unit, scale, offset}", "mend this line")
        entry = validate(ChannelEntry, value, place)
        _check_entry(place, entry)
        if entry.column in taken:
            raise InputError(
                place,
                f"{entry.column}, already given by {taken[entry.column]!r}",
                "one source for each column",
                "drop one of the two",
            )
        taken[entry.column] = str(name)
        entries[str(name)] = entry
    return ChannelMap(entries, source, None if database is None else Path(source).parent / database)


def _check_entry(place: str, entry: ChannelEntry) -> None:
    ours = unit_of(entry.column)
    if entry.column not in known_columns() and ours is None:
        # further channels are welcome, but only with a unit in the name: everything else is a typing error
        raise unknown_name(place, entry.column, known_columns())
    if entry.via is not None:
        _check_derivation(place, entry)
        return
    if entry.unit is None:
        return
    allowed: Sequence[str] = list(CONVERSIONS.get(ours or "", {}))
    if entry.unit not in allowed:
        raise InputError(
            f"{place}: unit",
            repr(entry.unit),
            listed(allowed) or "no unit: this column has none",
            "take one of these or give scale and offset",
        )


def _check_derivation(place: str, entry: ChannelEntry) -> None:
    derivation = DERIVATIONS.get(entry.via or "")
    if derivation is None:
        raise unknown_name(f"{place}: via", entry.via or "", list(DERIVATIONS))
    if entry.column not in derivation.gives:
        raise InputError(f"{place}: via {entry.via}", entry.column, listed(derivation.gives),
                         "change the column or drop via")
    if entry.unit is not None and entry.unit not in derivation.units:
        raise InputError(f"{place}: unit", repr(entry.unit), listed(list(derivation.units)),
                         "take one of these or give scale and offset")
    if derivation.cylinders and entry.cylinders is None:
        raise InputError(f"{place}: via {entry.via}", "no number of cylinders", "cylinders: 4, 6, ...",
                         "add it to this line")


def read_channel_map(path: str | Path) -> ChannelMap:
    """Read a channel map from YAML.

    Raises:
        InputError: not readable, not a mapping, or an entry that cannot be used.
    """
    return channel_map(read_mapping(path), str(path))


_NAME_IT = "name it in a channel map (--channels)"


def foreign_hint(missing: str, columns: Iterable[str]) -> str:
    """What to do about a missing column, naming the likeliest foreign one."""
    available = [c for c in columns if c != missing]
    if THROTTLE in {c.strip().lower() for c in available}:
        return "these are a petrol engine's columns: give its file, or liu_petrol (--engine)"
    hint = did_you_mean(missing, [c for c in available if c not in BY_COLUMN])  # what has our name is what it says
    if hint.startswith("did you mean"):
        return f"{hint} rename it or give a channel map (--channels)"
    if missing == TIME:
        return "add the times (--channels); settled points are for `calibrate`, `learn`, `discover` and `imply`"
    return f"add this column or {_NAME_IT}; `dieseltwin channels FILE` writes a first one"


def refuse_missing(where: str, columns: Iterable[str], wanted: Iterable[str], fewest: int) -> None:
    """Refuse a recording that lacks a wanted sensor, and say how to go on with the others where they are enough.

    Args:
        where: name for the message; columns: of the recording; wanted: sensor columns.
        fewest: sensors that are enough.

    Raises:
        InputError: one is missing.
    """
    columns = list(columns)
    missing = next((name for name in wanted if name not in columns), None)
    if missing is not None:
        there = [name for name in MEASURED if name in columns]
        hint = foreign_hint(missing, columns)
        if len(there) >= fewest:  # the list is to be copied: a line that is too long would be cut in its middle
            hint = f"{_NAME_IT if _NAME_IT in hint else hint}, or go without: --sensors {','.join(there)}"
        raise InputError(f"{where}: column {missing}", f"none ({listed(columns)})", "this column", hint)
