"""A twin with a law inside: its coefficient and free shape are further parameters, so that every fit works on it.

Twins that can evaluate a law at every moment do so (`simulate_with_laws`). For others the law becomes a signal, found
by simulating, evaluating the law along the trajectory and simulating again until it settles (Picard). Operators on an
actuator's command, where the twin can put them there (`LawScope.commands`), are simulated before its lags: behind an
actuator that overshoots, play of the position isn't play of the command. In all cases the law is refitted by
simulation, never on derivatives.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dieseltwin.discovery.laws.grammar import Form
from dieseltwin.discovery.time_limit import check_time
from dieseltwin.discovery.twins.interface import (
    Array,
    Lanes,
    Parameter,
    Point,
    Twin,
    TwinDefaults,
    joined,
    lane_of,
    law_scope_of,
    some_lanes,
)

_SETTLED = 1e-6  # change of a signal relative to its size that counts as settled
_SETTLED_BESIDE = (0.03, 1e-8)  # and of its first change, where lanes are hardly apart; what is less is none
_SHARES = (-2.0, 0.5)  # of the last change that an accelerated step takes off
_FARTHEST = 3.0  # times the last two changes that a step by both takes off, at most
_ALIKE = 1e-10  # of their squares' product: two changes that point the same way say nothing apart
_LEAST_CHANGE = 1e-300
_PICARD_ROUNDS = 10
_LOOSE = 10.0  # prior standard deviation of a coefficient, relative to its first estimate: says nothing


@dataclass(frozen=True)
class Placed:
    """A form at its point with first values.

    Attributes:
        form: what enters.
        coefficient: first estimate [unit of the point].
        free_shape: the first factor's shape is estimated too.
    """

    form: Form
    coefficient: float
    free_shape: bool = False


class LawTwin(TwinDefaults):
    """A twin to which laws are added; satisfies `dieseltwin.discovery.twins.interface.Twin`.

    Coefficients keep the sign of their first estimate: the parameter is their size.

    Args:
        base: the twin without the laws.
        laws: what to add.
    """

    def __init__(self, base: Twin, laws: Sequence[Placed]) -> None:
        self.base, self.laws = base, tuple(laws)
        self._points = {point.name: point for point in base.points}
        extra: list[Parameter] = []
        for k, law in enumerate(self.laws):
            size = abs(law.coefficient)
            if law.form.fixed is None:
                unit = self._points[law.form.point].unit
                extra.append(Parameter(f"law_{k + 1}", size, _LOOSE * size, unit, size))
            if law.free_shape:
                first = law.form.factors[0]
                extra.append(Parameter(f"shape_{k + 1}", first.shape, first.shape_spread, "-", first.shape_step))
        self.parameters = (*base.parameters, *extra)
        self.channels, self.states, self.state_scales = base.channels, base.states, base.state_scales
        self.points, self.hypotheses, self.time_s = base.points, base.hypotheses, base.time_s
        self.starts, self.measured, self.conditions = base.starts, base.measured, base.conditions
        self._instant = hasattr(base, "simulate_with_laws") and not any(law.form.operator for law in self.laws)
        self._commands = self._on_commands()
        self._settled: Array | None = None

    def local_limits(self) -> tuple[Array, Array] | None:
        """As of the twin without the laws."""
        return self.base.local_limits()

    def _on_commands(self) -> tuple[str, ...]:
        """The twin's own effect for every law, where all laws are operators on commands."""
        known = law_scope_of(self.base).commands
        forms = [law.form for law in self.laws]
        names = [known.get((form.factors[0].kind, form.point), "") if form.operator else "" for form in forms]
        return tuple(names) if all(names) and all(form.fixed == 1.0 for form in forms) else ()

    def first_local(self) -> Array:
        """As the base's."""
        return self.base.first_local()

    def values(self, parameters: Array) -> list[tuple[Any, Any]]:
        """Coefficient and shape (None if not free) of every law from parameters (..., P)."""
        at, out = len(self.base.parameters), []
        for law in self.laws:
            coefficient: Any = law.form.fixed
            if coefficient is None:
                coefficient = np.sign(law.coefficient) * parameters[..., at]
                at += 1
            shape = None
            if law.free_shape:
                shape = parameters[..., at]
                at += 1
            out.append((coefficient, shape))
        return out

    def _commanded(self, lanes: Lanes) -> Lanes:
        """Lanes of the base with the operators on the commands."""
        magnitudes, schedules = dict(lanes.magnitudes), dict(lanes.schedules)
        for name, law, (_, shape) in zip(self._commands, self.laws, self.values(lanes.parameters), strict=True):
            size = np.broadcast_to(law.form.factors[0].shape if shape is None else shape, (lanes.size,))
            magnitudes[name] = magnitudes.get(name, 0.0) + np.maximum(size, 0.0)
            if law.form.since_s is not None:
                schedules[name] = (self.time_s >= law.form.since_s).astype(np.float64)
        return replace(of_base(lanes, self.base), magnitudes=magnitudes, schedules=schedules)

    def simulate(self, lanes: Lanes) -> Array:
        """Readings without noise, (B, n, C)."""
        if self._instant:
            return self.base.simulate_with_laws(of_base(lanes, self.base), self._terms(lanes.parameters))  # type: ignore[attr-defined]
        if self._commands:
            return self.base.simulate(self._commanded(lanes))
        return self._settle(lanes)[0]

    def variables(self, lanes: Lanes) -> dict[str, Array]:
        """Along the trajectory of lane 0."""
        lane = lane_of(lanes, 0)
        if self._instant:
            return self.base.variables(of_base(lane, self.base), self._terms(lane.parameters))  # type: ignore[call-arg]
        if self._commands:
            return self.base.variables(self._commanded(lane))
        return self._settle(lane)[1][0]

    def _terms(self, parameters: Array) -> Mapping[str, list[Any]]:
        terms: dict[str, list[Any]] = {}
        for law, (coefficient, shape) in zip(self.laws, self.values(parameters), strict=True):

            def term(at: Mapping[str, Any], law: Placed = law, c: Any = coefficient, s: Any = shape) -> Any:
                c = c if np.ndim(c) == 0 else np.asarray(c)[:, None]
                return c * law.form.value(at, s if s is None else np.asarray(s)[:, None])

            terms.setdefault(law.form.point, []).append(term)
        return terms

    def _settle(self, lanes: Lanes) -> tuple[Array, list[dict[str, Array]]]:
        """Readings (B, n, C) and variables of every lane with the laws' signals settled.

        The first lane comes first, from where it ended the last time; the others begin where it ends, as lanes of one
        linearisation, and steps of a fit, differ little.
        """
        settled, readings, variables = self._picard(lane_of(lanes, 0))
        if np.all(np.isfinite(settled)):
            self._settled = settled[:, 0]
        if lanes.size > 1:
            _, readings, variables = self._picard(lanes, _SETTLED_BESIDE)
        return readings, variables

    def _picard(
        self, lanes: Lanes, beside: tuple[float, float] | None = None
    ) -> tuple[Array, Array, list[dict[str, Array]]]:
        """Signals (L, B, n), readings (B, n, C) and variables of all lanes; a round is one simulation of those whose
        signals still change: relative to their size and, of lanes `beside` a settled one, to their first change."""
        base, values = of_base(lanes, self.base), self.values(lanes.parameters)
        signals = np.zeros((len(self.laws), lanes.size, len(self.time_s)))
        if self._settled is not None:
            signals[:] = self._settled[:, None]
        readings = np.empty((lanes.size, *self.measured.shape))
        variables: list[dict[str, Array]] = [{} for _ in range(lanes.size)]
        past: list[tuple[Array, Array]] = []
        first: Array | None = None
        moving = np.arange(lanes.size)
        for _ in range(_PICARD_ROUNDS):
            check_time()
            now = signals[:, moving]
            readings[moving], seen = trajectories(self.base, some_lanes(base, moving), self.entered(now))
            new = np.empty_like(now)
            for place, (b, own) in enumerate(zip(moving, seen, strict=True)):
                variables[b] = own
                for k, (law, (c, s)) in enumerate(zip(self.laws, values, strict=True)):
                    at = before({**own, "time_s": self.time_s}, law.form.point)
                    coefficient = c if np.ndim(c) == 0 else c[b]
                    new[k, place] = np.nan_to_num(coefficient * law.form.value(at, s if s is None else s[b]))
            past = [*past, (now, new)][-3:]
            signals[:, moving] = _accelerated(past, self.starts)
            size, change = (np.abs(each).max(axis=2) for each in (new, new - now))
            first = change if first is None else first
            small = _SETTLED * size
            if beside is not None:
                small = np.clip(beside[0] * first[:, moving], beside[1] * size, small)
            changes = ~(change <= small).all(axis=0)
            if not changes.any():
                break
            changes[0] = True  # laws that the engine has already are settled along the first lane, for all
            past, moving = [(x[:, changes], f[:, changes]) for x, f in past], moving[changes]
        return signals, readings, variables

    def entered(self, signals: Iterable[Array]) -> dict[str, Array]:
        """Point -> total of what the laws add there, in the shape of a law's signal."""
        total: dict[str, Array] = {}
        for law, signal in zip(self.laws, signals, strict=True):
            total[law.form.point] = total.get(law.form.point, 0.0) + signal
        return total

    def signals(self, lanes: Lanes) -> list[Array]:
        """What each law adds at its point along the trajectory of lane 0, (n,) each."""
        if self._commands:
            plain = self.base.variables(lane_of(of_base(lanes, self.base), 0))
            moved = self.variables(lanes)
            return [moved[law.form.point] - plain[law.form.point] for law in self.laws]
        variables: Mapping[str, Array] = {**self.variables(lanes), "time_s": self.time_s}
        if not self._instant and self._settled is not None:
            return list(self._settled)
        out = []
        for law, (c, s) in zip(self.laws, self.values(lanes.parameters[0]), strict=True):
            at = before(variables, law.form.point)
            out.append(np.broadcast_to(c * law.form.value(at, s), self.time_s.shape).copy())
        return out


