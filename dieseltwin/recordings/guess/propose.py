"""A channel map for a file nobody has seen before: candidates by name, unit and range, then by physics."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dieseltwin.recordings.channels import unit_of
from dieseltwin.recordings.guess.evidence import Support
from dieseltwin.recordings.guess.facts import Clock, Facts, clock_of, facts_of, signals_of
from dieseltwin.recordings.guess.machines import DIESEL, PETROL, Machine
from dieseltwin.recordings.guess.names import Meaning, Vocabulary, spn_of, vocabulary, words_of
from dieseltwin.recordings.guess.physics import (
    Meeting,
    agreements,
    misfit,
    petrol_agreements,
    reversed_positions,
    unchecked_positions,
)
from dieseltwin.recordings.guess.reading import Reading, reading_of
from dieseltwin.recordings.guess.unnamed import FINER, Option, assigned
from dieseltwin.recordings.importers.j1939 import ENGINE_ADDRESSES, ENGINE_SPEED
from dieseltwin.recordings.importers.layout import without_unit
from dieseltwin.recordings.importers.signals import RawChannels, Signal
from dieseltwin.recordings.stated_units import PER_SECOND
from dieseltwin.recordings.unit_spellings import Unit, understood
from dieseltwin.settings.names import listed
from dieseltwin.symbols import BY_COLUMN

LEAST_SCORE = 0.4  # of name times unit times range, for a guess
CLOSE = 0.12  # a second channel as near as that is named in a warning
UNLIKELIER = 0.05  # of misfit, for each unit that stands before in the order of likelihood
MOST_CHOICES = 512  # combinations of units that physics looks at
DEFAULT_CYLINDERS = 6
FROZEN, MOSTLY_MISSING = 0.6, 0.7  # factors on the score of a channel that never moves, or is hardly there
NAMELESS = "told by its unit and by what it does, not by its name: check"
BY_ORIGIN = 0.8  # factor of a guess that rests on the group or message that a channel stands in
_ADDRESS = re.compile(r"from address (\d+)")
OTHER_READING = 0.2  # of support, for a unit that isn't the likeliest, or gauge where nothing says so
OTHER_UNIT = 0.7  # factor of a reading in another unit than the file's: too bold without a name
SELDOM = ("EGR rate", "air per stroke", "fuel volume flow")  # less often recorded than what else gives the quantity
VOLUMES = ("volume flow", "gas volume flow")
MAY_STAND_STILL = ("p_amb_pa", "t_amb_k", "t_im_k", "t_ic_k", "u_egr_pct", "u_vgt_pct")


@dataclass(frozen=True)
class Candidate:
    """One channel as one quantity.

    Attributes:
        channel: the file's name.
        meaning: what it would be.
        reading: unit and formula, with reasons and warnings.
        score: name times unit and range, 0 to 1.
    """

    channel: str
    meaning: Meaning
    reading: Reading
    score: float

    @property
    def column(self) -> str:
        """Our column."""
        return self.meaning.column


@dataclass(frozen=True)
class Proposal:
    """What a file holds and what it could be.

    Attributes:
        raw: the file as read.
        facts: channel -> figures.
        guesses: our column -> the chosen candidate, warnings and reasons complete.
        others: channel -> what else it could be, channels that are not chosen included.
        clock: column of a table that is its time, and its unit.
        cylinders: number used for fuel and air per stroke, and whether somebody gave it.
        cylinders_given: False where the number is an assumption.
        database: DBC that the trace was read with.
        unconverted: our column that no channel gives -> the channel whose name says it, and a unit without conversion.
        machine: whose quantities were looked for.
        throttle: channel by whose name a file without an EGR valve, a VGT or fuel may be of a petrol engine.
    """

    raw: RawChannels
    facts: Mapping[str, Facts]
    guesses: Mapping[str, Candidate]
    others: Mapping[str, tuple[Candidate, ...]]
    clock: Clock | None
    cylinders: int
    cylinders_given: bool
    database: Path | None
    unconverted: Mapping[str, tuple[str, str]]
    machine: Machine
    throttle: str | None = None


def propose(
    raw: RawChannels, cylinders: int | None = None, database: Path | None = None, machine: Machine = DIESEL
) -> Proposal:
    """Guess which channel is which of our quantities.

    Args:
        raw: a file as its importer read it.
        cylinders: of the engine; None assumes six and says so.
        database: DBC that the trace was read with, for the map.
        machine: whose quantities are looked for.
    """
    signals = signals_of(raw)
    clock = clock_of(raw)
    facts = {name: facts_of(signal) for name, signal in signals.items()}
    count = DEFAULT_CYLINDERS if cylinders is None else cylinders
    candidates = [
        candidate for name, fact in facts.items() if clock is None or name != clock[0]
        for candidate in _candidates(fact, count, vocabulary(machine.section))
    ]  # fmt: skip
    candidates = _of_one_engine(candidates, facts)
    chosen = _assigned(candidates)
    throttle = None
    if machine is DIESEL:
        throttle = _throttle(chosen, facts, count)
        chosen = {**chosen, **_by_behaviour(chosen, signals, facts, count)}
        chosen = _by_physics(chosen, signals, facts, count)
    else:
        meeting = Meeting({c.channel: signals[c.channel] for c in chosen.values()}, facts, count)
        named = _named(chosen, {column: c.reading for column, c in chosen.items()})
        chosen = _told(chosen, *petrol_agreements(meeting.columns(named)))
    chosen = {column: _warned(candidate, facts[candidate.channel], candidates, cylinders is not None)
              for column, candidate in chosen.items()}  # fmt: skip
    taken = {candidate.channel: candidate for candidate in chosen.values()}
    others: dict[str, tuple[Candidate, ...]] = {}
    for candidate in sorted(candidates, key=lambda c: -c.score):
        used = taken.get(candidate.channel)
        if used is None or used.meaning is not candidate.meaning:
            others[candidate.channel] = (*others.get(candidate.channel, ()), candidate)
    free = [fact for name, fact in facts.items() if name not in taken]
    return Proposal(raw, facts, chosen, others, clock, count, cylinders is not None, database,
                    _unconverted(free, chosen, vocabulary(machine.section)), machine, throttle)  # fmt: skip


def _throttle(chosen: Mapping[str, Candidate], facts: Mapping[str, Facts], cylinders: int) -> str | None:
    """A channel that is named as a throttle, where no name is one that only a diesel engine's channels have."""
    if {"u_egr_pct", "u_vgt_pct", "u_delta_mg"} & set(chosen):
        return None
    petrol = vocabulary(PETROL.section)
    found = [name for name, fact in facts.items() for candidate in _candidates(fact, cylinders, petrol)
             if candidate.column == "alpha_th_pct"]  # fmt: skip
    return found[0] if found else None


