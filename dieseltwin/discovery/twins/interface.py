"""What discovery asks of a twin: parameters, insertion points with their ports, effects, and a batched simulation.

Nothing here knows an engine. A twin is bound to one recording: it holds the inputs, the sample times and the windows.
The recording is cut into windows; at the first sample of each the states start anew from local unknowns. So a long
recording can't diverge where the machine is unstable, and what is lost is a few values per window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dieseltwin.arrays import Array
from dieseltwin.discovery.twins.offers import Offer


@dataclass(frozen=True)
class Parameter:
    """A free parameter of the twin (for the engine: a health parameter).

    Attributes:
        name: its name.
        value: nominal value [unit].
        prior_std: standard deviation of what is believed before the recording [unit]; wide.
        unit: unit.
        scale: size of a typical change, for differences and step limits [unit].
        bounded: fits keep it within four standard deviations of its prior, and positive ones positive; False where
            readings are linear in it, so that no fit can lead astray.
        start: where fits start, if not at the nominal value, about which it is believed [unit].
    """

    name: str
    value: float
    prior_std: float
    unit: str
    scale: float
    bounded: bool = True
    start: float | None = None

    @property
    def first(self) -> float:
        """Where fits start [unit]."""
        return self.value if self.start is None else self.start


@dataclass(frozen=True)
class Point:
    """An insertion point: one intermediate quantity of the model graph to which a term may be added.

    Attributes:
        name: of the quantity ("W_t", "intake_balance").
        site: the word for the report (docs/discovery.md).
        relative: the signal multiplies the quantity by (1 + signal); else it is added in `unit`.
        unit: of an added signal; "-" for a relative one.
        ports: variables of the nodes that the quantity touches; a law at this point may depend on these only.
        scale: typical size of an added signal [unit]; 1 for a relative one.
        tolerance: smooth relative error that is believed of the quantity's map (0 for balances) [-].
        tolerance_over: the map's own arguments, names of variables; a tolerance is a smooth function of them.
        tolerance_also: other arguments over which the map may be thought of; the two then share the tolerance.
        timed: when it was recorded is known; else a delay of it is no finding.
    """

    name: str
    site: str
    relative: bool
    unit: str
    ports: tuple[str, ...]
    scale: float = 1.0
    tolerance: float = 0.0
    tolerance_over: tuple[str, ...] = ()
    tolerance_also: tuple[str, ...] = ()
    timed: bool = True


@dataclass(frozen=True)
class LawScope:
    """What laws at the points of a twin may be made of.

    Attributes:
        kinds: of factors (`laws.grammar.Kind`); None for all.
        variables: names; None for all that the ports name.
        units: of variables.
        commands: operators that act on an actuator's command, before its lags: (kind, point) -> effect that does it.
        lags: lags of other quantities that the twin has as effects: point -> effect.
        holes: point -> effect that is a hole from there to the surroundings.
        lagging_sensors: channels whose reading may lag.
        channel_units: of an offset of each channel.
    """

    kinds: tuple[str, ...] | None = None
    variables: tuple[str, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    commands: Mapping[tuple[str, str], str] = field(default_factory=dict)
    lags: Mapping[str, str] = field(default_factory=dict)
    holes: Mapping[str, str] = field(default_factory=dict)
    lagging_sensors: tuple[str, ...] = ()
    channel_units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Hypothesis:
    """An effect that the twin can simulate by name.

    Attributes:
        name, site, law, unit: for the report.
        tolerance: smallest magnitude of interest [unit].
        limits: physically possible magnitudes [unit]; a lower limit of 0 means one-sided.
        smooth: the response is differentiable at 0. If not, secants are taken at `sizes`.
        sizes: magnitudes for first differences (one for smooth effects), in `unit`.
        kind: "sensor" effects change readings alone.
        in_place_of: condition whose place the magnitude takes, a command that isn't followed; "": none. Small sizes of
            such an effect say nothing of large ones, so that it has no score (`search.standing`).
    """

    name: str
    site: str
    law: str
    unit: str
    tolerance: float
    limits: tuple[float, float]
    smooth: bool = True
    sizes: tuple[float, ...] = ()
    kind: Literal["physics", "actuator", "input", "sensor"] = "physics"
    in_place_of: str = ""

    @property
    def sign(self) -> float:
        """Of all possible magnitudes, 1 or -1; 0 where either is possible."""
        return 1.0 if self.limits[0] >= 0.0 else -1.0 if self.limits[1] <= 0.0 else 0.0


@dataclass(frozen=True)
class Lanes:
    """B simulations to run at once.

    Attributes:
        parameters: (B, P) values of `Twin.parameters` [unit].
        local: (B, W, S) initial states of the W windows.
        magnitudes: effect name -> (B,) magnitudes [unit]; effects not named are absent.
        schedules: effect name -> (n,) factor of its magnitude over the samples (onset, region, drift); 1 if not named.
            (B, n) one per lane, where the twin says that it takes them (`Twin.own_schedules`).
        signals: point name -> (n,) signal shared by all lanes.
        lane_points: (B,) index into `Twin.points` of the point that `lane_signals` enters, -1 for none.
        lane_signals: (B, n) one further signal per lane.
        linear: the lanes differ by `lane_signals` alone, so small that a twin may take them to first order.
    """

    parameters: Array
    local: Array
    magnitudes: Mapping[str, Array] = field(default_factory=dict)
    schedules: Mapping[str, Array] = field(default_factory=dict)
    signals: Mapping[str, Array] = field(default_factory=dict)
    lane_points: NDArray[np.int64] | None = None
    lane_signals: Array | None = None
    linear: bool = False

    @property
    def size(self) -> int:
        """Number of lanes B."""
        return int(self.parameters.shape[0])


@runtime_checkable
class Twin(Offer, Protocol):
    """A model of a machine, bound to one recording of n samples, C channels and W windows.

    Attributes:
        channels: names of the C measured columns.
        parameters: the P free parameters.
        states: names of the S states that start anew in each window.
        state_scales: (S,) typical sizes of the states, for differences.
        points: insertion points.
        hypotheses: effects by name.
        time_s: (n,) sample times [s].
        starts: (W,) index of each window's first sample, ascending, the first 0.
        measured: (n, C) readings, NaN where missing.
        conditions: named (n,) input columns over which regions are reported (n_e_rpm, u_delta_mg, ...).
        own_schedules: lanes may have schedules of their own.
    """

    channels: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    state_scales: Array
    points: tuple[Point, ...]
    hypotheses: Mapping[str, Hypothesis]
    time_s: Array
    starts: NDArray[np.int64]
    measured: Array
    conditions: Mapping[str, Array]
    own_schedules: bool

    @property
    def recording_time_s(self) -> Array:
        """(n,) times of the samples in the recording, gaps included [s]."""
        ...

    @property
    def start_s(self) -> float:
        """When the recording starts, from which what is told counts [s]."""
        ...

    def simulate(self, lanes: Lanes) -> Array:
        """Readings without noise, (B, n, C)."""
        ...

    def simulate_all(self, lanes: Lanes) -> Array | None:
        """Readings of every sensor that there could be, (B, n, all), without sensor effects; None where unknown."""
        ...

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Every variable that ports and tolerances name, along the trajectory of lane 0: name -> (n,)."""
        ...

    def first_local(self) -> Array:
        """First guess of the windows' initial states from the readings, (W, S)."""
        ...

    def local_limits(self) -> tuple[Array, Array] | None:
        """Lowest and highest initial states that the readings allow, (W, S) each; None for any."""
        ...

    def split(self, windows: NDArray[np.bool_], parts: int, local: Array) -> Array | None:
        """Cut some windows (W,) into parts; the initial states (W', S) of all. None where windows can't be cut."""
        ...


