"""Spellings of units, and what they say: dimension, our spelling, gauge or absolute."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass

from dieseltwin.recordings.time_units import SPELLINGS

# dimension -> our spelling -> spellings met in files (lower case, blanks and brackets gone)
_SPELLINGS: Mapping[str, Mapping[str, str]] = {
    "pressure": {
        "Pa": "pa pascal", "hPa": "hpa", "mbar": "mbar mbara mbar_a mbarg mbar_g", "kPa": "kpa kpaa kpag kpa_a kpa_g",
        "bar": "bar bara barg bar_a bar_g", "MPa": "mpa", "psi": "psi psia psig lbf/in2 lb/in2",
        "kgf/cm2": "kgf/cm2 kg/cm2 kp/cm2 at ata", "atm": "atm", "mmHg": "mmhg mmqs", "Torr": "torr", "inHg": "inhg",
        "mmH2O": "mmh2o mmwc mmws mmwg mmca", "inH2O": "inh2o inwc inwg",
    },
    "temperature": {
        "K": "k kelvin", "degC": "°c degc c celsius grdc gradc ºc grad deg.c deg_c",
        "degF": "°f degf f fahrenheit deg_f", "degR": "°r degr r rankine",
    },
    "mass flow": {
        "kg/s": "kg/s kg/sec kgps kg*s^-1", "g/s": "g/s g/sec gps gm/sec gm/s", "kg/min": "kg/min",
        "kg/h": "kg/h kg/hr kg/std kgph kg/hour", "g/h": "g/h g/hr", "g/min": "g/min", "mg/s": "mg/s mg/sec",
        "lb/min": "lb/min lbm/min lbs/min", "lb/h": "lb/h lb/hr lbm/h lbm/hr lbs/h lbs/hr pph",
        "lb/s": "lb/s lbm/s lbs/s pps", "t/h": "t/h t/hr",
    },
    "volume flow": {
        "L/h": "l/h l/hr lph liter/h l/std litre/h l/hour", "L/s": "l/s l/sec", "L/min": "l/min lpm",
        "mL/s": "ml/s cc/s ccm/s cm3/s", "mL/min": "ml/min cc/min ccm/min cm3/min", "gal/h": "gal/h gph gal/hr",
        "m3/h": "m3/h m3/hr cbm/h",
    },
    "gas volume flow": {"Nm3/h": "nm3/h sm3/h nm3/min m3/min m3/s nl/min slm slpm sl/min nl/s nl/h",
                        "SCFM": "scfm cfm acfm scfh cfh icfm ft3/min"},
    "rotation": {
        "rpm": "rpm 1/min min-1 u/min min^-1 r/min /min upm tr/min tr/mn rev/min", "1/s": "1/s s-1", "Hz": "hz",
        "rad/s": "rad/s rad/sec", "krpm": "krpm 1000/min k1/min 1000rpm "
        "rpmx1000 rpm*1000 x1000rpm 1000*rpm 1000xrpm 1000u/min 10^31/min 10^3/min 10^3rpm 10^3min-1 kmin-1",
    },
    "share": {"%": "% pct percent prozent %open", "fraction": "fraction", "permille": "‰ permille promille permil"},
    "per cycle": {
        "mg/cycle": "mg/cycle mg/cyc mg/hub mg/str mg/stroke mg/inj mg/asp mg/zyl mg mg/r mg/st mg/shot mg/cyl mg/h "
        "mg/cp",
        "g/cycle": "g/cycle g/hub g/stroke g/cyc", "kg/cycle": "kg/cycle kg/hub",
        "mm3/cycle": "mm3/hub mm3/stroke mm3 mm3/cyc mm3/inj mm3/cycle mm3/h",
    },
    "torque": {"Nm": "nm n·m n*m n.m newtonmeter", "kN m": "knm"},
    "number": {"1": "1 - -- ratio lambda none"},
    "time": SPELLINGS,
    "other": {
        "V": "v mv volt", "A": "a", "km/h": "km/h m/s mph kph", "kW": "kw w ps hp", "ppm": "ppm", "g/kWh": "g/kwh",
        "deg": "° deg °ca degca °kw", "m/s2": "m/s2 m/s² g/g", "mg/m3": "mg/m3 1/m fsn mg/l",
        "km": "km m mm l l/100km km/l mpg gear bit bool state enum count ohm kg g cm3 ml",
    },
}  # fmt: skip
_KNOWN = {word: (dimension, ours) for dimension, units in _SPELLINGS.items()
          for ours, words in units.items() for word in words.split()}
_GAUGE = re.compile(r"(^psig$|bar_?\(?g\)?$|kpa_?\(?g\)?$|cm2_?\(?g\)?$|rel(ative?)?$|gauge|gage|\(g\)$|ü$)")
_A_STROKE = re.compile(r"(mg|g|kg|mm3|ul)/(str\w*|stk|st|hub|takt|cyc\w*|zyl\w*|cyl\w*|inj\w*|shot|coup|cp|corsa|ciclo|"
                       r"carrera|slag|slaglangd|comb\w*|asp\w*|ladung|sp|zyklus)")  # fmt: skip
_ABSOLUTE = re.compile(r"(^psia$|^ata$|bar_?\(?a\)?$|kpa_?\(?a\)?$|cm2_?\(?a\)?$|abs(olute?)?$|\(a\)$)")


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
    text = re.sub(r"\s+", "", unicodedata.normalize("NFKC", spelling).strip().strip("[]").lower()).rstrip(".")
    text = text.replace("^3", "3").replace("^2", "2") if text[:2] != "10" else text
    if not text or text in ("-", "--", "none", "n/a", "unit", "?"):
        return None
    gauge = True if _GAUGE.search(text) else False if _ABSOLUTE.search(text) else None
    for candidate in (text, re.sub(r"[_(]?(abs(olute?)?|rel(ative?)?|gauge|gage|a|g|ü)\)?$", "", text)):
        if candidate in _KNOWN:
            dimension, ours = _KNOWN[candidate]
            return Unit(dimension, ours, gauge if dimension == "pressure" else None)
    a_stroke = _A_STROKE.fullmatch(text)
    if a_stroke is not None:
        return Unit("per cycle", {"ul": "mm3"}.get(a_stroke.group(1), a_stroke.group(1)) + "/cycle")
    return Unit("unknown", spelling.strip())
