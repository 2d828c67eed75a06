"""Words for discovery: sites, effects, magnitudes as an engineer says them, and the sentence that heads the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dieseltwin.discovery.verdict.document import (
    LEFT_OVER,
    Discrepancy,
    FoundEffect,
    FoundRegion,
)
from dieseltwin.discovery.verdict.health_value import HealthValue
from dieseltwin.discovery.verdict.when import CONDITIONS, clock, only_in_words, when_words
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.notes import listing
from dieseltwin.report import quantities
from dieseltwin.report.circumstance_words import nearly_health_words, recorded_words, shown_day

SENSOR = "sensor:"

SITE_WORDS: Mapping[str, str] = {
    "intake_mass_balance": "the intake mass balance",
    "exhaust_mass_balance": "the exhaust mass balance",
    "cylinder_flow": "the flow into the cylinders",
    "compressor_flow": "the compressor flow",
    "compressor_power": "the compressor power",
    "turbine_flow": "the turbine flow",
    "turbine_power": "the turbine power",
    "shaft_power": "the power balance of the turbo shaft",
    "cylinder_out_temperature": "the cylinder-out temperature",
    "exhaust_temperature": "the exhaust manifold temperature",
    "intake_temperature": "the intake manifold temperature",
    "egr_flow": "the EGR flow",
    "egr_actuator": "the EGR actuator",
    "vgt_actuator": "the VGT actuator",
    "fuel_injection": "the fuel injection",
}

# SI unit -> (unit on paper, factor)
_UNITS: Mapping[str, tuple[str, float]] = {
    "m2": ("mm²", 1e6),
    "Pa": ("kPa", 1e-3),
    "-": ("%", 100.0),
    "%": ("%", 1.0),
    "1/s": ("%/h", 3.6e5),
    "N m s": ("µN m s", 1e6),
    "Pa/(kg/s)^2": ("kPa/(kg/s)²", 1e-3),
    "Pa/(kg/s)2": ("kPa/(kg/s)²", 1e-3),
    "W": ("kW", 1e-3),
    "s": ("s", 1.0),
    "kg/s": ("kg/s", 1.0),
}


# shares of a full input range above which a region is no restriction worth a word
_REGION_RANGES: Mapping[str, float] = {"n_e_rpm": 1500.0, "u_delta_mg": 249.0, "u_egr_pct": 100.0, "u_vgt_pct": 80.0}
_NARROW = 0.35
_SHARE = 0.5  # of the evidence from which a region is worth a word
_TELLING = 3.0  # log-likelihood that the held-out part must gain to tell anything: odds of twenty
_LEAST_SHIFT = 0.01  # relative shift of a health parameter that is worth a word
_LIKELY = 0.1  # probability from which another site is worth a word


def unit_of(name: str) -> str | None:
    """SI unit of an effect's magnitude; None for a name that the catalogue doesn't hold."""
    effect = EFFECTS.get(name)
    return None if effect is None else effect.unit


def site_of(name: str) -> str | None:
    """Site of an effect; None for a name that the catalogue doesn't hold."""
    effect = EFFECTS.get(name)
    return None if effect is None else effect.site


def is_sensor(site: str) -> bool:
    """Whether the site is a reading: a sensor fault, no missing physics."""
    return site.startswith(SENSOR)


def site_words(site: str) -> str:
    """The site in words, to follow "in"; a site that has none as it is, without underscores."""
    if is_sensor(site):
        return f"the reading {site.removeprefix(SENSOR)}"
    return SITE_WORDS.get(site, "the " + site.replace("_", " "))


def display_unit(name: str, unit: str | None) -> tuple[str, float]:
    """Shown unit of an effect's magnitude and the factor from `unit` to it."""
    entry = EFFECTS.get(name)
    if unit is None or (entry is not None and entry.plain):
        return "", 1.0
    return _UNITS.get(unit, (unit, 1.0))


def magnitude_words(
    name: str, magnitude: float, std: float | None, unit: str | None, *, extra: bool = True, digits: int = 3,
    shown: tuple[str, float] | None = None,
) -> str:  # fmt: skip
    """A magnitude [unit] as text, `41.0 ± 2.0 mm²`, with two digits of the standard deviation.

    Args:
        name: of the effect.
        digits: of the magnitude where there is no standard deviation.
        extra: also give a quadratic restriction as the pressure at its flow.
        shown: unit on paper and factor to it; None: the usual.
    """
    words, factor = shown or display_unit(name, unit)
    value, spread = magnitude * factor, math.nan if std is None else std * factor
    if math.isfinite(spread) and spread > 0.0:
        places = quantities.decimals_for(spread)
        text = f"{value:.{places}f} ± {spread:.{places}f}"
    else:
        text = quantities.significant(value, digits)
    text = text.replace("-", "−") if value < 0 and "e" not in text else text
    text = f"{text} {words}".rstrip()
    entry = EFFECTS.get(name)
    if extra and entry is not None and entry.at_flow is not None:
        pressure = 1e-3 * magnitude * entry.at_flow**2
        text += f" ({quantities.significant(pressure, 2)} kPa at {entry.at_flow:g} kg/s)"
    return text