def _accelerated(past: Sequence[tuple[Array, Array]], starts: NDArray[np.int64]) -> Array:
    """Next signals (L, B, n) from up to three pairs of signals and what the laws said to them, the last one last.

    Anderson 1965, with two steps of memory, for every law, lane and window by itself: windows start anew and don't
    touch each other, and each answers its own signal by shares of its own. A filter's pressure at high flow, whose law
    turns most of its own change round, settles in ten rounds to 1e-6; with one step of memory and all windows in one it
    stood at 3e-4 there, and fits wandered about by that.
    """
    x, f = past[-1]
    if len(past) == 1:
        return f
    ahead = [f - before for _, before in past[-2::-1]]  # since the round before, and since the one before that
    bent = [(f - x) - (answer - asked) for asked, answer in past[-2::-1]]

    def along(a: Array, b: Array) -> Array:
        return np.asarray(np.add.reduceat(a * b, starts, axis=-1))

    squares, told = [np.maximum(along(d, d), _LEAST_CHANGE) for d in bent], [along(f - x, d) for d in bent]
    shares = [np.clip(told[0] / squares[0], *_SHARES)]
    if len(past) > 2:
        shares.append(np.zeros_like(shares[0]))
        cross = along(*bent)
        apart = squares[0] * squares[1] - cross**2
        apart = np.where(apart > _ALIKE * squares[0] * squares[1], apart, np.inf)
        both = (told[0] * squares[1] - told[1] * cross) / apart, (told[1] * squares[0] - told[0] * cross) / apart
        near = np.isfinite(apart) & (np.abs(both[0]) + np.abs(both[1]) <= _FARTHEST)
        shares = [np.where(near, two, one) for two, one in zip(both, shares, strict=True)]
    rows = np.diff(np.append(starts, f.shape[-1]))
    return f - sum(np.repeat(share, rows, axis=-1) * change for share, change in zip(shares, ahead, strict=True))