class TwinDefaults:
    """What a plain twin says of the rest of `Twin`: time without gaps, one schedule for all lanes, and nothing more."""

    time_s: Array
    own_schedules: bool = False

    @property
    def recording_time_s(self) -> Array:
        """(n,) sample times [s]."""
        return self.time_s

    @property
    def start_s(self) -> float:
        """The first sample [s]."""
        return float(self.recording_time_s[0])

    def simulate_all(self, lanes: Lanes) -> Array | None:
        """There are no other sensors than `channels`."""
        return None

    def local_limits(self) -> tuple[Array, Array] | None:
        """Any initial state will do."""
        return None

    def split(self, windows: NDArray[np.bool_], parts: int, local: Array) -> Array | None:
        """Windows stay as they are."""
        return None


@runtime_checkable
class WithExactResponses(Offer, Protocol):
    """A twin whose responses are true to far less than a hundredth: what is left of a term beside its like is physics.

    An axis' constant force and a friction that differs with the direction are the same but where it stands still.
    """

    exact_responses: bool


@runtime_checkable
class WithLawScope(Offer, Protocol):
    """A twin that says what its laws may be made of."""

    law_scope: LawScope


def law_scope_of(twin: Twin) -> LawScope:
    """What laws of a twin may be made of; anything, where it doesn't say."""
    return twin.law_scope if isinstance(twin, WithLawScope) else LawScope()