def effect_words(effect: FoundEffect) -> str:
    """A named effect with its magnitude, to follow "there is"."""
    magnitude = math.nan if effect.magnitude is None else effect.magnitude
    size = magnitude_words(effect.name, magnitude, effect.std, effect.unit)
    entry = EFFECTS.get(effect.name)
    if entry is None:
        return f"{effect.name.replace('_', ' ')} of {size}"
    return entry.phrase.format(m=size)


def least_words(name: str, smallest: float) -> str | None:
    """An effect of a smallest magnitude ("a boost leak of 3.1 mm²"); None for an unknown name."""
    unit = unit_of(name)
    entry = EFFECTS.get(name)
    if unit is None or entry is None:
        return None
    return entry.phrase.format(m=magnitude_words(name, smallest, None, unit, digits=2))


def _sure(probability: float) -> str:
    percent = 100.0 * probability
    return "more than 99 % sure" if percent > 99.0 else f"{percent:.0f} % sure"


def region_words(region: FoundRegion) -> str:
    """The columns that the region really restricts ("n_e 1200 to 1500 rpm"); empty where it restricts none."""
    parts = []
    for column, span in _REGION_RANGES.items():
        low, high = getattr(region, column)
        symbol, unit = CONDITIONS[column]
        if high - low < _NARROW * span:
            parts.append(f"{symbol} {low:.0f} to {high:.0f} {unit}")
    return ", ".join(parts)


def shifts(health: Mapping[str, HealthValue]) -> list[tuple[str, float]]:
    """(name, relative error of the health-only fit against the repaired one), largest first, noise left out."""
    found = []
    for name, entry in health.items():
        if entry.value == 0.0:
            continue
        shift = entry.before / entry.value - 1.0
        noise = 0.0 if entry.std is None else abs(entry.std / entry.value)
        if abs(shift) >= _LEAST_SHIFT and abs(shift) > noise:
            found.append((name, shift))
    return sorted(found, key=lambda pair: -abs(pair[1]))


def _health_words(document: Discrepancy) -> str:
    moved = shifts(document.health)
    lost = [name for name, entry in document.health.items() if (entry.std or 0.0) > abs(entry.value)]
    untold = f"{listing(lost)} can no longer be told beside it" if lost else ""
    if not moved:
        return untold or "the health parameters stay where the fit without it had them, within their uncertainty or 1 %"
    parts = [f"{name} {100 * abs(shift):.2g} % too {'high' if shift > 0 else 'low'}" for name, shift in moved]
    return f"the fit of the health parameters alone had put {listing(parts)}" + (f", and {untold}" if untold else "")


def _number(value: float, step: float) -> str:
    digits = 2 if step == 0.0 else min(max(2, 1 - math.floor(math.log10(abs(step)))), 6)
    return f"{value:.{digits}f}".replace("-", "−")


def _held_out_words(document: Discrepancy) -> str:
    before, after = document.fit.held_out_nll_before, document.fit.held_out_nll_after
    if before is None or after is None:
        return "there was nothing to hold out, so no gain on unseen driving is claimed"
    step, gain = before - after, document.fit.held_out_gain
    if gain is not None and 0.0 < gain < _TELLING:
        return (f"the held-out part hardly decides: its log-likelihood rises by {gain:.2g}, which chance does as well "
                f"({_TELLING:g} and more tell)")  # fmt: skip
    first, second = _number(before, step), _number(after, step)
    if step > 0:
        return f"on the held-out part the negative log-likelihood falls from {first} to {second} per sample"
    return f"on the held-out part the negative log-likelihood does not fall ({first} before, {second} after)"


def _when_words(document: Discrepancy) -> str:
    location = document.location
    if location is None:
        return ""
    text = _over_recordings(document) if document.recordings else when_words(location)
    if location.only_in:
        return f"{text}, {only_in_words(location)}" if document.recordings else text
    confined = [r for r in location.regions if r.share_of_evidence >= _SHARE and region_words(r)]
    if confined:
        region = max(confined, key=lambda r: r.share_of_evidence)
        text += f", with {100 * region.share_of_evidence:.0f} % of the evidence at {region_words(region)}"
    return text


