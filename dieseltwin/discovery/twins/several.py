"""Several recordings of one engine as one twin: maps and sensors are shared, each recording has a health of its own.

The windows of all recordings stand one after another. So the likelihood, the search and the laws see one long
recording: tolerances of maps and sensors are directions that act on all of it at once, and the health parameters of a
recording act on its own rows. What a recording doesn't say (ambient, fuel, clocks) is its own too; how the compressor's
maps go in other weather is the engine's, and one for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.diesel_circumstances import LoggedTwin
from dieseltwin.discovery.twins.interface import Array, Hypothesis, Lanes, Point, some_lanes
from dieseltwin.engine import EngineParameters
from dieseltwin.errors import InputError
from dieseltwin.recordings.circumstances import CORRECTED, Circumstance, among_several, kind_of, of_recording
from dieseltwin.settings.defaults import default_search

_COLD_SPAN_K = 5.0
"""Spread of the recordings' ambient temperatures from which cold weather can be told from chance [K]: its change over a
day."""

_MOST_SPANNED = 8
"""Recordings up to which spans between two of them are asked for: 42 ways then, and as their number squared."""

_PAUSE_S = 1.0  # between recordings on the common time axis


@dataclass(frozen=True)
class Occasion:
    """When and in what weather a recording was made.

    Attributes:
        days: since the first recording [d].
        t_amb_k: ambient temperature [K].
    """

    days: float
    t_amb_k: float


def ways_to_differ(occasions: Sequence[Occasion]) -> dict[str, Array]:
    """Ways in which an effect's size may differ between R recordings in time order: name -> (R,) factors of its size.

    `begins:k`: nothing before recording k; `ends:k`: nothing from recording k on (a repair); `grows:k`: zero up to
    recording k, then proportional to time, 1 at the last; `cold`: zero at the warmest recording, 1 at the coldest,
    linear in ambient temperature; `only:j:k`: in the recordings j to k - 1 alone; `gone:j:k`: in all but those (mended
    and there again; or recordings without a date, whose order is that in which they were named). Some are alike: what
    two recordings have can have begun as well as grown.
    """
    days = np.array([item.days for item in occasions])
    warmth = np.array([item.t_amb_k for item in occasions])
    count = len(occasions)
    found: dict[str, Array] = {f"begins:{k}": (np.arange(count) >= k).astype(np.float64) for k in range(1, count)}
    found |= {f"ends:{k}": (np.arange(count) < k).astype(np.float64) for k in range(1, count)}
    for k in range(count - 1):
        if days[-1] > days[k]:
            found[f"grows:{k}"] = np.maximum(days - days[k], 0.0) / (days[-1] - days[k])
    if np.ptp(warmth) >= _COLD_SPAN_K:
        found["cold"] = (warmth.max() - warmth) / np.ptp(warmth)
    for j, k in combinations(range(1, count if count <= _MOST_SPANNED else 0), 2):
        inside = ((np.arange(count) >= j) & (np.arange(count) < k)).astype(np.float64)
        found |= {f"only:{j}:{k}": inside, f"gone:{j}:{k}": 1.0 - inside}
    return found


def profiles_of(occasions: Sequence[Occasion]) -> dict[str, Array]:
    """`ways_to_differ` that aren't alike, the earlier kind of those that are."""
    distinct: dict[str, Array] = {}
    for name, factors in ways_to_differ(occasions).items():
        if not any(np.allclose(factors, other) for other in distinct.values()):
            distinct[name] = factors
    return distinct