def of_base(lanes: Lanes, base: Twin) -> Lanes:
    """Lanes of a twin with further parameters behind those of its base, as the base takes them."""
    return replace(lanes, parameters=lanes.parameters[:, : len(base.parameters)])


def point_index(points: Sequence[Point], name: str) -> int:
    """Index of the insertion point of that name; there must be one."""
    return next(i for i, point in enumerate(points) if point.name == name)


def before(variables: Mapping[str, Array], point: str) -> Mapping[str, Array]:
    """Variables where the point's own quantity is as the twin computes it before a signal enters, if the twin says."""
    own = variables.get(f"{point}:before")
    return variables if own is None else {**variables, point: own}


def trajectories(twin: Twin, lanes: Lanes, signals: Mapping[str, Array]) -> tuple[Array, list[dict[str, Array]]]:
    """Readings (B, n, C) and variables of every lane; point -> (B, n) signals on top of the lanes' own.

    Twins may have a method `trajectories(lanes)` that does it for many lanes in one simulation.
    """
    if not signals and hasattr(twin, "trajectories"):
        return twin.trajectories(lanes)  # type: ignore[no-any-return]
    if len(signals) == 1 and lanes.lane_points is None and hasattr(twin, "trajectories"):
        (name, signal), = signals.items()
        entered = replace(lanes, lane_points=np.full(lanes.size, point_index(twin.points, name)),
                          lane_signals=np.ascontiguousarray(signal))
        return twin.trajectories(entered)  # type: ignore[no-any-return]
    readings, variables = [], []
    for b in range(lanes.size):
        lane = lane_of(lanes, b)
        lane = replace(lane, signals=joined(lane.signals, {name: signal[b] for name, signal in signals.items()}))
        readings.append(twin.simulate(lane)[0])
        variables.append(twin.variables(lane))
    return np.stack(readings), variables
