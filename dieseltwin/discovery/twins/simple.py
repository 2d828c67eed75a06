"""A full twin from a few declarations: rates, readings, points and effects of a small machine (see `examples/`).

The user's functions see one moment: `rates(x, u, p, s, e)` with states `x.name`, inputs `u.name`, parameters `p.name`,
magnitudes of effects `e.name` (0.0 when absent) and `s("quantity", value)`, which gives the quantity back with whatever
is inserted there. They must be element-wise, as everything arrives as arrays: lanes and windows are simulated together
in one pass over the samples of a window, by Heun's method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dieseltwin.discovery.twins import pieces
from dieseltwin.discovery.twins.interface import (
    Array,
    Hypothesis,
    Lanes,
    LawScope,
    Parameter,
    Point,
    TwinDefaults,
    lane_of,
)
from dieseltwin.errors import InputError
from dieseltwin.recordings.noise import Noise, estimate_noise

Moment = Callable[[Any, Any, Any, "Insertion", Any], tuple[Any, ...]]
LawTerm = Callable[[Mapping[str, Any]], Any]

GAP = 10.0  # median steps: nobody knows what the inputs did meanwhile, and one step of an integration is far too long


class Insertion:
    """What a twin's functions call at each named quantity: inserts signals and laws, and notes the value.

    Args:
        points: by name.
        signals: point name -> signals at this moment, each broadcastable against lanes x windows.
        laws: point name -> functions of the values noted so far that give a signal.
        noted: values known at this moment (states, inputs, earlier quantities); extended by each call.
    """

    def __init__(
        self,
        points: Mapping[str, Point],
        signals: Mapping[str, list[Any]],
        laws: Mapping[str, list[LawTerm]],
        noted: dict[str, Any],
    ) -> None:
        self._points, self._signals, self._laws = points, signals, laws
        self.noted = noted

    def __call__(self, name: str, value: Any) -> Any:
        signals = self._signals.get(name)
        laws = self._laws.get(name)
        if signals or laws:
            self.noted[name] = self.noted[f"{name}:before"] = value  # a law sees the quantity as the twin computes it
            total = sum(signals or ()) + sum(law(self.noted) for law in laws or ())
            value = value * (1.0 + total) if self._points[name].relative else value + total
        self.noted[name] = value
        return value


class _NothingInserted(Insertion):
    """Where no signal and no law enters, nobody asks what was noted: every quantity goes on as it is."""

    def __init__(self) -> None:
        super().__init__({}, {}, {}, {})

    def __call__(self, name: str, value: Any) -> Any:
        del name
        return value


@dataclass(frozen=True)
class Model:
    """Declarations of a small twin.

    Attributes:
        states: name -> typical size of a change [unit].
        parameters: free ones.
        inputs: names of the input columns.
        channels: names of the measured columns, as `readings` returns them.
        rates: derivative of each state, in the order of `states`.
        readings: what the sensors show at the samples.
        points: insertion points; quantities passed to `s` under other names are only noted.
        hypotheses: effects that `rates` and `readings` know as `e.<name>`.
        units: of states, inputs and noted quantities, for laws.
        sub_steps: Heun steps per sample.
        hold: inputs between samples, held or linear.
        nearest: (channel) -> state, for the first guess of a window's initial states; other states start at `first`.
        first: state -> first guess [unit].
        rates_without: `rates` in which effects of these names are zero, and quantities that no rate needs aren't
            computed; None where there is no such thing.
    """

    states: Mapping[str, float]
    parameters: tuple[Parameter, ...]
    inputs: tuple[str, ...]
    channels: tuple[str, ...]
    rates: Moment
    readings: Moment
    points: tuple[Point, ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    sub_steps: int = 1
    hold: Literal["held", "linear"] = "linear"
    nearest: Mapping[str, str] = field(default_factory=dict)
    first: Mapping[str, float] = field(default_factory=dict)
    rates_without: Callable[[frozenset[str]], Moment] | None = None


class SimpleTwin(TwinDefaults):
    """A `Model` bound to one recording; satisfies `dieseltwin.discovery.twins.interface.Twin`.

    Args:
        model: declarations.
        time_s: (n,) sample times [s].
        inputs: name -> (n,).
        measured: (n, C), NaN where missing.
        window_s: length of the windows [s]; None for one free run over the whole recording. A new one begins behind a
            gap.

    Raises:
        InputError: shapes, names or times don't fit.
    """

    def __init__(
        self, model: Model, time_s: Array, inputs: Mapping[str, Array], measured: Array, window_s: float | None = None
    ) -> None:
        self.model = model
        self.time_s = np.asarray(time_s, dtype=np.float64)
        n = len(self.time_s)
        if n < 2 or np.any(np.diff(self.time_s) <= 0.0):
            raise InputError("time_s", "times that don't increase", "at least two increasing times", "sort the rows")
        missing = [name for name in model.inputs if name not in inputs]
        if missing:
            raise InputError("inputs", f"no {', '.join(missing)}", ", ".join(model.inputs), "pass every input column")
        self._inputs = {name: np.asarray(inputs[name], dtype=np.float64) for name in model.inputs}
        self.measured = np.asarray(measured, dtype=np.float64).reshape(n, -1)
        if self.measured.shape[1] != len(model.channels):
            raise InputError(
                "measured", f"{self.measured.shape[1]} columns", f"{len(model.channels)}", "one column per channel"
            )
        self.channels, self.parameters, self.points = model.channels, model.parameters, model.points
        self.states = tuple(model.states)
        self.state_scales = np.array(list(model.states.values()))
        self.hypotheses: Mapping[str, Hypothesis] = {h.name: h for h in model.hypotheses}
        self.law_scope = LawScope(units=dict(model.units))
        self.conditions: Mapping[str, Array] = dict(self._inputs)
        self._points = {p.name: p for p in model.points}
        first_times = self.time_s[:1] if window_s is None else _edges(self.time_s, window_s)
        steps = np.diff(self.time_s)
        behind_gaps = 1 + np.flatnonzero(steps > GAP * np.median(steps))
        self.starts = np.union1d(np.searchsorted(self.time_s, first_times), behind_gaps)
        ends = np.append(self.starts[1:], n)
        longest = int(np.max(ends - self.starts))
        rows = self.starts[:, None] + np.arange(longest)
        self._inside = rows < ends[:, None]  # (W, L)
        self._rows = np.minimum(rows, ends[:, None] - 1).T.copy()  # (L, W)
        self._piece_rows = pieces.rows_of(self._rows)
        self._begins: Array | None = None  # of the pieces of the last run, (W, P, S)

    def noise(self) -> Noise:
        """Of the recording, from differences."""
        return estimate_noise(self.measured, self.starts)

    def first_local(self) -> Array:
        """First guess of the windows' initial states from the readings, (W, S)."""
        local = np.tile([float(self.model.first.get(s, 0.0)) for s in self.states], (len(self.starts), 1))
        for channel, state in self.model.nearest.items():
            values = self.measured[:, self.channels.index(channel)]
            present = np.flatnonzero(np.isfinite(values))
            if present.size:
                local[:, self.states.index(state)] = np.interp(self.starts, present, values[present])
        return local

    def simulate(self, lanes: Lanes) -> Array:
        """Readings without noise, (B, n, C)."""
        return self.simulate_with_laws(lanes, {})

    def simulate_with_laws(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]]) -> Array:
        """As `simulate`, with laws evaluated inside the simulation. Readings (B, n, C)."""
        trajectory = self._trajectory(lanes, laws)  # (L, S, B, W)
        with np.errstate(over="ignore", invalid="ignore"):  # a wrong law may diverge; its fit is refused
            values, _ = self._read(lanes, laws, trajectory)
        out = np.empty((lanes.size, len(self.time_s), len(self.channels)))
        rows = self._rows.T[self._inside]
        for j, value in enumerate(values):
            full = np.broadcast_to(value, (len(self._rows), lanes.size, len(self.starts)))
            out[:, rows, j] = full.transpose(1, 2, 0)[:, self._inside]
        return out

    def variables(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]] | None = None) -> dict[str, Array]:
        """Every state, input, parameter-free quantity and reading along lane 0: name -> (n,)."""
        lane, laws = lane_of(lanes, 0), laws or {}
        _, noted = self._read(lane, laws, self._trajectory(lane, laws))
        rows = self._rows.T[self._inside]
        out: dict[str, Array] = {}
        for name, value in noted.items():
            full = np.broadcast_to(value, (len(self._rows), 1, len(self.starts)))[:, 0, :]
            out[name] = np.empty(len(self.time_s))
            out[name][rows] = full.T[self._inside]
        return out

    def _read(
        self, lanes: Lanes, laws: Mapping[str, list[LawTerm]], trajectory: Array
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Readings and noted quantities at all samples at once: arrays broadcastable to (L, B, W)."""
        x = SimpleNamespace(**{name: trajectory[:, i] for i, name in enumerate(self.states)})
        u = SimpleNamespace(**{name: values[self._rows][:, None, :] for name, values in self._inputs.items()})
        p = SimpleNamespace(**{q.name: lanes.parameters[:, i][:, None] for i, q in enumerate(self.parameters)})
        e = SimpleNamespace(**dict.fromkeys(self.hypotheses, 0.0))
        for name, magnitude in lanes.magnitudes.items():
            factor = lanes.schedules.get(name)
            value = np.asarray(magnitude)[:, None]
            setattr(e, name, value if factor is None else value * factor[self._rows][:, None, :])
        signals = {name: [signal[self._rows][:, None, :]] for name, signal in lanes.signals.items()}
        for name, own in self._lane_signals(lanes, self._rows).items():
            signals.setdefault(name, []).append(own)
        times = self.time_s[self._rows][:, None, :]  # for laws that begin later
        insertion = Insertion(self._points, signals, laws, {**vars(x), **vars(u), "time_s": times})
        self.model.rates(x, u, p, insertion, e)
        readings = self.model.readings(x, u, p, insertion, e)
        return readings, insertion.noted

    def _lane_signals(self, lanes: Lanes, rows: NDArray[np.int_]) -> dict[str, Array]:
        """Point name -> at rows (L, W), (L, B, W), zero in the lanes whose signal enters elsewhere."""
        if lanes.lane_points is None or lanes.lane_signals is None:
            return {}
        out = {}
        for j in np.unique(lanes.lane_points[lanes.lane_points >= 0]):
            own = np.zeros((len(rows), lanes.size, rows.shape[1]))
            chosen = np.flatnonzero(lanes.lane_points == j)
            own[:, chosen, :] = lanes.lane_signals[chosen][:, rows].transpose(1, 0, 2)
            out[self.points[j].name] = own
        return out

    def _trajectory(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]]) -> Array:
        """States at the samples of the windows, (L, S, B, W); of long windows in pieces about the last run."""
        length, windows = self._rows.shape
        if not pieces.worth_it(length, windows, lanes.size, len(self.states)):
            return self._integrated(lanes, laws, self._rows)
        out = None
        if self._begins is not None:

            def run(local: Array) -> Array:
                times = local.shape[1] // self._piece_rows.shape[1]
                return self._integrated(replace(lanes, local=local), laws, np.tile(self._piece_rows, times))

            out = pieces.trajectory_of(run, lanes.local, self._begins, self.state_scales, length)
        if out is None:
            out = self._integrated(lanes, laws, self._rows)
        if np.isfinite(out[:, :, 0]).all():
            self._begins = pieces.begins(out)
        return out

    def _integrated(self, lanes: Lanes, laws: Mapping[str, list[LawTerm]], rows: NDArray[np.int_]) -> Array:
        """States (L, S, B, W) at rows (L, W) from the lanes' local ones on; a row that comes again stands still."""
        model, m = self.model, self.model.sub_steps
        (length, windows), lanes_count = rows.shape, lanes.size
        moments = self.time_s[rows]
        steps = np.diff(moments, axis=0)  # (L - 1, W)
        out = np.empty((length, len(self.states), lanes_count, windows))
        out[0] = lanes.local.transpose(2, 0, 1)
        p = SimpleNamespace(**{q.name: lanes.parameters[:, i][:, None] for i, q in enumerate(self.parameters)})
        inputs = {name: values[rows] for name, values in self._inputs.items()}
        shared = {name: signal[rows] for name, signal in lanes.signals.items()}
        own = self._lane_signals(lanes, rows)
        factors = {name: factor[rows] for name, factor in lanes.schedules.items() if name in lanes.magnitudes}
        magnitudes = {name: np.asarray(value)[:, None] for name, value in lanes.magnitudes.items()}
        constant = SimpleNamespace(**{**dict.fromkeys(self.hypotheses, 0.0), **magnitudes})
        untouched = None if shared or own or any(laws.values()) else _NothingInserted()
        rates_of = model.rates
        if untouched is not None and model.rates_without is not None:
            rates_of = model.rates_without(frozenset(self.hypotheses).difference(magnitudes))

        # What doesn't depend on the states is taken between the samples for all of them at once: the loop below runs
        # over thousands of steps with few lanes.
        def between(values: Array, share: float) -> Array:
            return values[:-1] if share == 0.0 else (1.0 - share) * values[:-1] + share * values[1:]

        shares = [j / m for j in range(m + 1)]
        held = model.hold == "held"
        driven = [{name: between(v, 0.0 if held else share) for name, v in inputs.items()} for share in shares]
        entering = [{name: between(v, share) for name, v in shared.items()} for share in shares]
        times = [between(moments, share) for share in shares] if untouched is None else []  # for laws that begin later

        def inserted(x: SimpleNamespace, u: SimpleNamespace, k: int, j: int) -> Insertion:
            signals = {name: [values[k]] for name, values in entering[j].items()}
            for name, values in own.items():
                signals.setdefault(name, []).append(between(values[k : k + 2], shares[j])[0])
            return Insertion(self._points, signals, laws, {**vars(x), **vars(u), "time_s": times[j][k]})

        def rates(state: Array, k: int, j: int) -> Array:
            x = SimpleNamespace(**dict(zip(self.states, state, strict=True)))
            u = SimpleNamespace(**{name: values[k] for name, values in driven[j].items()})
            e = constant
            if factors:
                e = SimpleNamespace(**{**vars(constant), **{n: magnitudes[n] * f[k] for n, f in factors.items()}})
            derivative = np.empty_like(state)
            for i, value in enumerate(rates_of(x, u, p, untouched or inserted(x, u, k, j), e)):
                derivative[i] = value
            return derivative

        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(length - 1):
                state, step = out[k], steps[k] / m
                for j in range(m):
                    first = rates(state, k, j)
                    second = rates(state + step * first, k, j + 1)
                    state = state + 0.5 * step * (first + second)
                out[k + 1] = state
        return out


def _edges(time_s: Array, window_s: float) -> Array:
    """First times of windows of nearly `window_s` that share the recording evenly."""
    span = time_s[-1] - time_s[0]
    count = max(round(span / window_s), 1)
    return time_s[0] + span * np.arange(count) / count - 1e-9 * span
