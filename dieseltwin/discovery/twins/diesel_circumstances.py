"""The diesel engine's twin with what its recording doesn't say: ambient, charge temperature, fuel, clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.diesel_lanes import moving
from dieseltwin.discovery.twins.interface import Array, Lanes, some_lanes
from dieseltwin.engine import EngineParameters
from dieseltwin.engine.actuation import actuate_lanes
from dieseltwin.engine.effects import EFFECTS
from dieseltwin.engine.inputs import INPUT_COLUMNS, Actuation
from dieseltwin.engine.terms import Term
from dieseltwin.learning.belief import Belief
from dieseltwin.learning.weather import EXPONENTS
from dieseltwin.recordings.between_rows import rows_are_slow, rows_may_be_slow
from dieseltwin.recordings.circumstances import (
    CORRECTED,
    DRIFT,
    ROUNDED,
    SCALE,
    TIME_SHIFT,
    Circumstance,
    applicable,
    put_right,
    with_charge,
)
from dieseltwin.recordings.columns import Columns
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.defaults import default_search
from dieseltwin.settings.search import CircumstanceSettings

_STEPS = {"p_amb_pa": 0.5, "t_amb_k": 0.005, "t_im_k": 0.005, SCALE: 1e-5, TIME_SHIFT: 0.05, CORRECTED: 1e-4,
          ROUNDED: 0.05}  # fmt: skip
"""Differences for the responses [unit], as small as those of health and maps: where p_em falls below p_im no gas comes
back through the EGR valve, and two rows at which the charge's difference reached that kink, and health's did not, had
three quarters of all that a recording said of the charge, wrongly. That of shifts is a good part of a row, as signals
have kinks at every row."""

_FOLLOWED = {"p_amb_pa": 100.0, "time_shift:n_e_rpm": 0.05}
"""Steps [unit] of what a reading may have been computed from; the clock of another sensor moves by whole rows."""

_EARLIER, _LATER = "time_shift:", "time_shift:later"
"""All inputs together: what a reading does when its own clock is moved the other way. Next to a kink the two differ."""

_CONSTANT = {
    "p_amb_pa": "p_amb", "t_amb_k": "T_amb", "t_im_k": "T_im", **{f"{CORRECTED}:{name}": name for name in EXPONENTS}
}  # fmt: skip
_ALIKE = {
    "scale:u_delta_mg": ("injector_drift",), "time_shift:u_egr_pct": ("egr_dead_time",),
    "time_shift:u_vgt_pct": ("vgt_dead_time",), "time_shift:u_delta_mg": ("fuel_lag",),
    "time_shift:t_em_k": ("thermocouple_lag",),
}  # fmt: skip
"""Effects of the catalogue that act nearly as a circumstance."""


def circumstances_of(
    recording: Recording, engine: EngineParameters, channels: Sequence[str], priors: CircumstanceSettings,
    opened: frozenset[str] = frozenset(),
) -> tuple[Circumstance, ...]:  # fmt: skip
    """What a recording doesn't say, or may say wrongly, and what is believed of it.

    Args:
        recording: with or without columns of the weather; engine, channels, priors: what else is believed.
        opened: names of those that were found to be off; a column of the weather that is among them is believed as
            little as none.
    """
    def read(name: str) -> bool:
        return name not in opened and name in recording.columns and bool(np.isfinite(recording.columns[name]).any())

    pressure, temperature, charge = read("p_amb_pa"), read("t_amb_k"), read("t_im_k")
    p_amb, t_amb = recording.p_amb_pa, recording.t_amb_k
    found = [
        Circumstance("p_amb_pa", p_amb, priors.p_amb_read_pa if pressure else priors.p_amb_pa, "Pa", 3000.0, True,
                     read=pressure),
        Circumstance("t_amb_k", t_amb, priors.t_amb_read_k if temperature else priors.t_amb_k, "K", 8.0, True,
                     read=temperature),
        Circumstance("t_im_k", engine.T_im, priors.t_im_read_k if charge else priors.t_im_k, "K", 8.0, True,
                     read=charge),
        Circumstance("scale:u_delta_mg", 1.0, priors.fuel_scale, "-", 0.02, True),
    ]
    if not pressure:
        found.insert(1, Circumstance("drift:p_amb_pa", 0.0, priors.drift_pa, "Pa", 2000.0, True))
    elif (change := float(np.nanmax(recording.columns["p_amb_pa"]) - np.nanmin(recording.columns["p_amb_pa"]))) > 0.0:
        found.insert(1, Circumstance("drift:p_amb_pa", 0.0, change, "Pa", np.inf, True))  # its course is the column's
    found += [
        Circumstance(f"time_shift:{column}", 0.0, priors.time_shift_s, "s", 0.02, False)
        for column in (*INPUT_COLUMNS, *channels)
    ]
    return tuple(replace(item, effects=_ALIKE.get(item.name, ())) for item in found)


def exponents_of(
    recording: Recording, engine: EngineParameters, priors: CircumstanceSettings
) -> tuple[Circumstance, ...]:
    """How far the maps of a learned engine's compressor go by corrected flow and speed, where a recording's weather
    isn't that which they are of.

    Args:
        recording: in the weather that it is judged in.
        engine: with its exponents; those that are said to be 0 or 1 stay, as in the published engine.
        priors: what else is believed; weather that no sensor tells from that of the maps is the same.
    """
    colder = abs(recording.t_amb_k - engine.T_cmap) > priors.t_amb_read_k
    thinner = abs(recording.p_amb_pa - engine.p_cmap) > priors.p_amb_read_pa
    matters = {"k_cflow": colder or thinner, "k_cspeed": colder}
    return tuple(
        Circumstance(f"{CORRECTED}:{name}", getattr(engine, name), getattr(priors, name), "-", np.inf, True)
        for name in EXPONENTS
        if matters[name] and getattr(engine, name) not in (0.0, 1.0)
    )


def _course(time_s: Array, pressure: Array | None) -> Array:
    """Course of a drift over the rows (n,), from its middle, 1 between its ends: a reading's own, else linear."""
    if pressure is None or not np.isfinite(pressure).any() or not np.nanmax(pressure) > np.nanmin(pressure):
        return np.asarray((time_s - time_s.mean()) / np.ptp(time_s))
    known = np.isfinite(pressure)
    values = np.interp(time_s, time_s[known], pressure[known])
    return np.asarray((values - np.median(values)) / np.ptp(values))


