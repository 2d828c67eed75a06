"""Lanes of the diesel engine: their signals and actuators, and a memory of what was simulated lately.

Fits come back to where they were: a polished fit is the start of the next, a linearisation's first lane is the trial
before it, faults of sensors leave the engine itself as it is. Such lanes aren't simulated twice.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from hashlib import blake2b

import numpy as np

from dieseltwin.discovery.twins.interface import Array, Lanes, Point, some_lanes
from dieseltwin.engine import EngineParameters, Inputs
from dieseltwin.engine.actuation import actuate_lanes
from dieseltwin.engine.effects import ACTUATION_EFFECTS, EFFECTS, STATE_EFFECTS
from dieseltwin.engine.extended import Extension
from dieseltwin.engine.inputs import Actuation
from dieseltwin.engine.quantities import POINTS
from dieseltwin.engine.simulate import Observations
from dieseltwin.engine.terms import SENSOR_SLOTS, AnyTerm, Term, effect_terms

_REMEMBERED = 8  # lanes of a call at most: larger ones are responses, which nobody asks for twice
_MOST_BYTES = 64 * 2**20


def signals_of_lane(one: Lanes, points: Sequence[Point]) -> dict[str, Array]:
    """Point -> total signal (n,) of a single lane, without those that are zero."""
    signals = dict(one.signals)
    if one.lane_points is not None and one.lane_signals is not None and one.lane_points[0] >= 0:
        name = points[int(one.lane_points[0])].name
        signals[name] = signals.get(name, 0.0) + one.lane_signals[0]
    return {name: signal for name, signal in signals.items() if np.any(signal)}


def moving(magnitudes: Mapping[str, Array]) -> dict[str, Array]:
    """Those of some effects that act on commands or inputs and are there in some lane."""
    return {name: magnitudes[name] for name in ACTUATION_EFFECTS if name in magnitudes and np.any(magnitudes[name])}


def lane_actuations(
    inputs: Inputs, engine: EngineParameters, moved: Mapping[str, Array], schedules: Mapping[str, Array],
    plain: Sequence[Actuation], step_s: Array,
) -> list[Actuation]:  # fmt: skip
    """Actuators of every lane under effects on the commands.

    Args:
        inputs, engine: of the twin.
        moved: effect -> (B,) magnitudes.
        schedules: effect -> (n,) or (B, n) factor of its magnitude.
        plain: actuators without effects, one.
        step_s: longest integration step [s] of every interval.
    """
    size = len(next(iter(moved.values())))
    own = {name: values for name, values in schedules.items() if name in moved}
    if all(values.ndim == 1 for values in own.values()):
        return actuate_lanes(inputs, engine, moved, size, own, step_s, plain[0])
    found: list[Actuation] = []
    for b in range(size):
        one = {name: values[b : b + 1] for name, values in moved.items()}
        factors = {name: values if values.ndim == 1 else values[b] for name, values in own.items()}
        acts = any(values[0] != 0.0 for values in one.values())
        found += actuate_lanes(inputs, engine, one, 1, factors, step_s, plain[0]) if acts else plain[:1]
    return found


def extension_of(lanes: Lanes, combined: Mapping[str, Array], schedules: Mapping[str, Array], n: int) -> Extension:
    """What enters the equations in every lane, over n samples.

    Args:
        lanes: give the signals.
        combined: effect -> (B,) magnitudes, those of the engine's own terms included.
        schedules: effect -> (n,) or (B, n) factor of its magnitude.
    """
    own = any(values.ndim > 1 for values in schedules.values())  # a schedule per lane
    magnitudes = np.zeros((len(STATE_EFFECTS), lanes.size))
    schedule = np.ones((lanes.size if own else 1, len(STATE_EFFECTS), n))
    for j, name in enumerate(STATE_EFFECTS):
        if name in combined:
            magnitudes[j] = combined[name]
            schedule[:, j] = schedules.get(name, 1.0)
    signals = None
    if lanes.signals:
        signals = np.zeros((len(POINTS), n))
        for name, values in lanes.signals.items():
            signals[POINTS.index(name)] = values
    of_lane = np.arange(lanes.size) if own else np.zeros(lanes.size, dtype=np.int64)
    return Extension(
        magnitudes, None, signals, lanes.lane_points, lanes.lane_signals,
        schedules=schedule, schedule_of_lane=of_lane,
    )  # fmt: skip


def known_terms(
    terms: Sequence[AnyTerm], time_s: Array, start_s: float, conditions: Mapping[str, Array]
) -> dict[str, tuple[float, Array | None]]:
    """Magnitude and schedule (n,), None for always, of the effects that an engine's own terms name.

    Args:
        terms: of the engine file; laws and corrections are passed over.
        time_s, conditions: of the recording's rows; start_s: its start.
    """
    known: dict[str, tuple[float, Array | None]] = {}
    for term in effect_terms(terms):
        limited = not term.always or (isinstance(term, Term) and EFFECTS[term.effect].varies)
        schedule = term.factor(time_s, start_s, dict(conditions)) if limited else None
        before, earlier = known.get(term.slot, (0.0, None))
        if before and (schedule is not None or earlier is not None):  # either has times of its own
            own = term.magnitude * (1.0 if schedule is None else schedule)
            known[term.slot] = 1.0, np.asarray(before * (1.0 if earlier is None else earlier) + own)
        else:
            known[term.slot] = before + term.magnitude, schedule
    return known


class Memory:
    """Trajectories of the lanes that were simulated last."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, tuple[Array, Array]] = OrderedDict()
        self._bytes = 0

    def trajectories(self, lanes: Lanes, simulate: Callable[[Lanes], Observations]) -> Observations:
        """States and readings without sensor effects of all lanes; only what isn't known is simulated.

        Args:
            lanes: what is wanted.
            simulate: for those that are not known.
        """
        if lanes.lane_signals is not None and lanes.size > _REMEMBERED:
            return simulate(lanes)
        keys = _keys(lanes)
        first = {key: b for b, key in reversed(list(enumerate(keys)))}
        missing = np.array(sorted(b for key, b in first.items() if key not in self._known), dtype=np.int64)
        here: dict[bytes, tuple[Array, Array]] = {}
        if missing.size:
            new = simulate(lanes if missing.size == lanes.size else some_lanes(lanes, missing))
            if missing.size == lanes.size and lanes.size > _REMEMBERED:
                return new
            here = {keys[b]: (new.states[k], new.measured[k]) for k, b in enumerate(missing)}
        found = [here[key] if key in here else self._known[key] for key in keys]
        result = Observations(np.stack([states for states, _ in found]), np.stack([seen for _, seen in found]))
        if lanes.size <= _REMEMBERED:
            for b, key in enumerate(keys):
                self._keep(key, result.states[b], result.measured[b])
        return result

    def _keep(self, key: bytes, states: Array, seen: Array) -> None:
        if key in self._known:
            self._known.move_to_end(key)
            return
        self._known[key] = states.copy(), seen.copy()
        self._bytes += states.nbytes + seen.nbytes
        while self._bytes > _MOST_BYTES:
            _, (old, old_seen) = self._known.popitem(last=False)
            self._bytes -= old.nbytes + old_seen.nbytes