def _over_recordings(document: Discrepancy) -> str:
    """How what is missing differs between several recordings."""
    days = [shown_day(item.date) for item in document.recordings]
    text, words = f"over {len(days)} recordings ({days[0]} to {days[-1]})", over_recordings_words(document)
    if not words:
        return text
    return f"{text} {words}" if words.startswith("since") else f"{text}, where it {words}"


def over_recordings_words(document: Discrepancy) -> str:
    """Since when, or how its size differs, on several recordings; empty where nothing is told."""
    location = document.location
    if location is not None and location.onset_s is not None:
        return f"since {clock(location.onset_s)} into that of {location.onset_date}"
    return next((e.over_recordings for e in document.effects if e.over_recordings), "")


def _apart_words(document: Discrepancy) -> str:
    parts = []
    for effect in document.effects:
        if effect.equivalent_names:
            subject = f"{effect.name} cannot be told apart from {listing(effect.equivalent_names, 'or')}"
            split = f", which {effect.split_by} would settle" if effect.split_by else ""
            parts.append(subject + split)
    location = document.location
    other = [a for a in location.alternatives if a.probability >= _LIKELY] if location is not None else []
    if other:
        where = [f"{site_words(a.site)} ({100 * a.probability:.0f} %)" for a in other]
        parts.append(f"it could also sit in {listing(where, 'or')}")
    if not parts:
        unnamed = any(not effect.named for effect in document.effects)
        if _may_sit_elsewhere(document):
            parts.append("no law at another site explains as much")
        else:
            judged = "recordings" if document.recordings else "recording"
            parts.append("no other site comes into question" if unnamed
                         else f"no other effect of the catalogue explains the {judged} as well")
    return " and ".join(parts)


def _may_sit_elsewhere(document: Discrepancy) -> bool:
    """Whether a law is all that there is and leaves more than noise: laws were compared, and the right one wasn't among
    them, so that a probability of its site says little. (A leak that came and went twice was "the compressor power".)
    """
    return document.more_is_missing and any(not effect.named and effect.law for effect in document.effects)


def _names_sit_elsewhere(document: Discrepancy, site: str) -> bool:
    """Whether a name that can't be told from the one of a site enters at another: its probability settles nothing."""
    others = (name for e in document.effects if site_of(e.name) == site for name in e.equivalent_names)
    return any(site_of(name) not in (None, site) for name in others)


def _placed(effects: Sequence[FoundEffect], site: str, sure: str = "") -> str:
    """Named effects in one phrase; those of another site than the first's say theirs. `sure` follows the first."""
    text = f"{effect_words(effects[0])} {sure}".rstrip()
    for effect in effects[1:]:
        own = site_of(effect.name)
        place = " and" if own is None or own == site else f", and, in {site_words(own)},"
        text += f"{place} {effect_words(effect)}"
    return text


def _left_words(document: Discrepancy) -> list[str]:
    """How much of the misfit is explained, and a warning where more is left than noise and tolerances leave."""
    share, left = document.fit.share_explained, document.fit.chi2_per_sample_after
    parts = []
    if share is not None and share > 0.0:
        shown = "more than 99" if share > 0.99 else f"{100.0 * share:.0f}"
        parts.append(f"this explains {shown} % of the misfit beyond noise and tolerances")
    much = left is not None and left > LEFT_OVER
    if document.more_is_missing or (much and share is None):
        amount = f" ({left:.2f} of chi-square per sample where noise leaves 1)" if much else ""
        parts.append(f"but more is missing{amount}, so what is named may imitate something that is not in the catalogue"
                     if any(effect.named for effect in document.effects) else f"more is missing{amount}")  # fmt: skip
    elif much:
        whose = ("more than maps and sensors within their tolerances would leave, so sizes and names may be off"
                 if document.fit.beyond_tolerances else "which maps off within their tolerances explain")  # fmt: skip
        parts.append(f"{left:.2f} of chi-square per sample is left where noise leaves 1, {whose}")
    return parts


def _doubt_words(document: Discrepancy) -> list[str]:
    """That the engine file may be another engine's, or a column of the weather wrong, where the recording looks like
    it."""
    return [doubt.text for doubt in document.warnings if doubt.code in ("wrong_engine", "wrong_column")]


