"""Quantities that follow from others: absolute from gauge pressure, fuel per stroke from fuel per hour, and so on.

A channel map names them with `via`::

    Boost:    {column: p_im_pa, unit: kPa, via: gauge}                                 # needs p_amb_pa
    FuelRate: {column: u_delta_mg, unit: L/h, via: fuel_volume_rate, cylinders: 6}     # needs n_e_rpm
    EGR_Rate: {column: w_egr_kg_s, unit: "%", via: egr_rate}                           # needs w_c_kg_s
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

DIESEL_KG_L = 0.835  # density of diesel at 15 degC [kg/L]: the middle of EN 590 (0.820 to 0.845), +-1.5 %
STOICHIOMETRIC = 14.57  # air to fuel by mass [-], the published engine's AF_s
STROKES = 120.0  # s/min times revolutions a cycle: n_e/120 cycles a second of a four-stroke engine
SLOWEST_RPM = 100.0  # below, fuel per stroke from fuel per hour means nothing: missing

AMBIENT = "p_amb_pa"
STAND_IN_PA = 101_325.0
"""Ambient pressure that stands in a map where nobody knows it: the engine file's is taken."""

Columns = Mapping[str, np.ndarray]
_POUND_KG, _HOUR_S, _MINUTE_S = 0.45359237, 3600.0, 60.0
MASS_RATE: Mapping[str, float] = {
    "kg/s": 1.0,
    "g/s": 1e-3,
    "kg/h": 1.0 / _HOUR_S,
    "kg/min": 1.0 / _MINUTE_S,
    "lb/min": _POUND_KG / _MINUTE_S,
    "lb/h": _POUND_KG / _HOUR_S,
    "lb/s": _POUND_KG,
    "t/h": 1e3 / _HOUR_S,
    "g/min": 1e-3 / _MINUTE_S,
    "g/h": 1e-3 / _HOUR_S,
    "mg/s": 1e-6,
}
"""Units of a mass flow in kg/s."""
_VOLUME_RATE = {"L/h": 1.0 / _HOUR_S, "L/s": 1.0, "L/min": 1.0 / _MINUTE_S, "mL/s": 1e-3, "mL/min": 1e-3 / _MINUTE_S,
                "gal/h": 3.785411784 / _HOUR_S, "m3/h": 1e3 / _HOUR_S}  # fmt: skip
PRESSURE: Mapping[str, float] = {
    "Pa": 1.0, "hPa": 1e2, "mbar": 1e2, "kPa": 1e3, "bar": 1e5, "MPa": 1e6, "psi": 6894.757293168361,
    "kgf/cm2": 98066.5, "atm": 101325.0, "mmHg": 133.322387415, "Torr": 101325.0 / 760.0, "inHg": 25.4 * 133.322387415,
    "mmH2O": 9.80665, "inH2O": 25.4 * 9.80665,
}  # fmt: skip
"""Units of a pressure in Pa; columns of mercury and water are the conventional ones (13.5951 and 1 g/cm3)."""
SHARE: Mapping[str, float] = {"%": 0.01, "fraction": 1.0, "1": 1.0, "permille": 1e-3}
"""Units of a share or a position, as a fraction."""


@dataclass(frozen=True)
class Constants:
    """What a formula takes from the channel map.

    Attributes:
        cylinders: number of cylinders [-].
        density_kg_l: of the fuel [kg/L].
        ambient_pa: where the file has no ambient pressure [Pa].
    """

    cylinders: int | None
    density_kg_l: float
    ambient_pa: float | None


@dataclass(frozen=True)
class Derivation:
    """One way from a foreign channel to one of our columns.

    Attributes:
        name: as written in `via`.
        gives: our columns that it can give.
        follows: our columns that it takes besides, at the same times -> power with which they enter, 0 where added.
        units: foreign unit -> factor to the unit of `value`.
        cylinders: whether the number of cylinders must be given.
        formula: (value (n,), columns, constants) -> ours (n,).
        words: what is done, for notes and maps.
    """

    name: str
    gives: tuple[str, ...]
    follows: Mapping[str, int]
    units: Mapping[str, float]
    cylinders: bool
    formula: Callable[[np.ndarray, Columns, Constants], np.ndarray]
    words: str

    @property
    def needs(self) -> tuple[str, ...]:
        """Our columns that it takes besides."""
        return tuple(self.follows)


@dataclass(frozen=True)
class Made:
    """What a channel map computed: columns that have to be worked out again where those that they follow are put right.

    Attributes:
        follows: column -> column that it follows -> power, 0 where added; each behind all that it follows.
        ambient_pa: ambient pressure that lines of the map assume [Pa], None where columns give it or none is needed.
    """

    follows: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    ambient_pa: float | None = None

    def among(self, columns: Collection[str]) -> Made:
        """What can be worked out from some columns and the ambient pressure."""
        there = {*columns, AMBIENT}
        kept = {
            name: {need: power for need, power in needs.items() if need in there}
            for name, needs in self.follows.items() if name in columns
        }  # fmt: skip
        return Made({name: needs for name, needs in kept.items() if needs}, self.ambient_pa)

    def of_recording(self, columns: dict[str, np.ndarray], p_amb_pa: float) -> tuple[Made, float]:
        """What of a recording's columns (n,) can be worked out again, and its ambient pressure [Pa].

        Args:
            columns: of the recording; gauge pressures whose ambient nobody knows are put under `p_amb_pa`.
            p_amb_pa: of the column, else the engine's [Pa].
        """
        there = self.among(columns)
        if there.ambient_pa is None:
            return there, p_amb_pa
        if AMBIENT in columns:  # the map asks for an ambient of its own
            needs = {name: {n: k for n, k in of.items() if n != AMBIENT} for name, of in there.follows.items()}
            return Made({name: of for name, of in needs.items() if of}), p_amb_pa
        if there.ambient_pa != STAND_IN_PA:
            return there, there.ambient_pa
        columns |= there.redone({**columns, **there.undone(columns, STAND_IN_PA)}, p_amb_pa)
        return there, p_amb_pa

    def undone(self, columns: Columns, ambient_pa: np.ndarray | float) -> dict[str, np.ndarray]:
        """The computed columns (n,) as they were recorded, up to a factor."""
        beside = {**columns, AMBIENT: ambient_pa}
        return {name: _applied(columns[name], needs, beside, -1) for name, needs in self.follows.items()}

    def redone(self, columns: Columns, ambient_pa: np.ndarray | float) -> dict[str, np.ndarray]:
        """Computed columns (n,) from what `undone` gave, which stands in their places, and from what they follow."""
        found = {**columns, AMBIENT: ambient_pa}
        for name, needs in self.follows.items():
            found[name] = _applied(np.asarray(found[name]), needs, found, 1)
        return {name: np.asarray(found[name]) for name in self.follows}


