"""A proposal in words: a table of the channels, the guesses with their reasons, what is missing and what that costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import yaml

from dieseltwin.recordings.channels import TIME
from dieseltwin.recordings.derived import DIESEL_KG_L, STAND_IN_PA
from dieseltwin.recordings.guess.facts import Clock, Facts
from dieseltwin.recordings.guess.propose import Candidate, Proposal
from dieseltwin.recordings.time_units import SECONDS
from dieseltwin.symbols import BY_COLUMN

NAME_WIDTH = 44
_UNITS_OF_TIME = {size: unit for unit, size in SECONDS.items()}


def channel_lines(proposal: Proposal) -> Iterator[str]:
    """What is in the file: one line a channel."""
    raw = proposal.raw
    yield f"{raw.path}: {raw.kind}, {len(proposal.facts)} channels of numbers"
    for note in raw.notes:
        yield f"  {note}"
    if proposal.clock is not None:
        yield f"  time is {proposal.clock.name!r}, in units of {proposal.clock.unit_s:g} s"
        if proposal.clock.guessed_by is not None:
            yield f"  CHECK: {guessed_clock(proposal.clock, proposal.clock.guessed_by)}"
    elif raw.table is not None:
        yield "  no column of time: steady points, or name it in the channel map"
    yield ""
    yield f"{'channel':<{NAME_WIDTH}} {'unit':<9} {'rate':>8} {'low':>10} {'median':>10} {'high':>10}  remarks"
    for fact in proposal.facts.values():
        rate = "" if fact.step_s is None else f"{1.0 / fact.step_s:.4g} Hz" if fact.step_s > 0.0 else "?"
        yield (f"{fact.name[:NAME_WIDTH]:<{NAME_WIDTH}} {(fact.unit or '')[:9]:<9} {rate:>8} {fact.low:>10.5g} "
               f"{fact.median:>10.5g} {fact.high:>10.5g}  {', '.join(remarks(fact))}").rstrip()  # fmt: skip


def guessed_clock(clock: Clock, step: float) -> str:
    """What is to be checked about a clock whose unit nothing says."""
    return (f"{clock.name!r} has no unit and steps by {step:.6g}, taken as {_UNITS_OF_TIME[clock.unit_s]} for rows 1 "
            "to 100 times a second: correct its unit in the channel map if it is another")  # fmt: skip


def remarks(fact: Facts) -> list[str]:
    """What strikes about a channel."""
    found = []
    if fact.readings == 0:
        found.append("no reading at all")
    if fact.frozen:
        found.append("never changes")
    elif fact.resolution is not None:
        found.append(f"steps of {fact.resolution:.4g}")
    if fact.held_rows is not None:
        found.append(f"held over {fact.held_rows:.3g} rows")
    if fact.gaps:
        found.append(f"{fact.gaps} gaps, the longest {fact.longest_gap_s:.3g} s")
    if 0.0 < fact.missing < 1.0:
        found.append(f"{fact.missing:.0%} missing")
    return found


def guess_lines(proposal: Proposal) -> Iterator[str]:
    """What each of our quantities could be, why, and what to check; then what is missing and what it costs."""
    for column in proposal.machine.order:
        candidate = proposal.guesses.get(column)
        if candidate is None:
            continue
        yield f"{column:<14} {candidate.channel}{how(candidate)}"
        yield f"{'':<14}   because {'; '.join(candidate.reading.reasons)}"
        for warning in candidate.reading.warnings:
            yield f"{'':<14}   CHECK: {warning}"
    for column in missing(proposal):
        yield f"{column:<14} not found: {proposal.machine.costs[column]}"
        for name, others in proposal.others.items():
            rival = next((c for c in others if c.column == column), None)
            if rival is not None:
                yield f"{'':<14}   could be {name} ({rival.meaning.name}), which is taken for something else"
        if column in proposal.unconverted:
            yield f"{'':<14}   CHECK: {unconverted(*proposal.unconverted[column])}"
    if proposal.throttle is not None:
        yield ""
        yield (f"CHECK: {proposal.throttle!r} is a throttle, and no name is an EGR valve's, a VGT's or fuel's: "
               "for a petrol engine give --engine (liu_petrol, or a file of your own with kind: petrol)")


def how(candidate: Candidate) -> str:
    """' [kPa], gauge pressure plus ambient pressure': unit and formula of a guess."""
    entry = candidate.reading.entry
    unit = f" [{entry.unit}]" if entry.unit else ""
    turned = ", turned round" if entry.scale < 0.0 else ""
    return f"{unit}{turned}" if entry.derivation is None else f"{unit}, computed: {entry.derivation.words}"


def unconverted(channel: str, unit: str) -> str:
    """Why a channel gives nothing though its name does."""
    return (f"{channel} is in {unit}, which can't be converted without the density that it was counted with: give "
            "unit: kg/s, and the factor to kg/s as scale, in the channel map")  # fmt: skip


def missing(proposal: Proposal) -> list[str]:
    """Our columns that nobody gives, in the order of their weight."""
    machine = proposal.machine
    return [column for column in machine.order if column not in proposal.guesses and column in machine.costs]


def needed_but_unmapped(proposal: Proposal) -> dict[str, list[str]]:
    """Columns that formulas of the proposal need and nobody gives -> the columns that need them."""
    found: dict[str, list[str]] = {}
    for column, candidate in proposal.guesses.items():
        for need in candidate.reading.entry.needs:
            if need not in proposal.guesses:
                found.setdefault(need, []).append(column)
    return found


def map_text(proposal: Proposal) -> str:
    """The channel map as YAML with comments, ready to edit and to give to `--channels`."""
    raw = proposal.raw
    name = " ".join(raw.path.name.split())  # a comment ends with its line
    points = proposal.clock is None and raw.table is not None  # no time
    command = proposal.machine.commands[points]
    lines = [
        f"# Channel map of {name} ({raw.kind}), a first guess of `dieseltwin channels`.",
        f"# Check every line, then: dieseltwin {command} {name} --channels THIS_FILE ...",
        "# unit: of the channel; scale, offset: ours = scale * theirs + offset; via: a formula (docs/formats.md).",
    ]
    if proposal.database is not None:
        lines.append(f"dbc: {_scalar(str(proposal.database.resolve()))}")
    clock = proposal.clock
    if clock is not None and clock.name != TIME:
        lines.append(f"{_scalar(clock.name)}: {{column: {TIME}, unit: {_UNITS_OF_TIME[clock.unit_s]}}}")
        if clock.guessed_by is not None:
            lines.append(f"# CHECK: {guessed_clock(clock, clock.guessed_by)}")
    unmet = needed_but_unmapped(proposal)
    for column in proposal.machine.order:
        if column in proposal.guesses:
            lines.extend(_entry_lines(proposal.guesses[column], unmet))
    lines.extend(f"# {column} not found: {proposal.machine.costs[column]}" for column in missing(proposal))
    lines.extend(f"# CHECK: {column}: {unconverted(*channel)}" for column, channel in proposal.unconverted.items())
    taken = {candidate.channel for candidate in proposal.guesses.values()}
    if clock is not None:
        taken.add(clock.name)
    rest = [fact for name, fact in proposal.facts.items() if name not in taken]
    if rest:
        lines.append("# Not used:")
        lines.extend(f"#   {_scalar(fact.name)}  {fact.low:.4g} to {fact.high:.4g} {fact.unit or ''}".rstrip()
                     for fact in rest)  # fmt: skip
    return "\n".join(lines) + "\n"


def _entry_lines(candidate: Candidate, unmet: Mapping[str, list[str]]) -> Iterator[str]:
    entry = candidate.reading.entry
    ours = BY_COLUMN.get(candidate.column)
    meaning = candidate.meaning.name if ours is None else ours.meaning
    yield f"# {meaning}: {'; '.join(candidate.reading.reasons)}"
    for warning in candidate.reading.warnings:
        yield f"# CHECK: {warning}"
    parts = [f"column: {entry.column}"]
    if entry.unit is not None:
        parts.append(f"unit: {_scalar(entry.unit)}")
    if entry.scale != 1.0:
        parts.append(f"scale: {entry.scale:g}")
    if entry.offset != 0.0:
        parts.append(f"offset: {entry.offset:.10g}")
    if entry.via is not None:
        parts.append(f"via: {entry.via}")
        if entry.cylinders is not None:
            parts.append(f"cylinders: {entry.cylinders}")
        if entry.via.startswith("fuel_volume"):
            parts.append(f"density_kg_l: {DIESEL_KG_L}")
        if "p_amb_pa" in entry.needs and "p_amb_pa" in unmet:
            yield "# CHECK: no ambient pressure in the file; sea level is assumed"
            parts.append(f"ambient_pa: {STAND_IN_PA:.0f}")
    yield f"{_scalar(candidate.channel)}: {{{', '.join(parts)}}}"


def _scalar(text: str) -> str:
    """A YAML scalar on one line, quoted where it must be."""
    dumped = yaml.safe_dump(text, default_flow_style=True, allow_unicode=True, width=10_000)
    return dumped.removesuffix("\n...\n").strip()