class LoggedTwin(EngineTwin):
    """`EngineTwin` of a recording that doesn't say all that it was made under.

    Attributes:
        circumstances: what may be off, and how far.
        beliefs: the settings that say so.
        values: what is known of it by now; else it is as assumed.
        asked: the same before the clocks of sensors were rounded to whole rows.
        opened: names of those that were found to be off, so that they are open as the unknown ones are.

    Args:
        recording, engine, sensors, map_tolerance, belief: as of `EngineTwin`.
        beliefs: of the circumstances; values, opened: as the attributes.
        like: the twin under circumstances near these, whose windows, steps and states at rest are taken over.
    """

    def __init__(
        self, recording: Recording, engine: EngineParameters, sensors: Sequence[str] | None = None, *,
        map_tolerance: float | None = None, belief: Belief | None = None, beliefs: CircumstanceSettings | None = None,
        values: Mapping[str, float] | None = None, opened: frozenset[str] = frozenset(),
        like: LoggedTwin | None = None,
    ) -> None:  # fmt: skip
        engine = with_charge(engine, recording)
        self.asked = dict(values or {})
        self.values: Mapping[str, float] = {
            name: applicable(recording, name, value) for name, value in self.asked.items()
        }
        right, under = put_right(recording, engine, self.values)
        super().__init__(right, under, sensors, map_tolerance=map_tolerance, belief=belief, like=like)
        self._read = recording, engine, sensors, map_tolerance, belief
        self.beliefs = beliefs or default_search().circumstances
        self.opened = opened
        self.circumstances = (*circumstances_of(recording, engine, self.channels, self.beliefs, opened),
                              *exponents_of(right, engine, self.beliefs))  # fmt: skip
        self._leave_delays_to_clocks()
        pressure = recording.columns.get("p_amb_pa")
        self._drift = _course(self.recording_time_s, None if pressure is None else pressure[self.rows])

    def _leave_delays_to_clocks(self) -> None:
        """Where a command's clock is open, its dead time is the same, and what is left of it a kink between rows."""
        untimed = [item for item in self.circumstances if item.kind == TIME_SHIFT and item.name in self.opened]
        columns = {item.column for item in untimed}
        self.points = tuple(replace(point, timed=f"{point.name}_pct" not in columns) for point in self.points)
        delays = {name for item in untimed for name in item.effects if EFFECTS[name].enters.operator == "dead_time"}
        self.hypotheses = {name: item for name, item in self.hypotheses.items() if name not in delays}

    def under(self, values: Mapping[str, float], opened: frozenset[str], like: bool = False) -> LoggedTwin:
        """The twin of the recording under other circumstances; `like`: near these, with the windows and holes of this
        one."""
        return self._again(self._read[1], values, opened, like)

    def with_term(self, term: Term) -> LoggedTwin:
        """The twin of an engine that has one more term, with the windows and holes of this one."""
        engine = self._read[1]
        return self._again(engine.replace(terms=(*engine.terms, term)), self.values, self.opened, like=True)

    def _again(
        self, engine: EngineParameters, values: Mapping[str, float], opened: frozenset[str], like: bool
    ) -> LoggedTwin:
        recording, _, sensors, map_tolerance, belief = self._read
        other = type(self)(recording, engine, sensors, map_tolerance=map_tolerance, belief=belief, beliefs=self.beliefs,
                           values=values, opened=opened, like=self if like else None)  # fmt: skip
        other.between_rows, other.known_between = self.between_rows, self.known_between
        for name, value in other.values.items():  # clocks that stay where they are
            if other.asked[name] == value == self.values.get(name):
                other.asked[name] = self.asked[name]
        if like:
            empty = ~np.isfinite(self.measured).any(axis=1)
            other.measured[empty] = np.nan
        return other

    def with_inputs_between_rows(self) -> LoggedTwin | None:
        """`likelihood.between_rows.WithInputsToOpen`."""
        if self.between_rows or not rows_may_be_slow(self.inputs.time_s) or rows_are_slow(self.inputs.time_s):
            return None
        other = self.under(self.values, self.opened)
        other.between_rows = True
        return other

    def circumstance_responses(self, lanes: Lanes, simulated: Array, names: Sequence[str]) -> Array:
        """Responses (K, n, C) of the readings per unit of circumstances, next to one lane with readings (n, C)."""
        out = np.zeros((len(names), *simulated.shape))
        needed = [self._moved_for(name) for name in names]
        by_run = list(dict.fromkeys(needed))
        responses = dict(zip(by_run, self._run_with(lanes, by_run), strict=True))
        ramp = self._drift
        for k, (name, run) in enumerate(zip(names, needed, strict=True)):
            if run in (_EARLIER, _LATER):
                j = self.channels.index(name.rpartition(":")[2])
                out[k, :, j] = -responses[run][:, j]
            else:  # the gas path answers within a second: a drift acts as its value of the moment
                beside = responses[run] - self._readings_follow(run)
                out[k] = beside if run == name else ramp[:, None] * beside
        return out

    def _readings_follow(self, name: str) -> Array | float:
        """Change of the readings themselves (n, C) per unit of a circumstance: a boost that was recorded as gauge
        pressure rises with the ambient. Zero where no reading was computed from anything else."""
        recording, engine, *_ = self._read
        made = [j for j, channel in enumerate(self.channels) if channel in recording.made.follows]
        if not made or name not in _FOLLOWED:
            return 0.0
        here, step = self.values.get(name, recording.p_amb_pa if name == "p_amb_pa" else 0.0), _FOLLOWED[name]
        moved, still = (put_right(recording, engine, {**self.values, name: at})[0] for at in (here + step, here))
        out = np.zeros((self.rows.size, len(self.channels)))
        for j in made:
            channel = self.channels[j]
            out[:, j] = np.nan_to_num((moved.columns[channel] - still.columns[channel])[self.rows] / step)
        return out

    def _moved_for(self, name: str) -> str:
        """What is moved for the response to a circumstance: all inputs for a sensor's clock, to the side on which it
        lies beyond the whole rows by which its readings were moved."""
        kind, _, column = name.rpartition(":")
        if kind != TIME_SHIFT or column in INPUT_COLUMNS:
            return name.removeprefix(f"{DRIFT}:")
        return _LATER if self.asked.get(name, 0.0) > self.values.get(name, 0.0) else _EARLIER

    def _run_with(self, lanes: Lanes, names: Sequence[str]) -> Array:
        """Responses to circumstances that act on the engine, a lane each behind one as it is."""
        lanes = self.with_own_laws(lanes)
        many = some_lanes(lanes, np.zeros(1 + len(names), dtype=np.int64))
        steps = np.array([_STEPS[name.rpartition(":")[0] or name] for name in names])
        steps[[name == _LATER for name in names]] *= -1.0
        constants = {
            key: getattr(self.engine, key) + np.array([0.0, *(steps * [name == column for name in names])])
            for column, key in _CONSTANT.items()
        }
        combined, schedules = self.combined(lanes)
        moved = [name in (_EARLIER, _LATER) for name in names]
        if any(moved):
            many.local[1:][moved] += steps[moved][:, None, None] * self._local_rates(lanes)
        moves = [("", 0.0), *zip(names, steps, strict=True)]
        actuations = [self._actuation_with(name, step, combined, schedules) for name, step in moves]
        seen = self.driven(many, actuations, constants)
        return np.asarray((seen[1:] - seen[0]) / steps[:, None, None])

    def _local_rates(self, lanes: Lanes) -> Array:
        """By how much the first states (W, 1) of the windows change in a second, along lane 0; to either side alike.

        All inputs earlier, and the states with them: a turbo speed that rises by 1300 rad/s in each second as a window
        begins was still where it had been, and of its sensor's clock no more was told there than its inertia lets it
        forget. Healthy engines with clocks 0.3 s off had "omega_t reads 0.08 s behind".
        """
        speed = self._memory.trajectories(some_lanes(lanes, slice(0, 1)), self._integrate).states[0, :, 2]
        both = np.stack([self.starts, self.starts + 1])  # a window has more rows than one
        return np.asarray(np.diff(speed[both], axis=0) / np.diff(self.time_s[both], axis=0)).T

    def _actuation_with(
        self, name: str, step: float, magnitudes: Mapping[str, Array], schedules: Mapping[str, Array]
    ) -> Actuation:
        """Actuators with one circumstance of an input moved by a step."""
        kind, _, column = name.rpartition(":")
        moved = moving(magnitudes)
        if not kind and not moved:
            return self._plain[0]
        inputs = self.inputs
        if kind == SCALE:
            scaled: dict[str, Any] = {column: (1.0 + step) * inputs.columns[column]}
            inputs = replace(inputs, **scaled)
        elif kind == ROUNDED:
            values = inputs.columns[column]
            bend = np.convolve(values, (1.0, -2.0, 1.0), mode="same")
            bend[[*self.pieces, *(self.pieces[1:] - 1), -1]] = 0.0
            rounded: dict[str, Any] = {column: values + step * bend}
            inputs = replace(inputs, **rounded)
        elif kind == TIME_SHIFT:
            made = self._read[0].made.among(INPUT_COLUMNS)
            before = {one: inputs.columns[one] for one in INPUT_COLUMNS}
            ambient = self.engine.p_amb  # no input follows it
            earlier: dict[str, Any] = {**before, **made.undone(before, ambient)}
            for one in INPUT_COLUMNS if name in (_EARLIER, _LATER) else [column]:
                earlier[one] = np.interp(self.time_s + step, self.time_s, earlier[one])
            inputs = replace(inputs, **{**earlier, **made.redone(earlier, ambient)})
        own = {key: values for key, values in schedules.items() if key in moved}
        return actuate_lanes(inputs, self.engine, moved, 1, own, self.steps_s)[0]


def beside_its_compressor(
    recording: Recording, engine: EngineParameters, sensors: Sequence[str], belief: Belief,
    beliefs: CircumstanceSettings | None = None,
) -> LoggedTwin:  # fmt: skip
    """The twin of a learned engine's recording of which all is believed but what its compressor does in that weather;
    the charge's temperature is the engine's. Arguments as of `LoggedTwin`."""
    columns = {name: values for name, values in recording.columns.items() if name != "t_im_k"}
    twin = LoggedTwin(replace(recording, columns=Columns(columns)), engine, sensors, belief=belief, beliefs=beliefs)
    twin.circumstances = tuple(item for item in twin.circumstances if item.kind == CORRECTED)
    return twin