NOTHING = Made()
"""Of columns that were all recorded as they are."""


def _applied(
    values: np.ndarray, needs: Mapping[str, int], beside: Mapping[str, np.ndarray | float], sign: int
) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):  # a standing engine: missing already
        for need, power in needs.items():
            other = beside[need]
            values = values + sign * other if power == 0 else values * np.power(other, float(sign * power))
    return values


def _gauge(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return value + _ambient(columns, constants)


def _pressure_ratio(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return value * _ambient(columns, constants)


def _ambient(columns: Columns, constants: Constants) -> np.ndarray | float:
    return columns["p_amb_pa"] if constants.ambient_pa is None else constants.ambient_pa


def _above_intake(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return value + columns["p_im_pa"]


def fuel_per_stroke(flow_kg_s: np.ndarray, n_e_rpm: np.ndarray, cylinders: int) -> np.ndarray:
    """Fuel per cylinder and cycle [mg] of a flow [kg/s]: 1e6 W_f 120/(n_e n_cyl), Eq. (A.5) turned round; NaN where the
    engine stands."""
    with np.errstate(divide="ignore", invalid="ignore"):
        fuel = 1e6 * flow_kg_s * STROKES / (n_e_rpm * cylinders)
    return np.where(n_e_rpm >= SLOWEST_RPM, fuel, np.nan)


def _per_stroke(flow_kg_s: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return fuel_per_stroke(flow_kg_s, columns["n_e_rpm"], constants.cylinders or 1)


def _fuel_volume_rate(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return _per_stroke(value * constants.density_kg_l, columns, constants)


def _fuel_volume(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return value * constants.density_kg_l  # mm3 times kg/L is mg


def _egr_rate(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    """W_egr = x W_c/(1 - x), for x = W_egr/(W_c + W_egr)."""
    return np.where(value < 1.0, value * columns["w_c_kg_s"] / np.maximum(1.0 - value, 1e-3), np.nan)


def _air_per_stroke(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    return value * columns["n_e_rpm"] * (constants.cylinders or 1) / STROKES


def _lambda(value: np.ndarray, columns: Columns, constants: Constants) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        fuel = np.where(value > 0.0, columns["w_c_kg_s"] / (value * STOICHIOMETRIC), np.nan)
    return _per_stroke(fuel, columns, constants)


_TABLE = (
    Derivation(
        "gauge",
        ("p_im_pa", "p_em_pa", "p_ic_pa"),
        {"p_amb_pa": 0},
        PRESSURE,
        False,
        _gauge,
        "gauge pressure plus ambient pressure",
    ),
    Derivation(
        "pressure_ratio",
        ("p_im_pa", "p_em_pa"),
        {"p_amb_pa": 1},
        {"1": 1.0},
        False,
        _pressure_ratio,
        "pressure ratio times ambient pressure",
    ),
    Derivation(
        "above_intake",
        ("p_em_pa",),
        {"p_im_pa": 0},
        PRESSURE,
        False,
        _above_intake,
        "pressure difference over the EGR path plus intake pressure",
    ),
    Derivation(
        "fuel_rate",
        ("u_delta_mg",),
        {"n_e_rpm": -1},
        MASS_RATE,
        True,
        _per_stroke,
        "fuel flow over engine speed and cylinders",
    ),
    Derivation(
        "fuel_volume_rate",
        ("u_delta_mg",),
        {"n_e_rpm": -1},
        _VOLUME_RATE,
        True,
        _fuel_volume_rate,
        "fuel volume flow times density over engine speed and cylinders",
    ),
    Derivation(
        "fuel_volume", ("u_delta_mg",), {}, {"mm3/cycle": 1.0}, False, _fuel_volume, "injected volume times density"
    ),
    Derivation(
        "egr_rate",
        ("w_egr_kg_s",),
        {"w_c_kg_s": 1},
        SHARE,
        False,
        _egr_rate,
        "EGR share x of the air flow: x W_c/(1 - x)",
    ),
    Derivation(
        "air_per_stroke",
        ("w_c_kg_s",),
        {"n_e_rpm": 1},
        {"mg/cycle": 1e-6, "g/cycle": 1e-3, "kg/cycle": 1.0},
        True,
        _air_per_stroke,
        "air per stroke times engine speed and cylinders",
    ),
    Derivation(
        "lambda",
        ("u_delta_mg",),
        {"n_e_rpm": -1, "w_c_kg_s": 1},
        {"1": 1.0},
        True,
        _lambda,
        f"air flow over lambda and {STOICHIOMETRIC:g}, over engine speed and cylinders",
    ),
)
DERIVATIONS: Mapping[str, Derivation] = {derivation.name: derivation for derivation in _TABLE}
