"""The diesel engine as a twin for discovery: the extended simulator, bound to one recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from dieseltwin.discovery.twins.diesel_between import covariance_between_rows
from dieseltwin.discovery.twins.diesel_lanes import (
    Memory,
    extension_of,
    known_terms,
    lane_actuations,
    moving,
    signals_of_lane,
)
from dieseltwin.discovery.twins.diesel_points import LAW_KINDS, LAW_SCOPE, POINT_FACTS, hypotheses_of
from dieseltwin.discovery.twins.diesel_responses import near, sooner
from dieseltwin.discovery.twins.diesel_steps import LATE, step_lengths, stiffness
from dieseltwin.discovery.twins.diesel_variables import variables_along
from dieseltwin.discovery.twins.interface import Array, Hypothesis, Lanes, Parameter, Point, joined, lane_of
from dieseltwin.discovery.twins.windows import ends_of, smoothed_at, speed_span, windows_of, without_gaps
from dieseltwin.engine import HEALTH, HEALTH_UNITS, MEASURED, Actuation, EngineParameters, Inputs
from dieseltwin.engine.actuation import actuate_lanes
from dieseltwin.engine.effects import EFFECTS, GAS_LAG
from dieseltwin.engine.extended import Extension, simulate_extended
from dieseltwin.engine.fixed_point import settled
from dieseltwin.engine.inputs import INPUT_COLUMNS
from dieseltwin.engine.map_corrections import basis, corrections_of
from dieseltwin.engine.parameters import parameter_batch
from dieseltwin.engine.quantities import ADDED_AT, POINTS
from dieseltwin.engine.sensor_effects import apply_sensor_effects
from dieseltwin.engine.simulate import Observations, settle
from dieseltwin.engine.terms import (
    Term,
    corrections_in,
    effect_terms,
    law_terms,
    with_corrections,
)
from dieseltwin.errors import InputError
from dieseltwin.learning.belief import HEALTH_PRIOR, Belief
from dieseltwin.recordings.between_rows import rows_are_slow
from dieseltwin.recordings.channels import optional_inputs
from dieseltwin.recordings.held import between_readings
from dieseltwin.recordings.noise import cut_offs
from dieseltwin.recordings.reader import Recording
from dieseltwin.settings.defaults import default_discover

WINDOW_S = 10.0
"""Length of a window [s]: some time constants of the turbocharger, and short against the growth of an instability."""

STEP_S = 0.025
"""Integration step of the trajectory along which steps are chosen [s]."""

_SPEED_SCALE = 500.0  # rad/s
_PRESSURES_REST_S = 0.35  # after a restart; the manifolds forget a wrong start within 0.2 s
_LAW_ROUNDS = 6
_LAW_SETTLED = 1e-5  # change of a law's signal relative to its size
_ACTUATORS_REST_S = 1.5  # after a gap, until dead time and lags have forgotten what is not known


class EngineTwin:
    """`interface.Twin` of the diesel engine over one recording.

    Args:
        recording: in the recording format; `time_s` as it is.
        engine: nominal engine; its terms are part of the model.
        sensors: columns of `MEASURED` to use, None for all that the recording has.
        map_tolerance: standard deviation of the maps' smooth errors [-]; None: the settings'.
        belief: what was learned of the engine: its corrections are simulated, and readings are what they would be
            without its sensors' errors; None for maps and sensors as they are.
        like: a twin of the same recording, nearly the same, whose windows and steps are taken over.

    Raises:
        InputError: no sensor, or no stretch with the engine running.
    """

    own_schedules = True
    """Lanes may have schedules of their own."""
    courses = True
    window_s = WINDOW_S
    between_rows = False
    """Whether inputs may have moved between rows that aren't slow: with a covariance as it was first, a slow guess."""
    known_between: tuple[Array, ...] = ()

    def __init__(
        self,
        recording: Recording,
        engine: EngineParameters,
        sensors: Sequence[str] | None = None,
        *,
        map_tolerance: float | None = None,
        belief: Belief | None = None,
        like: EngineTwin | None = None,
    ) -> None:
        self.belief = belief
        tolerance = default_discover().map_tolerance if map_tolerance is None else map_tolerance
        if belief is not None:
            engine = engine.replace(terms=with_corrections(engine.terms, belief.coefficients))
        coefficients = corrections_in(engine.terms)
        self.corrections = None if coefficients is None else corrections_of(coefficients)
        present = [c for c in MEASURED if c in recording.columns and np.isfinite(recording.columns[c]).any()]
        self.channels = tuple(c for c in MEASURED if c in (present if sensors is None else sensors))
        missing = [c for c in self.channels if c not in present]
        if missing or not self.channels:
            raise InputError(f"{recording.path or 'recording'}: sensors", ", ".join(missing) or "none",
                             ", ".join(MEASURED), "name columns that the recording has")
        self.engine = engine.replace(p_amb=recording.p_amb_pa, T_amb=recording.t_amb_k)
        rows, self.starts, self.pieces = windows_of(recording, self.window_s)
        self.rows = rows
        self.recording_time_s = time = recording.time_s[rows]
        self.start_s = recording.start_s
        self.time_s = without_gaps(time, self.pieces)
        self._at = [MEASURED.index(c) for c in self.channels]
        columns = recording.columns
        nothing = np.full(recording.time_s.size, np.nan)
        readings = np.stack([columns.get(c, nothing)[rows] for c in MEASURED], axis=1).astype(np.float64)
        self._cut_offs = {} if recording.standing else cut_offs(readings[:, self._at])
        self.all_readings = readings if belief is None else belief.truthful(readings)
        measured = self.all_readings[:, self._at].copy()
        for start in self.pieces[1:]:
            measured[start : start + int(np.searchsorted(time[start:], time[start] + _ACTUATORS_REST_S))] = np.nan
        self._readings = measured
        self.conditions: Mapping[str, Array] = {c: columns[c][rows] for c in INPUT_COLUMNS}
        further = {name: values[rows] for name, values in optional_inputs(columns).items()}
        inputs: Mapping[str, Any] = {**self.conditions, **further}
        self.inputs = Inputs(self.time_s, **inputs, start_s=self.start_s, recorded_s=time).clipped(self.engine)
        self.parameters = tuple(
            Parameter(name, value, HEALTH_PRIOR * value, HEALTH_UNITS[name], 0.1 * value)
            for name, value in zip(HEALTH, self.engine.health(), strict=True)
        )
        # Of the states only the turbo speed remembers more than a few samples. The pressures start from smoothed
        # readings, and the readings of the first moments are left out: at p_em = p_im the slope of the EGR flow has no
        # limit, so that a free pressure there makes a fit stall.
        self.states: tuple[str, ...] = ("omega_t",)
        self.state_scales = np.array([_SPEED_SCALE])
        self.points = tuple(
            Point(name, facts.site, name not in ADDED_AT, ADDED_AT.get(name, "-"), facts.ports, facts.scale,
                  tolerance if facts.over else 0.0, facts.over, facts.also)
            for name, facts in ((name, POINT_FACTS[name]) for name in POINTS)
        )  # fmt: skip
        slow = rows_are_slow(self.time_s)
        self.law_scope = replace(LAW_SCOPE, kinds=LAW_KINDS) if slow else LAW_SCOPE
        self.hypotheses: Mapping[str, Hypothesis] = hypotheses_of(self.channels, further, slow)
        self._driven = {name: Term(effect=name, magnitude=0.0).factor(time, self.start_s, inputs)
                        for name in self.hypotheses if EFFECTS[name].varies}  # fmt: skip
        self._known = known_terms(self.engine.terms, time, self.start_s, inputs)
        self._laws = law_terms(self.engine.terms)
        self._law_signals: dict[str, Array] = {}
        if like is not None:
            self._take_over(like)
        self._begin()
        self.deviation = np.zeros(basis().maps.size)

    def _take_over(self, other: EngineTwin) -> None:
        """Windows and steps of another twin of the same recording. Where a pressure has no column its states, too: they
        settle before a window's readings count. The turbo speed doesn't."""
        self.starts = other.starts
        known = ["_stiffness"]
        if np.isfinite(self.all_readings[:, 2]).any():
            known.append("_nominal_states")
        self.__dict__.update({name: other.__dict__[name] for name in known if name in other.__dict__})

    @cached_property
    def _even(self) -> list:
        """Actuators at even steps."""
        return actuate_lanes(self.inputs, self.engine, {}, 1, None, STEP_S)

    @cached_property
    def _stiffness(self) -> Array:
        states = simulate_extended(
            self._even[0], parameter_batch(self.engine), Extension(restarts=self.starts, corrections=self.corrections),
            self.initial(self.first_local())[None],
        ).states[0]  # fmt: skip
        return stiffness(states, self._even[0], self.engine)

    def _choose_steps(self) -> None:
        self.steps_s = step_lengths(self._stiffness, self.starts)
        self.__dict__.pop("_plain", None)

    @cached_property
    def _plain(self) -> list[Actuation]:
        """Actuators without effects; a twin that is given other windows at once, and so other steps, asks for none."""
        return actuate_lanes(self.inputs, self.engine, {}, 1, None, self.steps_s)

    def _begin(self) -> None:
        """Readings without the first moments of each window, and the states at the windows' starts."""
        self.measured = self._readings.copy()
        self.moved = np.zeros_like(self.measured)
        for start in self.starts:
            rest = int(np.searchsorted(self.time_s, self.time_s[start] + _PRESSURES_REST_S))
            self.measured[start:rest] = np.nan
        self._first = self._smoothed_states()
        self._choose_steps()
        self._memory = Memory()  # the states' starts are another's

    def split(self, windows: np.ndarray, parts: int, local: Array) -> Array:
        """Cut some windows into parts and return the initial states (W', 1) of all, new ones from the readings.

        Where the machine is unstable a long window amplifies its initial states until no fit can follow.

        Args:
            windows: (W,) True where to cut; parts: number of parts; local: (W, 1) initial states so far.
        """
        ends = ends_of(self.starts, self.time_s.size)
        starts = [
            np.linspace(a, b, parts + 1)[:-1].astype(np.int64) if cut and b - a >= 6 * parts else np.array([a])
            for a, b, cut in zip(self.starts, ends, windows, strict=True)
        ]
        kept = {int(a): state for a, state in zip(self.starts, local, strict=True)}
        self.starts = np.concatenate(starts)
        self._begin()
        return np.stack([kept.get(int(a), state) for a, state in zip(self.starts, self.first_local(), strict=True)])

    def first_local(self) -> Array:
        """Turbo speed at the windows' starts from smoothed readings (W, 1)."""
        return self._first[:, 2:].copy()

    def initial(self, local: Array) -> Array:
        """p_im, p_em [Pa], omega_t [rad/s] at the windows' starts (.., W, 3) for initial states (.., W, 1)."""
        shape = (*local.shape[:-1], 2)
        return np.concatenate([np.broadcast_to(self._first[:, :2], shape), local], axis=-1)

    def local_limits(self) -> tuple[Array, Array]:
        """Lowest and highest turbo speed at the windows' starts, (W, 1) each [rad/s]."""
        first = self.first_local()
        span = speed_span(self.all_readings[:, 2]) * np.maximum(first, np.median(first))
        return first - span, first + span

    def _smoothed_states(self) -> Array:
        """p_im, p_em, omega_t at the windows' starts, from readings or else from the nominal engine, (W, 3)."""
        readings = np.stack([between_readings(values) for values in self.all_readings[:, :3].T], axis=1)
        few = np.isfinite(readings).mean(axis=0) < 0.5
        nominal = self._nominal_states if few.any() or not np.isfinite(readings).all() else readings
        return smoothed_at(self.starts, self.pieces, self.time_s, np.where(few, nominal, readings), nominal)

    @cached_property
    def _nominal_states(self) -> Array:
        """States of the nominal engine over the whole recording, started at rest, (n, 3)."""
        n_e, u_delta, u_egr, u_vgt = (float(values[0]) for values in self.conditions.values())
        first = np.asarray(settle(n_e, u_delta, u_egr, u_vgt, self.engine))[None, None, :]
        plain = Extension(corrections=self.corrections)
        return simulate_extended(self._even[0], parameter_batch(self.engine), plain, first).states[0, :, :3]

    def simulate(self, lanes: Lanes) -> Array:
        """Readings of the used channels without noise, (B, n, C)."""
        return self._simulate_signals(self.with_own_laws(lanes))[0]

    def simulate_all(self, lanes: Lanes) -> Array:
        """All columns of `MEASURED` without sensor effects, (B, n, C)."""
        return self._simulate_signals(self.with_own_laws(lanes))[1].measured

    def with_own_laws(self, lanes: Lanes) -> Lanes:
        """The engine's own laws as signals, settled along lane 0 (Picard) and shared by all lanes."""
        if not self._laws:
            return lanes
        one, conditions = lane_of(lanes, 0), dict(self.conditions)

        def answer(signals: dict[str, Array]) -> dict[str, Array]:
            entered = replace(one, signals=joined(one.signals, signals))
            variables = self._variables(self._simulate_signals(entered)[1], 0, entered)
            new: dict[str, Array] = {}
            for law in self._laws:
                own = variables.get(f"{law.point}:before")
                at = variables if own is None else {**variables, law.point: own}
                signal = np.nan_to_num(law.signal(at) * law.factor(self.recording_time_s, self.start_s, conditions))
                new[law.point] = new.get(law.point, 0.0) + np.broadcast_to(signal, self.time_s.shape)
            return new

        self._law_signals = settled(answer, self._law_signals, rounds=_LAW_ROUNDS, tolerance=_LAW_SETTLED)
        return replace(lanes, signals=joined(lanes.signals, self._law_signals))

    def _simulate_signals(self, lanes: Lanes) -> tuple[Array, Observations]:
        if sooner(lanes) and not np.any(self.combined(lanes)[0].get(GAS_LAG, 0.0)):  # a lag goes on over restarts
            alone = replace(lane_of(lanes, 0), lane_points=None, lane_signals=None, linear=False)
            base = self._memory.trajectories(alone, self._integrate)
            result = near(lanes, self.starts, base, lambda some, at, x: self._integrate(some, restarts=(at, x)))
        else:
            result = self._memory.trajectories(lanes, self._integrate)
        return self._shown(result, lanes), result

    def _shown(self, result: Observations, lanes: Lanes) -> Array:
        """What the sensors show of a simulation on average, their effects and cut-off noise included, (B, n, C)."""
        shown = apply_sensor_effects(result.measured[..., self._at], self.time_s, *self.combined(lanes), self.channels)
        for j, cut in self._cut_offs.items():
            shown[..., j] = cut.expected(shown[..., j])
        return shown

    def with_coefficients(self, coefficients: Array) -> Self:
        """The same twin with other corrections of the maps, coefficients (K,) of `map_corrections.basis` [-]."""
        other = copy(self)
        other.engine = self.engine.replace(terms=with_corrections(self.engine.terms, coefficients))
        other.corrections, other._memory = corrections_of(coefficients), Memory()
        other._law_signals = dict(self._law_signals)
        return other

    def with_inputs(self, inputs: Inputs) -> EngineTwin:
        """The same twin driven by other inputs, at as many sample times and on as many steps."""
        other = copy(self)
        longer = np.diff(inputs.time_s) / np.diff(self.time_s)
        other.inputs, other.time_s, other._memory = inputs.clipped(self.engine), inputs.time_s, Memory()
        other.steps_s = longer * self.steps_s
        other.__dict__.pop("_plain", None)
        other._law_signals = dict(self._law_signals)
        return other

    def deviating(self, deviation: Array, moved: Array) -> EngineTwin:
        """The twin about other corrections than the belief's mean (`likelihood.learned.LearnedTwin`)."""
        coefficients = deviation if self.belief is None else self.belief.coefficients + deviation
        other = self.with_coefficients(coefficients)
        other.deviation, other.moved = deviation, moved
        other.measured = self.measured - self.moved + moved
        return other

    def _integrate(self, lanes: Lanes, constants: Mapping[str, Array] | None = None,
                   drive: list[Actuation] | None = None,
                   restarts: tuple[np.ndarray, Array] | None = None) -> Observations:  # fmt: skip
        columns: dict[str, Any] = {p.name: lanes.parameters[:, j] for j, p in enumerate(self.parameters)}
        batch = parameter_batch(self.engine, **columns, **dict[str, Any](constants or {}))
        combined, schedules = self.combined(lanes)
        drive = drive or self._actuations(combined, schedules) or [self._plain[0]]
        starts, initial = (self.starts, self.initial(lanes.local)) if restarts is None else restarts
        extension = replace(
            extension_of(lanes, combined, schedules, self.time_s.size), restarts=starts, corrections=self.corrections
        )
        return simulate_extended(drive if len(drive) > 1 else drive[0], batch, extension, initial, late=LATE)

    def driven(self, lanes: Lanes, actuations: list[Actuation], constants: Mapping[str, Array] | None = None) -> Array:
        """Readings (B, n, C) of lanes that have actuators of their own, and constants of the engine (B,)."""
        return self._shown(self._integrate(lanes, constants, actuations), lanes)

    def covariance_between_rows(self, lanes: Lanes) -> tuple[Array, ...]:
        """`likelihood.between_rows.WithOpenInputs`."""
        sizes = np.diff(np.append(self.starts, self.time_s.size)) * len(self.channels)
        if self.between_rows and [len(known) for known in self.known_between] == sizes.tolist():
            return self.known_between
        found = covariance_between_rows(self, lanes)
        if self.between_rows:
            self.known_between = found
        return found

    def _actuations(self, combined: Mapping[str, Array], schedules: Mapping[str, Array]) -> list[Actuation] | None:
        """Of every lane where an effect acts on a command; None where none does."""
        moved = moving(combined)
        return lane_actuations(self.inputs, self.engine, moved, schedules, self._plain, self.steps_s) if moved else None

    def combined(self, lanes: Lanes) -> tuple[dict[str, Array], dict[str, Array]]:
        """Magnitudes and schedules of the lanes together with the engine's own terms."""
        magnitudes = {name: np.asarray(value, dtype=np.float64) for name, value in lanes.magnitudes.items()}
        schedules = dict(lanes.schedules)
        for name, driven in self._driven.items():
            schedules[name] = driven * schedules.get(name, 1.0)
        for name, (magnitude, schedule) in self._known.items():
            if name in magnitudes and (schedule is not None or name in schedules):  # either has times of its own
                lane = magnitudes[name][:, None] * schedules.get(name, 1.0)
                schedules[name] = lane + magnitude * (1.0 if schedule is None else schedule)
                magnitudes[name] = np.ones(lanes.size)
                continue
            magnitudes[name] = magnitudes.get(name, np.zeros(lanes.size)) + magnitude
            if schedule is not None:
                schedules[name] = schedule
        return magnitudes, schedules

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Variables of ports and tolerances along the trajectory of lane 0, name -> (n,) [SI, %, mg/cycle, rpm]."""
        return self.trajectories(lane_of(lanes, 0))[1][0]

    def trajectories(self, lanes: Lanes) -> tuple[Array, list[dict[str, Array]]]:
        """Readings (B, n, C), and `variables` of every lane, by one simulation."""
        lanes = self.with_own_laws(lanes)
        measured, result = self._simulate_signals(lanes)
        return measured, [self._variables(result, b, lane_of(lanes, b)) for b in range(lanes.size)]

    def _variables(self, result: object, b: int, one: Lanes) -> dict[str, Array]:
        """Of lane `b` of a result; where a signal enters a quantity, `<name>:before` is it without its own signal."""
        actuation = (self._actuations(*self.combined(one)) or self._plain)[0]
        engine = self.engine_of(one)
        if self._laws:  # they are among the signals
            coefficients, terms = corrections_in(engine.terms), effect_terms(engine.terms)
            engine = engine.replace(terms=terms if coefficients is None else with_corrections(terms, coefficients))
        states, readings = result.states[b], result.measured[b]  # type: ignore[attr-defined]
        signals = signals_of_lane(one, self.points)
        return variables_along(states, readings, actuation, engine, (signals, self.points))

    def engine_of(self, lanes: Lanes) -> EngineParameters:
        """The engine of lane 0: health parameters and constant effects as terms (schedules aside)."""
        values = {p.name: float(lanes.parameters[0, j]) for j, p in enumerate(self.parameters)}
        more = [Term(effect=name, magnitude=float(np.clip(size[0], *EFFECTS[name].limits)))
                for name, size in lanes.magnitudes.items() if size[0] != 0.0]  # fmt: skip
        return self.engine.replace(**values, terms=(*self.engine.terms, *more))