def _unconverted(
    free: Sequence[Facts], chosen: Mapping[str, Candidate], names: Vocabulary
) -> dict[str, tuple[str, str]]:
    """Columns that a channel's name says, in a flow of volume that can't be converted to one of mass."""
    found: dict[str, tuple[str, str]] = {}
    for fact in free:
        unit, words = understood(fact.unit), words_of(fact.name)
        if unit is None or unit.dimension not in VOLUMES:
            continue
        for meaning in names.meanings:
            flows = "mass flow" in meaning.dimensions and meaning.column not in chosen
            if flows and meaning.score(fact.name, words, spn_of(fact.name, fact.spn)) >= LEAST_SCORE:
                found.setdefault(meaning.column, (fact.name, fact.unit or ""))
    return found


def _of_one_engine(candidates: list[Candidate], facts: Mapping[str, Facts]) -> list[Candidate]:
    """Without what another engine on the bus sends: one that sends a speed of its own is no helper of the first."""
    addresses = {name: found.group(1) for name, fact in facts.items() if (found := _ADDRESS.search(fact.origin))}
    turning = [addresses[name] for name, fact in facts.items() if name in addresses and fact.spn == ENGINE_SPEED]
    engines = [address for address in turning if int(address) in ENGINE_ADDRESSES]
    return [candidate for candidate in candidates if addresses.get(candidate.channel) not in engines[1:]]


def _candidates(fact: Facts, cylinders: int, names: Vocabulary) -> list[Candidate]:
    if fact.readings < 2:
        return []
    spn = spn_of(fact.name, fact.spn)
    found = _said(fact, words_of(fact.name), spn, cylinders, names)
    if found or spn is not None or not fact.origin:
        return found
    text = f"told by {fact.origin!r}, where it stands in the file: check"
    return [replace(each, reading=each.reading.with_warning(text), score=BY_ORIGIN * each.score)
            for each in _said(fact, words_of(f"{fact.origin} {fact.name}"), None, cylinders, names)
            if BY_ORIGIN * each.score >= LEAST_SCORE]  # fmt: skip


def _said(fact: Facts, words: str, spn: int | None, cylinders: int, names: Vocabulary) -> list[Candidate]:
    """What a channel's words or its number of J1939 say that it is."""
    unit = understood(fact.unit)
    found = []
    for meaning in names.meanings:
        if fact.name in BY_COLUMN and fact.name != meaning.column:
            continue  # another quantity of our own nomenclature
        score = meaning.score(fact.name, words, spn)
        if score <= 0.0:
            continue
        stated = _own_unit(fact, meaning, unit) or unit
        if stated is None and spn is None and not set(meaning.dimensions) & names.kinds_of(words):
            continue
        reading = reading_of(fact, meaning, stated, words, cylinders)
        if reading is None:
            continue
        score *= reading.factor
        if fact.frozen and meaning.column not in MAY_STAND_STILL:
            score *= FROZEN
        if fact.missing > 0.5 and fact.step_s is None:
            score *= MOSTLY_MISSING
        if score >= LEAST_SCORE:
            said = f"SPN {spn} is {meaning.name}" if spn is not None else f"the name says {meaning.name}"
            found.append(Candidate(fact.name, meaning, replace(reading, reasons=(said, *reading.reasons)), score))
    return found


