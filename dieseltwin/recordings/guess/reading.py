"""In which unit a channel would be a given quantity: by its unit where the file says one, by its values else."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.recordings.channels import ChannelEntry, unit_of
from dieseltwin.recordings.derived import DERIVATIONS, STAND_IN_PA
from dieseltwin.recordings.guess.facts import Facts
from dieseltwin.recordings.guess.names import Meaning
from dieseltwin.recordings.unit_spellings import Unit
from dieseltwin.symbols import symbol

GAUGE_BELOW_PA = 6.0e4  # an absolute pressure of a running engine at 3 km altitude stays above
ABSOLUTE_ABOVE_PA = 7.5e4  # between the two it could be either
HIGH_LOWEST_PA = 1.35e5  # an intake pressure that never comes down to the ambient may be either, too
HIGH_GAUGE_PA = 1.0e4  # above the ambient: an engine that idles has less boost
LOWEST_GAUGE_PA = -3.5e4  # behind a throttle or a clogged filter
ENGINE_RPM = (300.0, 5000.0)
FRACTION_HIGH = 1.2
SHARE_RANGE = (-12.0, 130.0)  # %: sensors of positions drift beyond their ends
TURBO_RPM = 2.5e4  # rad/s: no turbocharger turns faster, so larger values are rpm
USUAL_K = {"t_em_k": (330.0, 1250.0), "t_im_k": (225.0, 430.0), "t_amb_k": (220.0, 335.0)}
"""Of a median, where it is narrower than what the nomenclature allows."""
COLD_EXHAUST = 330.0  # a value below this is in degC: exhaust gas of a running engine is hotter than 330 K
HOT_AIR = 180.0  # an air temperature above this is in K, below in degC

UNKNOWN_UNIT = 0.9  # factor where the file says a unit that isn't known
LIKELY_UNITS = {"Pa": ("kPa", "hPa", "bar", "Pa"), "K": ("degC", "K"), "kg/s": ("kg/h", "g/s", "kg/s"),
                "rad/s": ("rpm", "rad/s")}  # fmt: skip
COMMON_PRESSURES = ("kPa", "bar", "hPa", "mbar", "Pa", "psi", "MPa")  # that values alone may tell
_NO_UNIT = "the file gives no unit"
_SAYS_GAUGE = re.compile(r"\b(gauge|gage|rel|relativ|relative|ueberdruck|g)\b")
_SAYS_ABSOLUTE = re.compile(r"\b(abs|absolute?|absolut)\b|abs$")
_SAYS_SHUT = re.compile(r"\b(clos(ed|ing|ure)|shut|zu|geschlossen|ferme(ture)?|chius[oa]|cerrad[oa]|fechad[oa])\b")
_SPN_GAUGE, _SPN_ABSOLUTE = frozenset({102, 1127}), frozenset({106, 3563, 108, 1176})


@dataclass(frozen=True)
class Reading:
    """One way to take a channel as one of our quantities.

    Attributes:
        entry: the line of a channel map.
        factor: how well unit and values fit, 0 to 1; times the score of the name.
        reasons: what speaks for it, in words.
        warnings: what should be checked, in words.
        alternatives: other units that the values allow; physics chooses among them.
    """

    entry: ChannelEntry
    factor: float
    reasons: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    alternatives: tuple[Reading, ...] = ()

    def with_warning(self, text: str) -> Reading:
        """The same with one more warning."""
        return replace(self, warnings=(*self.warnings, text))


def reading_of(facts: Facts, meaning: Meaning, unit: Unit | None, words: str, cylinders: int) -> Reading | None:
    """Take a channel as a meaning, None where unit or values rule it out.

    Args:
        facts: of the channel.
        meaning: what its name says it could be.
        unit: as the file says it; None where it doesn't.
        words: of its name.
        cylinders: of the engine, for fuel and air per stroke.
    """
    if unit is not None and unit.dimension not in (*meaning.dimensions, "unknown", "number"):
        return None
    if unit is not None and unit.dimension == "number" and not {"share", "number"} & set(meaning.dimensions):
        return None
    if unit is not None and unit.dimension == "unknown":
        found = reading_of(replace(facts, unit=None), meaning, None, words, cylinders)
        return None if found is None else _in_doubt(found, unit.ours)
    dimension = unit.dimension if unit is not None and unit.dimension in meaning.dimensions else meaning.dimensions[0]
    read: dict[str, Callable[[Facts, Meaning, Unit | None, str], Reading | None]] = {
        "pressure": _pressure,
        "temperature": _temperature,
        "rotation": _rotation,
        "share": _share,
        "number": _share,
        "mass flow": _mass_flow,
        "volume flow": _volume_flow,
        "per cycle": _per_cycle,
        "torque": _torque,
    }
    by_rules = read[dimension] if meaning.usual is None or dimension == "share" else _in_usual_range
    found = by_rules(facts, meaning, unit, words)
    return None if found is None else _with_cylinders(found, cylinders)


def _in_doubt(reading: Reading, spelling: str) -> Reading:
    """A guess at a unit that the file says in a spelling that nobody knows."""
    text = f"the unit {spelling!r} isn't known, and was guessed from the values as {reading.entry.unit}"
    others = tuple(_in_doubt(other, spelling) for other in reading.alternatives)
    warnings = (text, *(warning for warning in reading.warnings if not warning.startswith(_NO_UNIT)))
    return replace(reading, factor=UNKNOWN_UNIT * reading.factor, warnings=warnings, alternatives=others)


def _with_cylinders(reading: Reading, cylinders: int) -> Reading:
    if reading.entry.derivation is None or not reading.entry.derivation.cylinders:
        return reading
    entry = reading.entry.model_copy(update={"cylinders": cylinders})
    others = tuple(_with_cylinders(other, cylinders) for other in reading.alternatives)
    return replace(reading, entry=entry, alternatives=others)


def in_our_unit(entry: ChannelEntry, value: float) -> float:
    """A single value converted, without the formula of `via`."""
    return float(entry.converted(value))  # type: ignore[arg-type]


def _plausible(entry: ChannelEntry, facts: Facts, low: float, high: float) -> bool:
    return low <= in_our_unit(entry, facts.median) <= high


def _told(unit: Unit | None, spelling: str) -> tuple[str, ...]:
    return (f"unit {spelling}",) if unit is not None else ()


def _choose(facts: Facts, unit: Unit | None, entries: list[tuple[ChannelEntry, float, float]]) -> Reading | None:
    """The file's own unit where its values make sense, else the likeliest of those that do, with a warning.

    Args:
        facts: of the channel.
        unit: of the file.
        entries: (line of the map, lowest and highest sensible median in the line's unit), likeliest first.
    """
    fitting = [entry for entry, low, high in entries if _plausible(entry, facts, low, high)]
    if unit is not None:
        own = [entry for entry in fitting if entry.unit == unit.ours]
        if own:
            return Reading(own[0], 1.0, (f"unit {unit.ours}",))
        if not fitting:
            return None
        text = f"the file says {unit.ours}, but a median of {facts.median:.4g} looks like {fitting[0].unit}"
        return Reading(fitting[0], 0.7, (), (text,), tuple(Reading(entry, 0.6, ()) for entry in fitting[1:]))
    if not fitting:
        return None
    text = f"{_NO_UNIT}; {facts.low:.4g} to {facts.high:.4g} looks like {fitting[0].unit}"
    if len(fitting) == 1:
        return Reading(fitting[0], 0.9, (f"{facts.low:.4g} to {facts.high:.4g} fits {fitting[0].unit} only",), (text,))
    others = " or ".join(str(entry.unit) for entry in fitting[1:3])
    return Reading(fitting[0], 0.8, (), (f"{text} (or {others}?)",),
                   tuple(Reading(entry, 0.75, (), (text.replace(f"like {fitting[0].unit}", f"like {entry.unit}"),))
                         for entry in fitting[1:]))  # fmt: skip


def _pressure(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    column = meaning.column
    if column == "p_amb_pa":
        entries = [(ChannelEntry(column=column, unit=name), 5.5e4, 1.1e5) for name in _or_own(COMMON_PRESSURES, unit)]
        found = _choose(facts, unit, entries)
        spread = 0.0 if found is None else in_our_unit(found.entry, facts.high) - in_our_unit(found.entry, facts.low)
        if found is not None and spread > 2.5e4:
            return replace(found, factor=0.5).with_warning(f"moves by {spread / 1e3:.0f} kPa: is this the ambient?")
        return found
    gauge = _says_gauge(facts, unit, words)
    options = []
    for name in _or_own(COMMON_PRESSURES, unit):
        if unit is None and name in ("mbar", "MPa"):
            continue  # as good as hPa, and never met
        absolute = ChannelEntry(column=column, unit=name)
        relative = ChannelEntry(column=column, unit=name, via="gauge")
        lowest = in_our_unit(absolute, facts.low)
        if gauge is not True and lowest >= GAUGE_BELOW_PA:
            options.append((absolute, 7e4, 7e5))
        if gauge is not False and lowest > LOWEST_GAUGE_PA and (gauge is True or lowest < GAUGE_BELOW_PA):
            options.append((relative, -2e4, 6e5))
    found = _choose(facts, unit, options)
    if found is None:
        return None
    judged = _judged_gauge(found, facts, gauge, column)
    if gauge is None and found.entry.via is None and column == "p_em_pa":
        other = found.entry.model_copy(update={"via": "gauge"})
        text = ("taken as gauge, because absolute it would lie below p_im; its lowest value is "
                f"{in_our_unit(found.entry, facts.low) / 1e3:.4g} kPa")
        judged = replace(judged, alternatives=(*judged.alternatives, Reading(other, 0.8, (), (text,))))
    return judged


def _in_usual_range(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    """By the range in which the quantity's median is, and the pressure below which no reading can be."""
    low, high = meaning.usual or (-np.inf, np.inf)
    ours = unit_of(meaning.column) or ""
    entries = [ChannelEntry(column=meaning.column, unit=name) for name in _or_own(LIKELY_UNITS[ours], unit)]
    if ours != "Pa":
        return _choose(facts, unit, [(entry, low, high) for entry in entries])
    gauge = _says_gauge(facts, unit, words)
    lowest = {entry.unit: in_our_unit(entry, facts.low) for entry in entries}
    absolute = [entry for entry in entries if gauge is False or (gauge is None and lowest[entry.unit] >= meaning.least)]
    relative = [entry for entry in entries if gauge is not False and entry not in absolute]
    found = _choose(facts, unit, [
        *((entry, low, high) for entry in absolute),
        *((entry.model_copy(update={"via": "gauge"}), low - STAND_IN_PA, high - STAND_IN_PA) for entry in relative),
    ])  # fmt: skip
    if found is None or found.entry.via is None or gauge is True or lowest[found.entry.unit] < HIGH_GAUGE_PA:
        return found
    return found.with_warning(f"its lowest value of {lowest[found.entry.unit] / 1e3:.3g} kPa is low for an absolute "
                              "pressure there and high for gauge: is it another pressure?")  # fmt: skip


def _or_own(usual: Sequence[str], unit: Unit | None) -> tuple[str, ...]:
    """The usual units of a quantity, and the file's own behind them."""
    return tuple(dict.fromkeys((*usual, *(() if unit is None else (unit.ours,)))))


def _judged_gauge(found: Reading, facts: Facts, gauge: bool | None, column: str) -> Reading:
    lowest = in_our_unit(found.entry, facts.low)
    if found.entry.via is not None:
        reason = "gauge, as it says" if gauge else f"gauge: its lowest value is {lowest / 1e3:.3g} kPa"
        return replace(found, reasons=(*found.reasons, reason))
    if gauge is None and (lowest < ABSOLUTE_ABOVE_PA or (column == "p_im_pa" and lowest > HIGH_LOWEST_PA)):
        return found.with_warning(f"taken as absolute; its lowest value of {lowest / 1e3:.3g} kPa allows gauge too")
    return replace(found, reasons=(*found.reasons, "absolute"))


def _says_gauge(facts: Facts, unit: Unit | None, words: str) -> bool | None:
    if facts.spn in _SPN_GAUGE:
        return True
    if facts.spn in _SPN_ABSOLUTE:
        return False
    if unit is not None and unit.gauge is not None:
        return unit.gauge
    return True if _SAYS_GAUGE.search(words) else False if _SAYS_ABSOLUTE.search(words) else None


def _temperature(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    column = meaning.column
    range_ = symbol(column)
    low, high = USUAL_K.get(column, (range_.low, range_.high))
    celsius, kelvin, fahrenheit, rankine = (ChannelEntry(column=column, unit=name)
                                            for name in ("degC", "K", "degF", "degR"))  # fmt: skip
    order = [celsius, kelvin]
    if facts.low >= (COLD_EXHAUST if column == "t_em_k" else HOT_AIR):
        order = [kelvin, celsius]
    elif column == "t_em_k" or facts.median < HOT_AIR:
        order = [celsius]
    if unit is not None:
        order = [celsius, kelvin, fahrenheit, *((rankine,) if unit.ours == "degR" else ())]
    return _choose(facts, unit, [(entry, low, high) for entry in order])


def _rotation(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    column = meaning.column
    if column == "n_e_rpm":
        order = ("rpm", "rad/s", "1/s", "Hz")
        return _choose(facts, unit, [(ChannelEntry(column=column, unit=name), *ENGINE_RPM) for name in order])
    names = ["rpm", "rad/s", "krpm"] if facts.high > TURBO_RPM / 2.0 else ["rad/s", "rpm", "krpm"]
    names = list(_or_own(names, unit))
    found = _choose(facts, unit, [(ChannelEntry(column=column, unit=name), 300.0, TURBO_RPM) for name in names])
    if found is None or unit is None or unit.ours != "1/s" or found.entry.unit != "1/s":
        return found
    radians = ChannelEntry(column=column, unit="rad/s")
    text = "the file says 1/s: taken as {}, check"
    return replace(found.with_warning(text.format("revolutions a second")), alternatives=(
        Reading(radians, 0.9, (), (text.format("rad/s"),)),))  # fmt: skip


def _share(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    via = "egr_rate" if meaning.name == "EGR rate" else None
    factor = 0.85 if via else 1.0  # a measured flow is better than one from a rate
    if facts.high <= FRACTION_HIGH and not (facts.frozen and facts.high == 0.0):
        name = "fraction"
        if unit is not None and unit.ours == "%":
            return Reading(ChannelEntry(column=meaning.column, unit=name, via=via), 0.7 * factor, (), (
                f"the file says %, but no value is above {facts.high:.3g}: taken as a fraction",))
        reasons: tuple[str, ...] = ("0 to 1: a fraction",)
        warnings: tuple[str, ...] = ()
    else:
        in_pct = 0.1 if unit is not None and unit.ours == "permille" else 1.0
        if not (SHARE_RANGE[0] <= in_pct * facts.low and in_pct * facts.high <= SHARE_RANGE[1]):
            return None
        name = "permille" if unit is not None and unit.ours == "permille" else "%"
        reasons = _told(unit, name) if unit is not None else ()
        warnings = () if unit is not None else (f"{_NO_UNIT}; {facts.low:.4g} to {facts.high:.4g} looks like %",)
    entry = ChannelEntry(column=meaning.column, unit=name, via=via)
    if via is None and _SAYS_SHUT.search(words):
        entry = entry.model_copy(update={"scale": -1.0, "offset": 100.0})
        reasons = (*reasons, "the name says how far it is shut: 100 minus it")
    return Reading(entry, factor * (1.0 if unit else 0.9), reasons, warnings)


def _mass_flow(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    column = meaning.column
    if column == "u_delta_mg":
        names = _or_own(("kg/h", "g/s", "kg/s", "g/h", "lb/h", "kg/min"), unit)
        entries = [(ChannelEntry(column=column, unit=name, via="fuel_rate"), 2e-5, 0.06) for name in names]
        return _scaled(_choose(facts, unit, entries), 0.95)
    limits = (-1e-3, 0.5) if column == "w_egr_kg_s" else (5e-3, 2.0)
    names = _or_own(("kg/h", "g/s", "kg/s", "kg/min", "lb/min"), unit)
    if unit is None:
        names = ("kg/s",) if facts.high <= 2.0 else ("kg/h", "g/s")
    found = _choose(facts, unit, [(ChannelEntry(column=column, unit=name), *limits) for name in names])
    return found


def _scaled(reading: Reading | None, by: float) -> Reading | None:
    return None if reading is None else replace(reading, factor=by * reading.factor)


def _volume_flow(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    names = list(DERIVATIONS["fuel_volume_rate"].units) if unit is not None else ["L/h"]
    entries = [(ChannelEntry(column="u_delta_mg", unit=name, via="fuel_volume_rate"), 2e-5, 0.06) for name in names]
    found = _scaled(_choose(facts, unit, entries), 0.9)
    if found is None:
        return None
    return found.with_warning("the fuel's density is assumed, 0.835 kg/L (EN 590: 0.820 to 0.845)")


def _per_cycle(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    if meaning.name == "air per stroke":
        names = list(DERIVATIONS["air_per_stroke"].units)
        entries = [(ChannelEntry(column="w_c_kg_s", unit=name, via="air_per_stroke"), 8e-5, 8e-3) for name in names]
        return _scaled(_choose(facts, unit, entries), 0.9)
    if (unit is not None and unit.ours == "mm3/cycle") or (unit is None and re.search(r"\b(mm ?3|vol(ume)?)\b", words)):
        entry = ChannelEntry(column="u_delta_mg", unit="mm3/cycle", via="fuel_volume")
        found = _choose(facts, unit, [(entry, 0.5, 400.0)])
        text = "the fuel's density is assumed, 0.835 kg/L (EN 590: 0.820 to 0.845)"
        return None if found is None else replace(found, factor=0.9 * found.factor).with_warning(text)
    names = ["mg/cycle", "g/cycle", "kg/cycle"]
    return _choose(facts, unit, [(ChannelEntry(column="u_delta_mg", unit=name), 0.5, 400.0) for name in names])


def _torque(facts: Facts, meaning: Meaning, unit: Unit | None, words: str) -> Reading | None:
    entry = ChannelEntry(column=meaning.column, unit=unit.ours if unit is not None else "Nm")
    range_ = symbol(meaning.column)
    return _choose(facts, unit, [(entry, range_.low, range_.high)])
