"""How readings would change if the recording, not the engine, were at fault: scales, shifts and clocks of channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dieseltwin.discovery.likelihood.fit import Linearisation
from dieseltwin.discovery.likelihood.score import spread, without_parameters
from dieseltwin.discovery.twins.diesel import EngineTwin
from dieseltwin.discovery.twins.interface import Array
from dieseltwin.engine import Inputs
from dieseltwin.recordings.channels import INPUTS

_GAIN = 0.005  # steps of the differences: small against what matters, large against rounding
_OFFSET = {"u_egr_pct": 0.5, "u_vgt_pct": 0.5}  # %
_SHIFT_S = 0.05
_CLOCK = 0.005

LEAST_GAIN, LEAST_SHIFT_S, LEAST_CLOCK, LEAST_OFFSET_PCT = 0.01, 0.05, 0.005, 1.0
"""Smallest sizes of interest: below, no health parameter is moved by a twentieth."""


@dataclass(frozen=True)
class RecordingFault:
    """One way in which a recording may be wrong.

    Attributes:
        column: the channel, "time_s" for the clock.
        kind: "gain", "offset", "shift" or "clock".
        unit: of its size: "-" for a share, "s", or that of the channel.
        least: size of interest [unit].
        response: (n, C) of the readings per unit.
    """

    column: str
    kind: str
    unit: str
    least: float
    response: Array

    def words(self, size: float) -> str:
        """It with its size."""
        if self.kind == "clock":
            return f"time stamps that run about {100.0 * abs(size):.2g} % too {'fast' if size < 0.0 else 'slow'}"
        if self.kind == "gain":
            return f"{self.column} about {100.0 * size:+.2g} % off"
        if self.kind == "shift":
            return f"{self.column} about {abs(size):.2g} s too {'late' if size > 0.0 else 'early'}"
        return f"{self.column} about {size:+.3g} {self.unit} off"


@dataclass(frozen=True)
class Suspicion:
    """A fault with its linear estimate.

    Attributes:
        fault: which.
        size: estimate [unit of the fault].
        gain: decrease of -2 log likelihood that it would bring.
        held: the same without the window that it hangs on most (`score.spread`).
    """

    fault: RecordingFault
    size: float
    gain: float
    held: float


def recording_faults(twin: EngineTwin, at: Linearisation) -> list[RecordingFault]:
    """Gain, offset and shift of each sensor, gain, offset and shift of each input, and the clock, about a fit."""
    return [*_of_sensors(twin, at), *_of_inputs(twin, at)]


def _of_sensors(twin: EngineTwin, at: Linearisation) -> Iterator[RecordingFault]:
    for j, name in enumerate(twin.channels):
        column = at.simulated[:, j]
        level = float(np.mean(np.abs(column)))
        unit = twin.law_scope.channel_units[name]
        directions = (("gain", "-", LEAST_GAIN, column), ("offset", unit, LEAST_GAIN * level, 1.0),
                      ("shift", "s", LEAST_SHIFT_S, -_slope(twin, column)))  # fmt: skip
        for kind, of, least, direction in directions:
            response = np.zeros_like(at.simulated)
            response[:, j] = direction
            yield RecordingFault(name, kind, of, least, response)


def _slope(twin: EngineTwin, values: Array) -> Array:
    """Change over time (n,) [1/s], within each window."""
    out = np.zeros_like(values)
    for first, last in zip(twin.starts, np.append(twin.starts[1:], values.size), strict=True):
        if last - first > 2:
            out[first:last] = np.gradient(values[first:last], twin.time_s[first:last])
    return out


def _of_inputs(twin: EngineTwin, at: Linearisation) -> Iterator[RecordingFault]:
    inputs, lanes = twin.inputs, at.fit.lanes()

    def response(changed: Inputs, step: float) -> Array:
        return (twin.with_inputs(changed).simulate(lanes)[0] - at.simulated) / step

    for name in INPUTS:
        values = getattr(inputs, name)
        moved = _moved(inputs, name, values * (1.0 + _GAIN))
        # a column that reads too high was lower in truth: the readings answer the other way round
        yield RecordingFault(name, "gain", "-", LEAST_GAIN, -response(moved, _GAIN))
        earlier = _moved(inputs, name, np.interp(inputs.time_s + _SHIFT_S, inputs.time_s, values))
        yield RecordingFault(name, "shift", "s", LEAST_SHIFT_S, response(earlier, _SHIFT_S))
        if name in _OFFSET:
            moved = _moved(inputs, name, values + _OFFSET[name])
            yield RecordingFault(name, "offset", "%", LEAST_OFFSET_PCT, -response(moved, _OFFSET[name]))
    start = inputs.time_s[0]
    stretched = replace(inputs, time_s=start + (1.0 + _CLOCK) * (inputs.time_s - start))
    yield RecordingFault("time_s", "clock", "-", LEAST_CLOCK, response(stretched, _CLOCK))


def _moved(inputs: Inputs, name: str, values: Array) -> Inputs:
    changes: dict[str, Array] = {name: values}
    return replace(inputs, **changes)  # type: ignore[arg-type]


def suspicions(at: Linearisation, faults: list[RecordingFault]) -> list[Suspicion]:
    """Linear estimates of faults at a fit, strongest first."""
    projected = without_parameters(at, at.metric.project(np.stack([fault.response for fault in faults])))
    found = []
    for fault, vector in zip(faults, projected, strict=True):
        information = float(vector @ vector)
        if information > 0.0:
            push = float(vector @ at.pulled_residual)
            gain = push * push / information
            found.append(Suspicion(fault, push / information, gain, gain * spread(at, vector)))
    return sorted(found, key=lambda item: -item.gain)