def _keys(lanes: Lanes) -> list[bytes]:
    """What tells the lanes' trajectories apart; faults of sensors don't."""
    shared = blake2b()
    for name, signal in sorted(lanes.signals.items()):
        shared.update(name.encode() + np.ascontiguousarray(signal).tobytes())
    names = [name for name in sorted(lanes.magnitudes) if name not in SENSOR_SLOTS]
    common = {
        name: blake2b(np.ascontiguousarray(lanes.schedules[name]).tobytes()).digest()
        for name in names
        if name in lanes.schedules and lanes.schedules[name].ndim == 1
    }
    keys = []
    for b in range(lanes.size):
        own = shared.copy()
        own.update(lanes.parameters[b].tobytes() + lanes.local[b].tobytes())
        for name in names:
            value = float(np.asarray(lanes.magnitudes[name])[b])
            if value != 0.0:
                own.update(f"{name}={value!r}".encode())
                if name in common:
                    own.update(common[name])
                elif name in lanes.schedules:
                    own.update(lanes.schedules[name][b].tobytes())
        if lanes.lane_points is not None and lanes.lane_signals is not None and lanes.lane_points[b] >= 0:
            own.update(f"point {int(lanes.lane_points[b])}".encode() + lanes.lane_signals[b].tobytes())
        keys.append(own.digest())
    return keys