def _what_words(document: Discrepancy) -> str:
    """Where, what and how large."""
    location = document.location
    if location is None:
        return ""
    unsettled = _may_sit_elsewhere(document) or _names_sit_elsewhere(document, location.site)
    sure = "the likeliest place" if unsettled else _sure(location.probability)
    where = f"in {site_words(location.site)} ({sure})"
    named = [effect for effect in document.effects if effect.named]
    unnamed = [effect for effect in document.effects if not effect.named]
    off = is_sensor(location.site)
    if not unnamed and off:  # the effect says which reading it is
        alone = all(is_sensor(site_of(effect.name) or location.site) for effect in named)
        physics = ", physics is not what is missing" if alone else " and physics is missing"
        return f"A sensor is off{physics}: {_placed(named, location.site, f'({sure})')}"
    if not unnamed:
        return f"The twin leaves out, {where}, {_placed(named, location.site)}"
    law = unnamed[0].law
    found = f"the law found for it is {law}" if law else "no law for it could be resolved"
    beside = f", and beside it {_placed(named, location.site)}" if named else ""
    subject = f"A sensor is off, {where}," if off else f"The twin leaves out something, {where},"
    return f"{subject} {'in a way ' if off else ''}that no effect of the catalogue explains ({found}){beside}"


def _time_words(document: Discrepancy) -> list[str]:
    """That the search was ended by its time limit, where it was."""
    over = document.out_of_time
    return [f"the time for the search was over before it was through with {listing(over.unfinished)}"] if over else []


_BEYOND_CHANCE = 1e-4  # of all that was looked for at once; what is found, but below its tolerance, has such a p
_ODD = 0.02  # a smaller p-value is said in words: beside "nothing is missing" it would ask a question
_EXAMPLES = ("boost_leak", "back_pressure", "bearing_friction")


def _healthy(document: Discrepancy) -> str:
    p_value = f"p = {document.p_value:.2g}"
    small = document.too_small
    seen = () if small is None else (small.name, *small.equivalent_names)
    known = {name: least for name, least in document.surely_detectable.items() if name not in seen}
    shown = list(filter(None, (least_words(name, known[name]) for name in _EXAMPLES if name in known)))
    beyond = document.p_value < _BEYOND_CHANCE
    if document.out_of_time is not None and beyond:
        text = (f"Simulation and recording differ by more than chance ({p_value}), and nothing that was tried in the "
                "time given explains it")
    elif document.out_of_time is not None:
        text = f"Nothing was found in the time given ({p_value})"
    elif beyond:
        text = ("Nothing as large as a fault was found: simulation and recording differ by more than chance "
                f"({p_value}), but by less than what is believed of a healthy engine of this kind")
    elif document.p_value < _ODD:
        text = (f"No fault is shown beyond doubt, though one healthy recording in {1.0 / document.p_value:.0f} looks "
                f"as odd by chance ({p_value}): noise, the four health parameters and the tolerances of the maps may "
                "explain it")
    else:
        text = (f"Nothing is missing that {these(len(document.recordings))} could show ({p_value}): noise, the four "
                "health parameters and the tolerances of the maps explain it")
    if small is not None:
        others = f" (or {listing(small.equivalent_names, 'or')})" if small.equivalent_names else ""
        text += f"; what explains it best is {effect_words(small)}{others}, too small to be of interest"
    if document.fit.beyond_tolerances and not beyond:
        text += (f", though not all of it: {document.fit.chi2_per_sample_after:.2f} of chi-square per sample is left"
                 " where noise leaves 1, more than those tolerances take up")
    if shown:
        text += (f"; {listing(shown)} would have been found in 19 of 20 such recordings, smaller ones cannot be ruled "
                 "out")
    return "; ".join([text, *recorded_words(document), *_time_words(document), *_doubt_words(document)]) + "."


def these(recordings: int) -> str:
    """What was judged, to stand before "could show"."""
    return "these recordings" if recordings > 1 else "this recording"


def sentence(document: Discrepancy) -> str:
    """One sentence: where, what, how large, since when, what it did to the health parameters, how much the held-out fit
    improved, and what could not be told apart. Plain text; symbols by their names ("eta_sc")."""
    if not document.mismatch:
        return _healthy(document)
    return "; ".join(
        [
            f"{_what_words(document)}, {_when_words(document)}",
            _health_words(document),
            _held_out_words(document),
            _apart_words(document),
            *nearly_health_words(document),
            *_left_words(document),
            *recorded_words(document),
            *_time_words(document),
            *_doubt_words(document),
        ]
    ) + "."