@runtime_checkable
class WithCourses(Twin, Protocol):
    """A twin that says whether its effects may come and go or grow: its schedules take any value then."""

    courses: bool


@runtime_checkable
class Strained(Twin, Protocol):
    """A twin that says whether a fit without what is missing may strain its parameters so far (a mass twice its own)
    that no straight line leads back: how far the priors pull then says nothing of an effect's gain."""

    strained: bool


@runtime_checkable
class OverRecordings(Twin, Protocol):
    """A twin over R recordings, in which an effect's size may differ from one to the next.

    Attributes:
        parts: a twin of each recording by itself; `parameters` are those of all, one recording's behind the other's.
        factors: way in which a size may differ -> (R,) factor of the effect's magnitude.
        profiles: the same for every sample, (n,); rows: samples of each recording.
    """

    @property
    def parts(self) -> Sequence[Twin]: ...

    @property
    def rows(self) -> Sequence[slice]: ...

    @property
    def factors(self) -> Mapping[str, Array]: ...

    @property
    def profiles(self) -> Mapping[str, Array]: ...


def rows_of(twin: Twin, windows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(W,) windows -> (n,) samples that lie in them."""
    return np.repeat(windows, np.diff(np.append(twin.starts, twin.time_s.size)))


def single(parameters: Array, local: Array, **more: Any) -> Lanes:
    """One lane."""
    return Lanes(np.asarray(parameters, dtype=np.float64)[None], np.asarray(local, dtype=np.float64)[None], **more)


def some_lanes(lanes: Lanes, at: np.ndarray | slice) -> Lanes:
    """A part of the lanes."""
    return replace(
        lanes,
        parameters=lanes.parameters[at],
        local=lanes.local[at],
        magnitudes={name: values[at] for name, values in lanes.magnitudes.items()},
        schedules={name: v if v.ndim == 1 else v[at] for name, v in lanes.schedules.items()},
        lane_points=None if lanes.lane_points is None else lanes.lane_points[at],
        lane_signals=None if lanes.lane_signals is None else lanes.lane_signals[at],
    )


def repeated(lane: Lanes, count: int) -> Lanes:
    """One lane, so many times."""
    return some_lanes(lane, np.zeros(count, dtype=np.int64))


def lane_of(lanes: Lanes, index: int) -> Lanes:
    """One lane alone."""
    return some_lanes(lanes, slice(index, index + 1))


def joined(signals: Mapping[str, Array], more: Mapping[str, Array]) -> dict[str, Array]:
    """Signals at points, added up by name."""
    out = dict(signals)
    for name, signal in more.items():
        out[name] = out.get(name, 0.0) + signal
    return out


_OF_LANES = (
    "simulate_all", "trajectories", "circumstance_responses", "covariance_between_rows", "nuisances",
    "simulate_with_laws",
)  # fmt: skip
"""What else of a twin takes lanes first."""


class WithSignals:
    """A twin with fixed signals in every simulation."""

    def __init__(self, twin: Twin, signals: Mapping[str, Array]) -> None:
        self._twin, self._signals = twin, signals

    def __getattr__(self, name: str) -> object:
        offered = getattr(self._twin, name)
        return (lambda lanes, *more: offered(self._with_signals(lanes), *more)) if name in _OF_LANES else offered

    def _with_signals(self, lanes: Lanes) -> Lanes:
        return replace(lanes, signals=joined(lanes.signals, self._signals))

    def simulate(self, lanes: Lanes) -> Array:
        """As `Twin.simulate`."""
        return self._twin.simulate(self._with_signals(lanes))

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """As `Twin.variables`."""
        return self._twin.variables(self._with_signals(lanes))