def _own_unit(fact: Facts, meaning: Meaning, stated: Unit | None) -> Unit | None:
    """The unit that our own column names carry, unless the file states another one of the same kind."""
    if fact.name.lower() != meaning.column:
        return None
    contradicted = stated is not None and stated.dimension in meaning.dimensions and stated.ours != PER_SECOND
    return None if contradicted else understood(unit_of(meaning.column))


def _assigned(candidates: Sequence[Candidate]) -> dict[str, Candidate]:
    """The best candidate for every column, each channel once; the order of the file decides between equals."""
    chosen: dict[str, Candidate] = {}
    used: set[str] = set()
    for candidate in sorted(candidates, key=lambda c: -c.score):
        if candidate.column not in chosen and candidate.channel not in used:
            chosen[candidate.column] = candidate
            used.add(candidate.channel)
    return chosen


def _by_behaviour(chosen: Mapping[str, Candidate], signals: Mapping[str, Signal], facts: Mapping[str, Facts],
                  cylinders: int) -> dict[str, Candidate]:
    """Quantities that no name gave, by what the channels do: units, ranges and balances."""
    used = {candidate.channel for candidate in chosen.values()}
    said = {name for name in facts if spn_of(name, facts[name].spn) is not None or name in BY_COLUMN}
    pool = [fact for name, fact in facts.items() if name not in used | said and fact.readings > 1
            and not _is_clock(signals[name])]  # fmt: skip
    options = [option for fact in pool for option in _options(fact, chosen, cylinders)]
    if not options:
        return {}
    wanted = {name: signals[name] for name in (*used, *(option.channel for option in options))}
    settled = {column: (candidate.channel, candidate.reading) for column, candidate in chosen.items()}
    found = assigned(options, settled, Meeting(wanted, facts, cylinders), cylinders)
    return {column: _unnamed(option, evidence) for column, (option, evidence) in found.items()}


def _is_clock(signal: Signal) -> bool:
    values = signal.values[np.isfinite(signal.values)]
    return values.size > 1 and bool(np.all(np.diff(values) > 0.0))


def _options(fact: Facts, chosen: Mapping[str, Candidate], cylinders: int) -> Iterator[Option]:
    """What a channel could be by its unit, where its name doesn't rule it out."""
    words, unit = words_of(fact.name), understood(fact.unit)
    if unit is not None and unit.dimension == "number":
        unit = None
    told = unit is not None and unit.dimension != "unknown"
    fine = FINER * np.log10(max(fact.levels, 1))
    for meaning in vocabulary().meanings:
        if meaning.column in chosen or meaning.ruled_out(words):
            continue
        if not told and not set(meaning.dimensions) & vocabulary().kinds_of(words):
            continue
        reading = reading_of(fact, meaning, unit, words, cylinders)
        if reading is None or (told and reading.factor <= OTHER_UNIT):
            continue
        prior = fine - (meaning.name in SELDOM) * UNLIKELIER
        for each in (reading, *reading.alternatives):
            yield Option(meaning.column, fact.name, meaning, each, prior - (each is not reading) * OTHER_READING)


def _unnamed(option: Option, evidence: Sequence[Support]) -> Candidate:
    texts = [support.text for support in sorted(evidence, key=lambda s: -s.value) if support.value > 0.0]
    reading = replace(option.reading, reasons=(*option.reading.reasons, *texts[:3])).with_warning(
        NAMELESS)
    return Candidate(option.channel, option.meaning, reading, LEAST_SCORE)


