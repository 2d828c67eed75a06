"""Channels whose names say nothing: each is tried as each quantity that its unit allows, the best agreement is taken.

The channels that names have settled stay; for the quantities that are left the sum of all supports (`evidence`) is
raised one assignment at a time, until none raises it further. A guess must raise the sum clearly, and its user is
always told to check it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dieseltwin.recordings.guess.evidence import Support, supports
from dieseltwin.recordings.guess.names import Meaning
from dieseltwin.recordings.guess.physics import Meeting
from dieseltwin.recordings.guess.reading import Reading

LEAST_GAIN = 0.3  # of support, for a guess
EVERY = 8  # of the points on which the channels meet: enough for a correlation
FINER = 0.02  # of support, for ten times as many different values: what was wanted is coarser than what was read
MOST_SWEEPS = 8
ORDER = ("n_e_rpm", "omega_t_rad_s", "w_c_kg_s", "u_delta_mg", "p_im_pa", "p_em_pa", "p_amb_pa", "w_egr_kg_s",
         "t_em_k", "u_egr_pct", "u_vgt_pct", "t_im_k", "t_amb_k", "torque_nm")  # fmt: skip
"""In which quantities are looked for first: those that stand by themselves before those that need others."""


@dataclass(frozen=True)
class Option:
    """One channel as one quantity in one unit.

    Attributes:
        column: ours.
        channel: the file's name.
        meaning: what it would be.
        reading: unit and formula.
        prior: support that comes from elsewhere: what little the name says, how fine the values are.
    """

    column: str
    channel: str
    meaning: Meaning
    reading: Reading
    prior: float


def assigned(options: Sequence[Option], settled: Mapping[str, tuple[str, Reading]], meeting: Meeting, cylinders: int
             ) -> dict[str, tuple[Option, tuple[Support, ...]]]:
    """The options that agree best with each other and with what is settled, with what supports them.

    Args:
        options: channels and quantities that may be put together.
        settled: our column -> (channel, reading) that is known.
        meeting: all these channels at the same times.
        cylinders: of the engine.
    """
    by_column = {column: [option for option in options if option.column == column] for column in ORDER}
    state: dict[str, Option] = {}

    def judged(trial: Mapping[str, Option]) -> tuple[float, list[Support]]:
        named = {**settled, **{column: (option.channel, option.reading) for column, option in trial.items()}}
        met = meeting.columns(named, nominal=False)
        columns = {name: np.nan_to_num(values[::EVERY]) for name, values in met.items()}
        found = list(supports(columns, cylinders))
        missed = sum(column not in columns for column in trial)  # a formula that lacks what it needs
        return sum(s.value for s in found) + sum(o.prior for o in trial.values()) - missed, found

    def instead(option: Option) -> dict[str, Option]:
        """The state with the option in it; a quantity that loses its channel to it takes what becomes free."""
        trial = {name: held for name, held in state.items() if held.channel != option.channel} | {option.column: option}
        loser = next((name for name, held in state.items() if held.channel == option.channel), None)
        if loser is not None and loser != option.column and option.column in state:
            free = state[option.column].channel
            trial |= {held.column: held for held in by_column[loser] if held.channel == free}
        return trial

    best = judged(state)[0]
    for _ in range(MOST_SWEEPS):
        before = best
        for column in ORDER:
            for option in by_column[column]:
                if state.get(column) is option:
                    continue
                trial = instead(option)
                total = judged(trial)[0]
                if total > best + 1e-9:
                    best, state = total, trial
            if column in state:
                fewer = {name: held for name, held in state.items() if name != column}
                total = judged(fewer)[0]
                if total > best:
                    best, state = total, fewer
        if best <= before:
            break
    for column in reversed(ORDER):
        if column in state:
            fewer = {name: held for name, held in state.items() if name != column}
            total = judged(fewer)[0]
            if best - total < LEAST_GAIN:
                best, state = total, fewer
    found = judged(state)[1]
    return {column: (option, tuple(s for s in found if column in s.columns)) for column, option in state.items()}
