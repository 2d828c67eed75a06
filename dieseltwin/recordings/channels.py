"""Channels of a recording: our columns and units, and maps from foreign names and units.

A channel map is a YAML file, one entry a channel, foreign name first::

    Time: time_s                                    # same unit, other name
    P_boost: {column: p_im_pa, unit: kPa}           # a named unit
    T_exh: {column: t_em_k, unit: degC}
    EGR_pos: {column: u_egr_pct, scale: 100.0}      # ours = scale * theirs + offset
    P_rail_gauge: {column: p_em_pa, unit: kPa, offset: 101325}   # offset in our unit, added last

Columns that already carry our names need no entry. Everything is SI (and %, mg/cycle, rpm) after the reader.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dieseltwin.errors import InputError
from dieseltwin.settings.strict import StrictModel, did_you_mean, listed, read_mapping, unknown_name, validate
from dieseltwin.symbols import MEASURED

TIME = "time_s"
INPUTS = ("n_e_rpm", "u_delta_mg", "u_egr_pct", "u_vgt_pct")
SENSORS = MEASURED[:5]
OPTIONAL_SENSORS = ("w_c_kg_s", "t_im_k")
AMBIENT = ("p_amb_pa", "t_amb_k")

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
    "Pa": {
        "Pa": (1.0, 0.0),
        "hPa": (1e2, 0.0),
        "mbar": (1e2, 0.0),
        "kPa": (1e3, 0.0),
        "bar": (1e5, 0.0),
        "MPa": (1e6, 0.0),
        "psi": (6894.757293168361, 0.0),
    },
    "K": {
        "K": (1.0, 0.0),
        "degC": (1.0, _KELVIN_AT_0_C),
        "C": (1.0, _KELVIN_AT_0_C),
        "degF": (5.0 / 9.0, _KELVIN_AT_0_C - 32.0 * 5.0 / 9.0),
    },
    "kg/s": {"kg/s": (1.0, 0.0), "g/s": (1e-3, 0.0), "kg/h": (1.0 / 3600.0, 0.0)},
    "rad/s": {"rad/s": (1.0, 0.0), "rpm": (_RPM_TO_RAD_S, 0.0), "krpm": (1e3 * _RPM_TO_RAD_S, 0.0)},
    "rpm": {"rpm": (1.0, 0.0), "1/s": (60.0, 0.0), "Hz": (60.0, 0.0), "rad/s": (1.0 / _RPM_TO_RAD_S, 0.0)},
    "%": {"%": (1.0, 0.0), "fraction": (100.0, 0.0), "1": (100.0, 0.0)},
    "mg/cycle": {"mg/cycle": (1.0, 0.0), "mg": (1.0, 0.0), "g/cycle": (1e3, 0.0), "kg/cycle": (1e6, 0.0)},
    "N m": {"N m": (1.0, 0.0), "Nm": (1.0, 0.0), "kN m": (1e3, 0.0)},
    "W": {"W": (1.0, 0.0), "kW": (1e3, 0.0)},
    "s": {"s": (1.0, 0.0), "ms": (1e-3, 0.0), "us": (1e-6, 0.0), "min": (60.0, 0.0), "h": (3600.0, 0.0)},
}


def unit_of(column: str) -> str | None:
    """Unit of one of our columns by its suffix ("p_im_pa" -> "Pa"), None for a dimensionless one."""
    for suffix, unit in SUFFIX_UNITS.items():  # longer suffixes stand before the shorter ones that they end in
        if column.endswith(suffix):
            return unit
    return None


def known_columns() -> tuple[str, ...]:
    """Columns that a recording may carry by DISCOVERY's recording format, required ones first."""
    return (TIME, *INPUTS, *SENSORS, *OPTIONAL_SENSORS, *AMBIENT, "torque_nm")


class ChannelEntry(StrictModel):
    """One entry of a channel map: ours = scale(unit) * scale * theirs + offset(unit) + offset."""

    column: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class ChannelMap:
    """Foreign name -> entry; `source` names the file in messages."""

    entries: Mapping[str, ChannelEntry]
    source: str = "channel map"

    def apply(self, columns: Mapping[str, np.ndarray], where: str) -> dict[str, np.ndarray]:
        """Rename and convert columns; the ones without an entry pass through.

        Args:
            columns: foreign name -> values (n,).
            where: what is being read, for messages.

        Raises:
            InputError: a foreign name is not in the file, or two columns would get the same name.
        """
        missing = [name for name in self.entries if name not in columns]
        if missing:
            name = missing[0]
            raise InputError(
                f"{self.source}: channel {name!r}",
                f"no such column in {where}",
                listed(list(columns)),
                did_you_mean(name, list(columns)),
            )
        renamed: dict[str, np.ndarray] = {
            name: values for name, values in columns.items() if name not in self.entries
        }
        for name, entry in self.entries.items():
            if entry.column in renamed:
                raise InputError(
                    f"{self.source}: channel {name!r}",
                    f"{entry.column}, which {where} has already",
                    "one source for each column",
                    "drop one of the two",
                )
            renamed[entry.column] = _convert(columns[name], entry)
        return renamed


def _convert(values: np.ndarray, entry: ChannelEntry) -> np.ndarray:
    scale, offset = 1.0, 0.0
    if entry.unit is not None:
        scale, offset = CONVERSIONS[unit_of(entry.column) or ""][entry.unit]
    return scale * entry.scale * np.asarray(values, dtype=np.float64) + (offset + entry.offset)


def channel_map(content: Mapping[str, Any], source: str = "channel map") -> ChannelMap:
    """Build a map from {foreign name: our column, or {column, unit, scale, offset}}.

    Raises:
        InputError: unknown column, unit or key; two foreign names for one column.
    """
    entries: dict[str, ChannelEntry] = {}
    taken: dict[str, str] = {}
    for name, value in content.items():
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
    return ChannelMap(entries, source)


def _check_entry(place: str, entry: ChannelEntry) -> None:
    ours = unit_of(entry.column)
    if entry.column not in known_columns() and ours is None:
        # further channels are welcome, but only with a unit in the name: everything else is a typing error
        raise unknown_name(place, entry.column, known_columns())
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


def read_channel_map(path: str | Path) -> ChannelMap:
    """Read a channel map from YAML.

    Raises:
        InputError: not readable, not a mapping, or an entry that cannot be used.
    """
    return channel_map(read_mapping(path), str(path))


def foreign_hint(missing: str, columns: Iterable[str]) -> str:
    """What to do about a missing column, naming the likeliest foreign one."""
    available = [c for c in columns if c != missing]
    hint = did_you_mean(missing, available)
    if hint.startswith("did you mean"):
        return f"{hint} rename it or give a channel map (--channels)"
    return "add this column or name it in a channel map (--channels)"
