"""Spellings of units, and what they say: dimension, our spelling, gauge or absolute."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass

# dimension -> our spelling -> spellings met in files (lower case, blanks and brackets gone)
_SPELLINGS: Mapping[str, Mapping[str, str]] = {
    "pressure": {
        "Pa": "pa pascal", "hPa": "hpa", "mbar": "mbar mbara mbar_a mbarg mbar_g", "kPa": "kpa kpaa kpag kpa_a kpa_g",
        "bar": "bar bara barg bar_a bar_g", "MPa": "mpa", "psi": "psi psia psig",
    },
    "temperature": {
        "K": "k kelvin", "degC": "°c degc c celsius grdc gradc ºc grad deg.c deg_c",
        "degF": "°f degf f fahrenheit deg_f",
    },
    "mass flow": {
        "kg/s": "kg/s kg/sec kgps kg*s^-1", "g/s": "g/s g/sec gps gm/sec gm/s", "kg/min": "kg/min",
        "kg/h": "kg/h kg/hr kg/std kgph kg/hour", "g/h": "g/h", "lb/min": "lb/min lbm/min", "lb/h": "lb/h lb/hr",
    },
    "volume flow": {
        "L/h": "l/h l/hr lph liter/h l/std litre/h l/hour", "L/s": "l/s", "L/min": "l/min lpm", "mL/s": "ml/s",
        "gal/h": "gal/h gph gal/hr",
    },
    "rotation": {
        "rpm": "rpm 1/min min-1 u/min min^-1 r/min /min upm tr/min tr/mn rev/min", "1/s": "1/s s-1", "Hz": "hz",
        "rad/s": "rad/s rad/sec", "krpm": "krpm 1000/min k1/min 1000rpm",
    },
    "share": {"%": "% pct percent prozent %open", "fraction": "fraction"},
    "per cycle": {
        "mg/cycle": "mg/cycle mg/cyc mg/hub mg/str mg/stroke mg/inj mg/asp mg/zyl mg mg/r mg/st mg/shot mg/cyl mg/h "
        "mg/cp",
        "g/cycle": "g/cycle g/hub g/stroke g/cyc", "kg/cycle": "kg/cycle kg/hub",
        "mm3/cycle": "mm3/hub mm3/stroke mm3 mm³/hub mm³ mm3/cyc mm3/inj mm3/cycle",
    },
    "torque": {"Nm": "nm n·m n*m n.m newtonmeter", "kN m": "knm"},
    "number": {"1": "1 - -- ratio lambda none"},
    "time": {"s": "s sec", "ms": "ms", "us": "us µs", "min": "min", "h": "h"},
    "other": {
        "V": "v mv volt", "A": "a", "km/h": "km/h m/s mph kph", "kW": "kw w ps hp", "ppm": "ppm", "g/kWh": "g/kwh",
        "deg": "° deg °ca degca °kw", "m/s2": "m/s2 m/s² g/g", "mg/m3": "mg/m3 1/m fsn mg/l",
        "km": "km m mm l l/100km km/l mpg gear bit bool state enum count ohm kg g cm3 ml",
    },
}  # fmt: skip
_KNOWN = {word: (dimension, ours) for dimension, units in _SPELLINGS.items()
          for ours, words in units.items() for word in words.split()}
_GAUGE = re.compile(r"(^psig$|bar_?\(?g\)?$|kpa_?\(?g\)?$|rel$|gauge|\(g\)$|ü$)")
_A_STROKE = re.compile(r"(mg|g|kg|mm3|ul)/(str\w*|stk|hub|takt|cyc\w*|zyl\w*|cyl\w*|inj\w*|shot|coup|cp|corsa|ciclo|"
                       r"carrera|slag|slaglangd|comb\w*|asp\w*|ladung|sp|zyklus)")  # fmt: skip
_ABSOLUTE = re.compile(r"(^psia$|bar_?\(?a\)?$|kpa_?\(?a\)?$|abs$|\(a\)$)")


@dataclass(frozen=True)
class Unit:
    """A unit as understood.

    Attributes:
        dimension: "pressure", "mass flow", ...; "unknown" where nobody knows the spelling.
        ours: our spelling.
        gauge: True and False where the unit says so, None else.
    """

    dimension: str
    ours: str
    gauge: bool | None = None


def understood(spelling: str | None) -> Unit | None:
    """What a file's unit means; None where it says none (a lone '-' says nothing either)."""
    if spelling is None:
        return None
    text = re.sub(r"\s+", "", unicodedata.normalize("NFKC", spelling).strip().strip("[]").lower())
    if not text or text in ("-", "--", "none", "n/a", "unit", "?"):
        return None
    gauge = True if _GAUGE.search(text) else False if _ABSOLUTE.search(text) else None
    for candidate in (text, re.sub(r"[_(]?(abs|rel|gauge|a|g|ü)\)?$", "", text)):
        if candidate in _KNOWN:
            dimension, ours = _KNOWN[candidate]
            return Unit(dimension, ours, gauge if dimension == "pressure" else None)
    a_stroke = _A_STROKE.fullmatch(text)
    if a_stroke is not None:
        return Unit("per cycle", {"ul": "mm3"}.get(a_stroke.group(1), a_stroke.group(1)) + "/cycle")
    return Unit("unknown", spelling.strip())