def _by_physics(chosen: Mapping[str, Candidate], signals: Mapping[str, Signal], facts: Mapping[str, Facts],
                cylinders: int) -> dict[str, Candidate]:
    """Units that several columns allow are chosen together, so that balances hold; then what agrees is said."""
    wanted = {candidate.channel: signals[candidate.channel] for candidate in chosen.values()}
    meeting = Meeting(wanted, facts, cylinders)
    options = {column: (candidate.reading, *candidate.reading.alternatives) for column, candidate in chosen.items()}
    open_columns = [column for column, readings in options.items() if len(readings) > 1]
    best = {column: readings[0] for column, readings in options.items()}
    if open_columns:
        products = itertools.islice(itertools.product(*(options[column] for column in open_columns)), MOST_CHOICES)
        trials = [{**best, **dict(zip(open_columns, product, strict=True))} for product in products]
        misfits = [
            misfit(meeting.columns(_named(chosen, trial)), cylinders)
            + UNLIKELIER * sum(options[column].index(trial[column]) for column in open_columns)
            + UNLIKELIER * 2 * _flows_differ(trial)
            for trial in trials
        ]
        best = trials[misfits.index(min(misfits))]
    result = {}
    for column, candidate in chosen.items():
        reading = best[column]
        if reading is not candidate.reading:
            reading = replace(reading, reasons=(candidate.reading.reasons[0], "the balances fit best with this unit"))
        result[column] = replace(candidate, reading=reading)
    columns = meeting.columns(_named(result, {column: c.reading for column, c in result.items()}))
    for column, text in unchecked_positions(columns).items():
        candidate = result[column]
        result[column] = replace(candidate, reading=candidate.reading.with_warning(text))
    for column, text in reversed_positions(columns).items():
        candidate = result[column]
        entry = candidate.reading.entry
        mirrored = entry.model_copy(update={"scale": -entry.scale, "offset": 100.0 - entry.offset})
        warning = f"{text}; turned round (100 minus it): check with the actuator's data sheet"
        result[column] = replace(candidate, reading=replace(candidate.reading, entry=mirrored).with_warning(warning))
    return _told(result, *agreements(columns, cylinders))


def _told(chosen: Mapping[str, Candidate], reasons: Mapping[str, Sequence[str]], warnings: Mapping[str, Sequence[str]]
          ) -> dict[str, Candidate]:
    """With what speaks for the candidates of some columns, and what is to be checked."""
    return {
        column: replace(candidate, reading=replace(
            candidate.reading, reasons=_each_once((*candidate.reading.reasons, *reasons.get(column, ()))),
            warnings=(*candidate.reading.warnings, *warnings.get(column, ()))))
        for column, candidate in chosen.items()
    }  # fmt: skip


def _each_once(reasons: Sequence[str]) -> tuple[str, ...]:
    """Reasons that differ in more than their numbers."""
    return tuple({re.split(r"\d", reason)[0]: reason for reason in reasons}.values())


def _flows_differ(readings: Mapping[str, Reading]) -> bool:
    """Whether air and EGR flow would be in different units: no logger does that."""
    units = {readings[name].entry.unit for name in ("w_c_kg_s", "w_egr_kg_s")
             if name in readings and readings[name].entry.via is None}  # fmt: skip
    return len(units) > 1


def _named(chosen: Mapping[str, Candidate], readings: Mapping[str, Reading]) -> dict[str, tuple[str, Reading]]:
    return {column: (chosen[column].channel, reading) for column, reading in readings.items()}


def _told_otherwise(reading: Reading) -> bool:
    """Whether the guess doesn't rest on the channel's own name."""
    return any(warning.startswith("told by") for warning in reading.warnings)


def _warned(candidate: Candidate, fact: Facts, candidates: Sequence[Candidate], cylinders_given: bool) -> Candidate:
    """Add what the candidate's own figures and its rivals give cause to check."""
    reading = candidate.reading
    rivals = [c for c in candidates if c.column == candidate.column and c.channel != candidate.channel
              and c.meaning is candidate.meaning and c.score > candidate.score - CLOSE]  # fmt: skip
    if rivals and fact.spn is None:  # J1939's numbers have an order of their own
        reading = reading.with_warning(f"{' and '.join(repr(c.channel) for c in rivals[:3])} could be it as well")
    doubts = [c for c in candidates if c.channel == candidate.channel and c.column != candidate.column
              and c.score > candidate.score - CLOSE]  # fmt: skip
    if doubts:
        reading = reading.with_warning(f"the name could also mean {doubts[0].meaning.name}")
    unread = candidate.meaning.unread(words_of(without_unit(fact.name)))
    if candidate.meaning.wanted(words_of(fact.name)):
        reading = reading.with_warning("a wanted value, as no channel says what was given: check that it follows")
    elif unread and not (_told_otherwise(reading) or spn_of(fact.name, fact.spn)
                         or fact.name.lower() == candidate.column):  # fmt: skip
        reading = reading.with_warning(f"nothing is known of {listed(unread)} in the name: check")
    if candidate.score < 0.7 and not reading.warnings:
        reading = reading.with_warning("the name says little: check")
    if fact.frozen and candidate.column not in MAY_STAND_STILL:
        reading = reading.with_warning(f"frozen at {fact.low:.6g}")
    entry = reading.entry
    if entry.derivation is not None and entry.derivation.cylinders and not cylinders_given:
        reading = reading.with_warning(f"{entry.cylinders} cylinders are assumed: give --cylinders")
    return replace(candidate, reading=reading)