class SeveralTwin:
    """`discovery.twins.interface.Twin` over the windows of several recordings of one engine.

    Args:
        parts: one twin a recording, in time order, with the same channels.
        occasions: of each.

    Raises:
        InputError: fewer than two recordings, or other channels in one of them.
    """

    own_schedules = EngineTwin.own_schedules

    def __init__(self, parts: Sequence[EngineTwin], occasions: Sequence[Occasion]) -> None:
        if len(parts) < 2:
            raise InputError("recordings", f"{len(parts)}", "two or more", "judge one recording by itself")
        first = parts[0]
        for part in parts[1:]:
            if part.channels != first.channels:
                raise InputError("recordings: sensors", ", ".join(part.channels), ", ".join(first.channels),
                                 "name sensors that all recordings have")  # fmt: skip
        self.parts, self.occasions = tuple(parts), tuple(occasions)
        self.channels, self.states, self.state_scales = first.channels, first.states, first.state_scales
        scopes = [part.law_scope for part in parts]
        self.law_scope = min(scopes, key=lambda scope: len(scope.kinds or ()))  # slow rows of one recording show less
        self.points: tuple[Point, ...] = tuple(
            replace(same[0], timed=all(point.timed for point in same))
            for same in zip(*(part.points for part in parts), strict=True)
        )
        self.belief = first.belief
        self.parameters = tuple(
            replace(parameter, name=f"{parameter.name}:{r}")
            for r, part in enumerate(parts)
            for parameter in part.parameters
        )
        self.hypotheses: Mapping[str, Hypothesis] = {
            name: hypothesis
            for name, hypothesis in first.hypotheses.items()
            if all(name in part.hypotheses for part in parts)
        }
        self._edges = np.cumsum([0, *(part.time_s.size for part in parts)])
        self.rows = tuple(slice(int(a), int(b)) for a, b in pairwise(self._edges))
        self.time_s = _one_after_another([part.time_s for part in parts])
        self.recording_time_s, self.start_s = _one_after_another([part.recording_time_s for part in parts]), 0.0
        self.conditions: Mapping[str, Array] = {
            name: np.concatenate([part.conditions[name] for part in parts]) for name in first.conditions
        }
        self.deviation = first.deviation
        logged = {r: part for r, part in enumerate(self.parts) if isinstance(part, LoggedTwin)}
        self.beliefs = next((part.beliefs for part in logged.values()), default_search().circumstances)
        items = {
            among_several(item.name, r): replace(item, name=among_several(item.name, r))
            for r, part in logged.items() for item in part.circumstances
        }  # fmt: skip
        self.circumstances: tuple[Circumstance, ...] = tuple(items.values())
        self.values: Mapping[str, float] = {
            among_several(name, r): value for r, part in logged.items() for name, value in part.values.items()
        }
        self.opened = frozenset(among_several(name, r) for r, part in logged.items() for name in part.opened)
        self._begin()

    def _begin(self) -> None:
        begins = zip(self.parts, self.rows, strict=True)
        self.starts = np.concatenate([part.starts + rows.start for part, rows in begins])
        self._windows = np.cumsum([0, *(part.starts.size for part in self.parts)])
        self.measured: Array = np.concatenate([part.measured for part in self.parts])
        self.moved = np.zeros_like(self.measured)

    @property
    def engine(self) -> EngineParameters:
        """The engine on the last recording, before anything is fitted."""
        return self.parts[-1].engine

    @property
    def factors(self) -> dict[str, Array]:
        """Ways in which an effect may differ between the recordings: name -> (R,) factor of its magnitude."""
        return profiles_of(self.occasions)

    @property
    def profiles(self) -> dict[str, Array]:
        """The same for every sample, (n,)."""
        return {name: self.spread(factors) for name, factors in self.factors.items()}

    def spread(self, factors: Array) -> Array:
        """One value a recording (R,) -> one a sample (n,)."""
        return np.repeat(factors, np.diff(self._edges))

    def recording_at(self, row: int) -> int:
        """Number of the recording that a sample is in."""
        return int(np.searchsorted(self._edges, row, side="right")) - 1

    def since_start(self, row: int) -> float:
        """How long after the start of its recording a sample is [s]."""
        r = self.recording_at(row)
        part = self.parts[r]
        return float(part.recording_time_s[row - self.rows[r].start] - part.start_s)

    def _lanes_of(self, r: int, lanes: Lanes) -> Lanes:
        """What the lanes are in one recording."""
        rows, count = self.rows[r], len(self.parts[r].parameters)
        return Lanes(
            lanes.parameters[:, r * count : (r + 1) * count],
            lanes.local[:, self._windows[r] : self._windows[r + 1]],
            lanes.magnitudes,
            {name: values[..., rows] for name, values in lanes.schedules.items()},
            {name: values[rows] for name, values in lanes.signals.items()},
            lanes.lane_points,
            None if lanes.lane_signals is None else np.ascontiguousarray(lanes.lane_signals[:, rows]),
            lanes.linear,
        )

    def _joined(self, lanes: Lanes, answer: Callable[[EngineTwin, Lanes], Array]) -> Array:
        """Answers (B, rows, C) of every part, one after another; lanes that are alike in a part are asked for once.

        The lanes of a linearisation differ in one recording's health each, and so hardly at all in every other.
        """
        out = []
        for r, part in enumerate(self.parts):
            own = self._lanes_of(r, lanes)
            first, again = _alike(own)
            out.append(answer(part, own) if first.size == own.size else answer(part, some_lanes(own, first))[again])
        return np.concatenate(out, axis=1)

    def simulate(self, lanes: Lanes) -> Array:
        """Readings without noise, (B, n, C)."""
        return self._joined(lanes, lambda part, own: part.simulate(own))

    def simulate_all(self, lanes: Lanes) -> Array:
        """All columns of `MEASURED` without sensor effects, (B, n, C)."""
        return self._joined(lanes, lambda part, own: part.simulate_all(own))

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """As `EngineTwin.variables`, of all recordings one after another."""
        return _merged([part.variables(self._lanes_of(r, lanes)) for r, part in enumerate(self.parts)])

    def trajectories(self, lanes: Lanes) -> tuple[Array, list[dict[str, Array]]]:
        """Readings (B, n, C), and `variables` of every lane."""
        found = [part.trajectories(self._lanes_of(r, lanes)) for r, part in enumerate(self.parts)]
        variables = [_merged([each[b] for _, each in found]) for b in range(lanes.size)]
        return np.concatenate([readings for readings, _ in found], axis=1), variables

    def first_local(self) -> Array:
        """First guess of the windows' initial states, (W, 1)."""
        return np.concatenate([part.first_local() for part in self.parts])

    def local_limits(self) -> tuple[Array, Array]:
        """Lowest and highest initial states, (W, 1) each."""
        lows, highs = zip(*(part.local_limits() for part in self.parts), strict=True)
        return np.concatenate(lows), np.concatenate(highs)

    def initial(self, local: Array) -> Array:
        """p_im, p_em [Pa], omega_t [rad/s] at the windows' starts (..., W, 3) for initial states (..., W, 1)."""
        parts = np.split(local, self._windows[1:-1], axis=-2)
        return np.concatenate([part.initial(own) for part, own in zip(self.parts, parts, strict=True)], axis=-2)

    def split(self, windows: np.ndarray, parts: int, local: Array) -> Array:
        """Cut some windows into parts; the initial states (W', 1) of all. As `EngineTwin.split`."""
        edges = self._windows[1:-1]
        each = zip(self.parts, np.split(windows, edges), np.split(local, edges), strict=True)
        out = np.concatenate([part.split(cut, parts, own) for part, cut, own in each])
        self._begin()
        return out

    def deviating(self, deviation: Array, moved: Array) -> SeveralTwin:
        """The twin about other corrections of the maps than the belief's mean (`likelihood.learned.LearnedTwin`)."""
        other = copy(self)
        other.parts = tuple(
            part.deviating(deviation, np.zeros_like(part.measured)) for part in self.parts
        )
        other.deviation, other.moved = deviation, moved
        other.measured = self.measured - self.moved + moved
        return other

    def covariance_between_rows(self, lanes: Lanes) -> tuple[Array, ...]:
        """`likelihood.between_rows.WithOpenInputs`, of all windows where the rows of any recording are slow."""
        found = [part.covariance_between_rows(self._lanes_of(r, lanes)) for r, part in enumerate(self.parts)]
        if not any(found):
            return ()
        sizes = [np.diff(np.append(part.starts, part.time_s.size)) * len(self.channels) for part in self.parts]
        return tuple(
            covariance for own, size in zip(found, sizes, strict=True)
            for covariance in own or [np.zeros((count, count)) for count in size]
        )  # fmt: skip

    def under(self, values: Mapping[str, float], opened: frozenset[str], like: bool = False) -> SeveralTwin:
        """The twin under other circumstances, as `LoggedTwin.under`; recordings in which nothing changes stay."""
        before, free = dict(self.values), dict.fromkeys(opened, 1.0)
        parts = list(self.parts)
        for r, part in enumerate(self.parts):
            own, open_now = of_recording(values, r), frozenset(of_recording(free, r))
            if isinstance(part, LoggedTwin) and (own, open_now) != (of_recording(before, r), part.opened):
                parts[r] = part.under(own, open_now, like)
            elif part.deviation.any():
                parts[r] = part.deviating(np.zeros_like(part.deviation), np.zeros_like(part.moved))
            else:
                parts[r] = copy(part)  # whose windows are cut where these aren't
        other = SeveralTwin(parts, self.occasions)
        if like:
            other.measured[~np.isfinite(self.measured).any(axis=1)] = np.nan
        return other

    def circumstance_responses(self, lanes: Lanes, simulated: Array, names: Sequence[str]) -> Array:
        """Responses (K, n, C) of the readings per unit of circumstances, each in the rows of its own recording, of the
        engine's own in those of all recordings in which they are open."""
        out = np.zeros((len(names), *simulated.shape))
        for r, (part, rows) in enumerate(zip(self.parts, self.rows, strict=True)):
            own = of_recording({name: float(k) for k, name in enumerate(names)}, r)
            if isinstance(part, LoggedTwin):
                there = {item.name for item in part.circumstances}
                own = {name: k for name, k in own.items() if kind_of(name) != CORRECTED or name in there}
            if own and isinstance(part, LoggedTwin):
                at = np.array([int(k) for k in own.values()])
                out[at, rows] = part.circumstance_responses(self._lanes_of(r, lanes), simulated[rows], list(own))
        return out


def _one_after_another(times: Sequence[Array]) -> Array:
    """Times of all recordings on one axis, each behind the one before."""
    out, end = [], 0.0
    for time in times:
        out.append(time - time[0] + end)
        end = float(out[-1][-1]) + _PAUSE_S
    return np.concatenate(out)


def _merged(parts: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _alike(lanes: Lanes) -> tuple[np.ndarray, np.ndarray]:
    """First lane of every kind, and which kind each lane is of; lanes with signals or schedules of their own aren't
    compared."""
    if lanes.lane_signals is not None or any(values.ndim > 1 for values in lanes.schedules.values()):
        return np.arange(lanes.size), np.arange(lanes.size)
    columns = [lanes.parameters, lanes.local.reshape(lanes.size, -1)]
    columns += [np.asarray(values, dtype=np.float64).reshape(-1, 1) for values in lanes.magnitudes.values()]
    _, first, again = np.unique(np.concatenate(columns, axis=1), axis=0, return_index=True, return_inverse=True)
    return first, again.reshape(-1)
