"""What somebody's file holds, which channel is which of our quantities, and the channel map that says so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from dieseltwin.api.results import Result, drawn
from dieseltwin.atomic import write_text
from dieseltwin.errors import InputError
from dieseltwin.recordings.channels import CONVERSIONS, TIME, channel_map, unit_of
from dieseltwin.recordings.derived import AMBIENT, DERIVATIONS, STAND_IN_PA
from dieseltwin.recordings.guess.facts import Facts, signals_of
from dieseltwin.recordings.guess.machines import DIESEL, PETROL, Machine
from dieseltwin.recordings.guess.propose import Proposal, propose
from dieseltwin.recordings.guess.words import channel_lines, guess_lines, guessed_clock, map_text, missing, remarks
from dieseltwin.recordings.importers.content import ENDINGS
from dieseltwin.recordings.importers.read import read_raw
from dieseltwin.report.over_time import overview
from dieseltwin.symbols import symbol

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dieseltwin.api.engines import AnyEngine

__all__ = ["AMBIENT", "ENDINGS", "STAND_IN_PA", "ChannelsFound", "Quantity", "channel_map", "channels", "quantities"]


@dataclass(frozen=True)
class Quantity:
    """One of our quantities, as a channel map can give it.

    Attributes:
        column: our name.
        name: the paper's symbol.
        meaning: a few words.
        unit: of our column.
        units: foreign units that are converted.
        formulas: name of a formula that gives it -> what it does, its units, the columns that it needs besides, and
            whether it needs the number of cylinders.
        cost: what can't be told without it.
    """

    column: str
    name: str
    meaning: str
    unit: str
    units: tuple[str, ...]
    formulas: Mapping[str, tuple[str, tuple[str, ...], tuple[str, ...], bool]]
    cost: str


def quantities() -> tuple[Quantity, ...]:
    """Our quantities of a diesel engine, time first, then in the order of their weight."""
    found = []
    for column in (TIME, *DIESEL.order):
        entry, unit = symbol(column), unit_of(column) or ""
        formulas = {name: (item.words, tuple(item.units), item.needs, item.cylinders)
                    for name, item in DERIVATIONS.items() if column in item.gives}  # fmt: skip
        found.append(Quantity(column, entry.name, entry.meaning, unit, tuple(CONVERSIONS.get(unit, ())), formulas,
                              DIESEL.costs.get(column, "")))  # fmt: skip
    return tuple(found)


@dataclass(frozen=True, repr=False)
class ChannelsFound(Result):
    """What a file holds and what it could be.

    Attributes:
        proposal: channels with their figures, and a guess for each of our quantities.
    """

    proposal: Proposal

    @property
    def sentence(self) -> str:
        proposal = self.proposal
        doubtful = sum(bool(candidate.reading.warnings) for candidate in proposal.guesses.values())
        text = (f"{proposal.raw.kind}, {len(proposal.facts)} channels of numbers: {len(proposal.guesses)} of our "
                f"{len(proposal.machine.order)} quantities found")  # fmt: skip
        return f"{text}, {doubtful} of them to check." if doubtful else f"{text}."

    def table(self) -> pd.DataFrame:
        """One row a channel: unit, rate [Hz], low, median, high, remarks, and the column that it is taken for."""
        taken = {candidate.channel: column for column, candidate in self.proposal.guesses.items()}
        if self.proposal.clock is not None:
            taken[self.proposal.clock.name] = TIME
        rows = [{"channel": fact.name, "unit": fact.unit, "rate_hz": _rate(fact), "low": fact.low,
                 "median": fact.median, "high": fact.high, "remarks": ", ".join(remarks(fact)),
                 "column": taken.get(fact.name)} for fact in self.proposal.facts.values()]  # fmt: skip
        return pd.DataFrame(rows).set_index("channel") if rows else pd.DataFrame()

    def plot(self, name: str | None = None) -> Figure:
        """`overview`: every channel that is taken for one of our quantities, in the file's unit, over time."""
        return drawn(self._taken(), {"overview": overview}, name)

    def _taken(self) -> list[tuple[str, str, np.ndarray | None, np.ndarray]]:
        signals = signals_of(self.proposal.raw)
        rows = [(column, signals[self.proposal.guesses[column].channel]) for column in self.proposal.machine.order
                if column in self.proposal.guesses]
        return [(column, s.name if (s.unit or "?") in s.name else f"{s.name} [{s.unit or '?'}]", s.time_s, s.values)
                for column, s in rows]

    def save(self, out: str | Path) -> Path:
        """Write the channel map (YAML with the reasons as comments), ready to edit."""
        return write_text(out, map_text(self.proposal))

    def lines(self) -> list[str]:
        return [*channel_lines(self.proposal), "", *guess_lines(self.proposal)]

    def to_json(self) -> dict[str, Any]:
        """The file, its channels, the guesses with reasons and warnings, and what is missing, as JSON types."""
        proposal = self.proposal
        table = self.table().reset_index()
        clock = proposal.clock
        guesses = {
            column: {"channel": guess.channel, "entry": guess.reading.entry.model_dump(exclude_defaults=True),
                     "reasons": list(guess.reading.reasons), "warnings": list(guess.reading.warnings)}
            for column, guess in proposal.guesses.items()
        }  # fmt: skip
        return {
            "sentence": self.sentence, "kind": proposal.raw.kind, "notes": list(proposal.raw.notes),
            "clock": None if clock is None else {
                "channel": clock.name, "seconds": clock.unit_s,
                "warnings": [] if clock.guessed_by is None else [guessed_clock(clock, clock.guessed_by)],
            },
            "table": proposal.raw.table is not None,
            "cylinders": proposal.cylinders, "cylinders_given": proposal.cylinders_given,
            "channels": [{str(key): None if pd.isna(value) else value for key, value in row.items()}
                         for row in table.to_dict("records")],
            "guesses": guesses, "missing": {column: proposal.machine.costs[column] for column in missing(proposal)},
        }  # fmt: skip


def channels(
    file: str | Path, dbc: str | Path | None = None, cylinders: int | None = None,
    engine: AnyEngine | None = None,
) -> ChannelsFound:
    """Say what is in a file and guess which channel is which of our quantities.

    Args:
        file: CSV of any dialect, Parquet, Excel, MATLAB, MDF, or a CAN trace.
        dbc: database of a CAN trace; without one the trace is read as J1939.
        cylinders: of the engine, for fuel and air per stroke; None assumes six.
        engine: whose quantities are looked for; None is a diesel engine.

    Raises:
        InputError: a file that can't be read, or a rig, whose file names its columns itself.
    """
    database = None if dbc is None else Path(dbc)
    machine = DIESEL if engine is None else _machine(engine)
    return ChannelsFound(propose(read_raw(file, database), cylinders, database, machine))


def _machine(source: AnyEngine) -> Machine:
    # the engines' simulators take as long to import as all the rest, and most files are looked into without one
    from dieseltwin.api.engines import engine
    from dieseltwin.petrol.parameters import PetrolParameters
    from dieseltwin.rigs.parameters import RigParameters

    made = engine(source)
    if isinstance(made, RigParameters):
        raise InputError("--engine", f"a rig, {made.name}", "an engine", "its file names the columns")
    return PETROL if isinstance(made, PetrolParameters) else DIESEL


def _rate(fact: Facts) -> float | None:
    return None if not fact.step_s else 1.0 / fact.step_s
